import json
import math
import random

import numpy as np
import pytest

from ros2_mcp.model.errors import BadValue
from ros2_mcp.model.text import visible_json
from ros2_mcp.model.values import summarised
from ros2_mcp.values.cdr import Codec
from ros2_mcp.values.check import check
from ros2_mcp.values.definitions import Definitions
from ros2_mcp.values.render import Rendered, RenderOptions, example_of, render

LISTS = "odd_msgs/msg/Lists"
SCAN = "sensor_msgs/msg/LaserScan"
PATH = "nav_msgs/msg/Path"


def shown(definitions: Definitions, name: str, value: object, **options: object) -> Rendered:
    return render(definitions, name, check(definitions, name, value), options=RenderOptions(**options))


def there_and_back(codec: Codec, name: str, value: object, **options: object) -> None:
    data = codec.encode(name, check(codec.definitions, name, value))
    result = render(codec.definitions, name, codec.decode(name, data), options=RenderOptions(**options))
    assert list(result.truncated) == []
    again = json.loads(json.dumps(result.value, allow_nan=False))
    assert codec.encode(name, check(codec.definitions, name, again, partial=False)) == data


def test_what_is_read_can_be_published_unchanged(codec: Codec) -> None:
    numbers = {
        "i64": 2**63 - 1, "u64": 2**64 - 1, "f32": 0.1, "f64": "nan", "flag": False, "octet": 200, "letter": 65,
    }  # fmt: skip
    there_and_back(codec, "odd_msgs/msg/Numbers", numbers)
    there_and_back(codec, LISTS, {"numbers": [numbers], "longs": [2**53 + 1, -(2**63)], "blob": list(range(64))})
    there_and_back(codec, LISTS, {"blob": list(range(256))}, exact=True)
    there_and_back(codec, "odd_msgs/msg/Texts", {"free": '"\n\x01\u202e\\', "wide": "😀", "many": ["é"]})
    there_and_back(codec, "odd_msgs/msg/Words", {"from": "x", "class": 1})
    there_and_back(codec, "odd_msgs/msg/Empty", {})


def test_float32_is_shown_short_and_comes_back_exactly(codec: Codec) -> None:
    bits = np.random.default_rng(7).integers(0, 2**32, 20_000, dtype=np.uint32)
    values = bits.view(np.float32)
    values = values[np.isfinite(values)]
    name = "odd_msgs/msg/Deep"
    message = check(codec.definitions, name, {})
    message.values = values
    result = render(codec.definitions, name, message, options=RenderOptions(exact=True)).value
    again = check(codec.definitions, name, json.loads(json.dumps(result))).values
    assert again.tobytes() == values.tobytes()
    assert shown(codec.definitions, name, {"values": [0.1, -2.5]}).value["values"] == [0.1, -2.5]


def test_numbers_without_a_fraction_are_written_without_one_and_come_back_bit_for_bit(codec: Codec) -> None:
    name = "std_msgs/msg/Float64MultiArray"
    values = {"data": [0.0, -0.0, 1.0, -2.0, 1e6, 2.0**53, 1e300, 0.1, "nan"]}
    there_and_back(codec, name, values)
    text = json.dumps(shown(codec.definitions, name, values).value["data"])
    assert text == '[0, -0.0, 1, -2, 1000000, 9007199254740992, 1e+300, 0.1, "nan"]'
    twist = shown(codec.definitions, "geometry_msgs/msg/Twist", {"linear": {"y": -0.0}}).value["linear"]
    assert json.dumps(twist) == '{"x": 0, "y": -0.0, "z": 0}'


def test_a_diagonal_covariance_is_shown_as_its_diagonal_and_comes_back_bit_for_bit(codec: Codec) -> None:
    name, six = "geometry_msgs/msg/PoseWithCovariance", [0.001, 1e6, 0.0, "nan", -0.0, 3.5]
    whole = [six[index // 7] if index % 7 == 0 else 0.0 for index in range(36)]
    value = {"covariance": whole}
    assert shown(codec.definitions, name, value).value["covariance"] == {"$diagonal": six}
    there_and_back(codec, name, value)
    inertia = {"k": [1.0, *[0.0] * 8]}
    assert shown(codec.definitions, "sensor_msgs/msg/CameraInfo", inertia).value["k"] == [1, *[0] * 8]
    assert shown(codec.definitions, name, value, exact=True).value["covariance"] == whole
    for beside in (1e-9, -0.0):
        value = {"covariance": [*whole[: 35 - 1], beside, whole[35]]}
        assert isinstance(shown(codec.definitions, name, value).value["covariance"], list)
        there_and_back(codec, name, value)


def test_numbers_that_json_lacks_are_strings(definitions: Definitions) -> None:
    value = {"i64": -(2**53) - 1, "u64": 2**53, "f32": math.inf, "f64": math.nan}
    result = shown(definitions, "odd_msgs/msg/Numbers", value).value
    assert [result[name] for name in value] == ["-9007199254740993", 2**53, "inf", "nan"]


def test_a_long_array_becomes_length_first_values_and_statistics_of_the_finite(definitions: Definitions) -> None:
    result = shown(
        definitions, SCAN, {"angle_increment": 0.5, "ranges": [1.0, 2.0, 3.0, "nan", "inf", "-inf"]}, max_array=2
    )
    assert result.value["ranges"] == {
        "$summary": "float32[]", "length": 6, "first": [1.0, 2.0], "omitted": 4,
        "min": 1.0, "min_at": 0, "min_at_angle": 0, "max": 3.0, "mean": 2.0, "nan": 1, "inf": 2,
    }  # fmt: skip
    assert list(result.truncated) == ["ranges"]
    assert 'Summarised: ranges. For more, give `fields`, such as fields=["ranges[0:100]"], or' in summarised(
        result.truncated
    )


def test_a_long_scan_says_where_its_smallest_range_is(definitions: Definitions) -> None:
    scan = {"angle_min": -1.5, "angle_increment": 0.5, "ranges": ["nan", 2.0, "-inf", 9.0, 0.5, 3.0]}
    ranges = shown(definitions, SCAN, scan, max_array=2).value["ranges"]
    assert (ranges["min"], ranges["min_at"], ranges["min_at_angle"]) == (0.5, 4, 0.5)
    contradicted = shown(definitions, SCAN, {**scan, "angle_max": 40.0}, max_array=2).value["ranges"]
    assert (contradicted["min_at"], contradicted.get("min_at_angle")) == (4, None)


def test_summaries_of_other_lists(definitions: Definitions) -> None:
    value = {"words": ["a", "b"], "flags": [True, False], "longs": [2**60, 0], "blob": [1, 2], "numbers": [{}, {}]}
    result = shown(definitions, LISTS, value, max_array=1).value
    assert result["words"] == {"$summary": "string[]", "length": 2, "first": ["a"], "omitted": 1}
    assert result["flags"] == {"$summary": "bool[]", "length": 2, "first": [True], "omitted": 1, "true": 1}
    assert result["longs"]["max"] == str(2**60)
    assert result["blob"] == {"$summary": "uint8[]", "length": 2}
    assert len(result["numbers"]["first"]) == 1


def test_an_array_without_a_finite_value_has_no_statistics(definitions: Definitions) -> None:
    result = shown(definitions, SCAN, {"ranges": ["nan", "nan"]}, max_array=0).value["ranges"]
    assert (result["min"], result["max"], result["mean"], result["nan"]) == (None, None, None, 2)


def test_a_summary_cannot_be_published(definitions: Definitions) -> None:
    result = shown(definitions, SCAN, {"angle_increment": 0.5, "ranges": [1.0] * 100}).value
    with pytest.raises(BadValue, match="ranges: this is a summary"):
        check(definitions, SCAN, result)


def test_a_long_text_is_summarised_and_a_broken_one_explained(codec: Codec) -> None:
    name = "std_msgs/msg/String"
    assert shown(codec.definitions, name, {"data": "x" * 3000}).value["data"] == {
        "$summary": "string", "length": 3000, "first": "x" * 2048,
    }  # fmt: skip
    message = codec.decode(name, b"\0\1\0\0\5\0\0\x0020\xb0C\0")
    result = render(codec.definitions, name, message, options=RenderOptions(exact=True))
    assert result.value["data"] == {"$summary": "string", "not_utf8": "20\\xb0C"}
    assert list(result.truncated) == ["data"]


def test_a_text_that_was_cut_is_read_to_its_end_by_what_the_hints_say(definitions: Definitions) -> None:
    text = "".join(f'<joint name="j{number}"/>' for number in range(1500))
    name = "std_msgs/msg/String"
    result = shown(definitions, name, {"data": text}, max_bytes=10_000)
    found, hint = text[:2048], result.truncated["data"]
    assert len(result.value["data"]["first"]) == 2048 and "(characters)" in summarised(result.truncated)
    while not found.endswith(text[-30:]):
        part = shown(definitions, name, {"data": text}, max_bytes=10_000, fields=[hint])
        assert not part.truncated
        found += part.value[hint]
        hint = f"data[{len(found)}:{len(found) + 8000}]"
    assert found == text
    too_long = shown(definitions, name, {"data": text}, max_bytes=10_000, fields=["data[100:]"])
    shown_to = 100 + len(too_long.value["data[100:]"]["first"])
    assert too_long.truncated == {"data[100:]": f"data[{shown_to}:{shown_to + 8000}]"}


def test_parts_of_texts_are_counted_as_slices_are(definitions: Definitions) -> None:
    fields = ["data[1:4]", "data[-2:]", "data[::2]", "data[9:]"]
    found = shown(definitions, "std_msgs/msg/String", {"data": "abcdef"}, fields=fields).value
    assert found == {"data[1:4]": "bcd", "data[-2:]": "ef", "data[::2]": "ace", "data[9:]": ""}


@pytest.mark.parametrize("budget", [15_000, 8_000, 1_000, 200, 60])
def test_the_budget_holds_for_anything(definitions: Definitions, budget: int) -> None:
    poses = {"poses": [{"header": {"frame_id": "map" * 100}, "pose": {"position": {"x": n / 3}}} for n in range(500)]}
    for name, value in (
        (PATH, poses),
        (SCAN, {"ranges": [0.123] * 5000}),
        ("std_msgs/msg/String", {"data": "é" * 9999}),
    ):
        result = shown(definitions, name, value, max_array=10**9, max_string=10**9, max_bytes=budget)
        text = json.dumps(result.value, ensure_ascii=False, separators=(",", ":"), allow_nan=False)
        assert len(text.encode()) == result.bytes <= budget
        assert result.truncated


def test_the_budget_takes_no_more_than_it_must(definitions: Definitions) -> None:
    value = {"ranges": [0.1234567] * 1000, "intensities": [1.0] * 10}
    assert len(shown(definitions, SCAN, value).value["ranges"]["first"]) == 16
    assert len(shown(definitions, SCAN, value, max_bytes=480).value["ranges"]["first"]) == 4
    assert not shown(definitions, SCAN, value, max_array=1000).truncated


def test_selected_fields_are_a_flat_mapping(definitions: Definitions) -> None:
    value = {"numbers": [{"i8": 1}, {"i8": 2}, {"i8": 3}], "words": ["a", "b"], "longs": list(range(200))}
    fields = [
        "numbers[1].i8", "numbers[*].i8", "numbers[-2:].i8", "words[-1]", "longs[100:180]", "longs[::50]",
        "pair[0].flag",
    ]  # fmt: skip
    assert shown(definitions, LISTS, value, fields=fields).value == {
        "numbers[1].i8": 2, "numbers[*].i8": [1, 2, 3], "numbers[-2:].i8": [2, 3], "words[-1]": "b",
        "longs[100:180]": list(range(100, 180)), "longs[::50]": [0, 50, 100, 150], "pair[0].flag": True,
    }  # fmt: skip


def test_a_selected_slice_is_full_up_to_the_budget(definitions: Definitions) -> None:
    value = {"ranges": [0.5] * 100_000}
    assert len(shown(definitions, SCAN, value, fields=["ranges[0:5000]"]).value["ranges[0:5000]"]) == 5000
    cut = shown(definitions, SCAN, value, fields=["ranges[0:50000]"])
    assert cut.value["ranges[0:50000]"]["length"] == 50_000
    assert list(cut.truncated) == ["ranges[0:50000]"]


def test_a_selected_text_is_full_up_to_the_budget(definitions: Definitions) -> None:
    value = {"data": "x" * 10_000}
    assert shown(definitions, "std_msgs/msg/String", value, fields=["data"]).value == value
    assert shown(definitions, "std_msgs/msg/String", value, fields=["data"], max_bytes=5000).truncated == {
        "data": "data[2500:10500]"
    }


def test_a_selected_element_of_numbers_is_plain_json(definitions: Definitions) -> None:
    value = {"ranges": [0.1, "nan"]}
    assert shown(definitions, SCAN, value, fields=["ranges[0]", "ranges[1]"]).value == {
        "ranges[0]": 0.1,
        "ranges[1]": "nan",
    }


def test_statistics_of_extreme_numbers_do_not_fail(definitions: Definitions) -> None:
    result = shown(definitions, "std_msgs/msg/Float64MultiArray", {"data": [1.7e308] * 3}, max_array=0).value["data"]
    assert (result["max"], result["mean"]) == (1.7e308, "inf")


def test_an_example_is_whole_and_accepted(codec: Codec) -> None:
    example = example_of(codec.definitions, LISTS)
    assert example["three"] == [1.0, 2.5, -3.0] and example["id"] == [0] * 16 and example["numbers"] == []
    there_and_back(codec, LISTS, example)


def test_what_is_hidden_does_not_make_a_message_longer_than_it_may_be(codec: Codec) -> None:
    for value in ({"free": "a\u00ad" * 1000}, {"many": ["\x1b-\u200b-"] * 60}):
        rendered = shown(codec.definitions, "odd_msgs/msg/Texts", value, max_bytes=4000)
        assert len(visible_json(rendered.value)[1].encode()) <= 4000


def test_random_messages_come_back_within_the_bounds_or_say_that_they_were_cut(codec: Codec) -> None:
    dice = random.Random(3)
    for _ in range(50):
        value = {"inner": [
            {"deep": [{"values": [dice.random()] * dice.randint(0, 90)}] * dice.randint(0, 5), "name": "n"}
            for _ in range(dice.randint(0, 6))
        ]}  # fmt: skip
        result = shown(codec.definitions, "odd_msgs/msg/Outer", value, max_bytes=3000)
        assert result.bytes <= 3000
        if not result.truncated:
            there_and_back(codec, "odd_msgs/msg/Outer", value)


def test_an_element_beyond_the_list_says_how_long_it_is(definitions: Definitions) -> None:
    with pytest.raises(BadValue, match=r"ranges\[5\]: there is no element \[5\], only \[0\] to \[1\]\."):
        shown(definitions, SCAN, {"ranges": [0.1, 0.2]}, fields=["ranges[5]"])
