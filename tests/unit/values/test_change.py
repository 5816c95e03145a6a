"""What counts as a change of a message, and how fields are mapped to another type."""

from __future__ import annotations

from typing import Any

import pytest

from ros2_mcp.model.errors import BadInput, BadValue
from ros2_mcp.values.cdr import Codec
from ros2_mcp.values.change import ChangeDetector
from ros2_mcp.values.check import check
from ros2_mcp.values.definitions import Definitions, DefinitionText
from ros2_mcp.values.mapping import FieldMapping

TEXTS = {
    "std_msgs/msg/Header": "builtin_interfaces/Time stamp\nstring frame_id\n",
    "a_pkg/msg/Point": "float64 x\nfloat64 y\n",
    "a_pkg/msg/Part": "std_msgs/Header header\nPoint at\n",
    "a_pkg/msg/State": (
        "std_msgs/Header header\nstring from\nPoint at\nuint64 count\n"
        "float32[] ranges\nPart[] parts\nint8 small\nbool on\n"
    ),
    "a_pkg/msg/Flat": "float64 x\nint8 small\nfloat32[] ranges\nPoint at\nstring text\nstd_msgs/Header header\n",
}
STATE, FLAT = "a_pkg/msg/State", "a_pkg/msg/Flat"


@pytest.fixture
def codec() -> Codec:
    definitions = Definitions()
    definitions.add({name: DefinitionText("msg", text) for name, text in TEXTS.items()})
    return Codec(definitions)


def data(codec: Codec, kind: str = STATE, **value: Any) -> bytes:
    return codec.encode(kind, check(codec.definitions, kind, value))


def changes(codec: Codec, tolerances: dict[str, float], *values: dict[str, Any]) -> list[bool]:
    detector = ChangeDetector(codec, STATE, tolerances)
    return [detector.is_change(data(codec, **value)) for value in values]


def test_the_first_message_is_a_change_and_the_same_again_is_none(codec) -> None:
    value = {"at": {"x": "nan"}, "ranges": [1.0, "nan"]}
    assert changes(codec, {}, value, value, {**value, "on": True}, value) == [True, False, True, True]


def test_stamps_of_headers_never_count_but_frames_do(codec) -> None:
    def at(second: int, frame: str = "map") -> dict[str, Any]:
        header = {"stamp": {"sec": second}, "frame_id": frame}
        return {"header": header, "parts": [{"header": header}]}

    assert changes(codec, {}, at(1), at(2), at(3, "odom")) == [True, False, True]


def test_padding_between_fields_never_counts(codec) -> None:
    detector = ChangeDetector(codec, FLAT, {})
    clean = data(codec, FLAT, small=1)
    dirty = bytearray(clean)
    dirty[4 + 9 : 4 + 12] = b"\xaa\xbb\xcc"
    assert [detector.is_change(clean), detector.is_change(bytes(dirty))] == [True, False]


def test_a_tolerance_is_measured_from_the_last_change(codec) -> None:
    values = [{"at": {"x": x}} for x in (0.0, 0.5, -0.5, 0.75, 1.0, 1.25)]
    assert changes(codec, {"at.x": 0.5}, *values) == [True, False, False, True, False, False]


def test_a_field_without_a_tolerance_counts_when_it_differs_at_all(codec) -> None:
    assert changes(codec, {"at.x": 1.0}, {}, {"at": {"x": 0.5}}, {"at": {"y": 1e-12}}) == [True, False, True]


def test_a_star_is_the_tolerance_of_every_number(codec) -> None:
    values: list[dict[str, Any]] = [
        {},
        {"at": {"x": 0.5, "y": 0.5}, "small": 1},
        {"small": 3},
        {"small": 3, "on": True},
    ]
    assert changes(codec, {"*": 1.0}, *values) == [True, False, True, True]


def test_not_a_number_differs_from_every_number_only(codec) -> None:
    values = [{"at": {"x": x}} for x in (0.0, "nan", "nan", 0.0, "inf", "inf", "-inf")]
    assert changes(codec, {"at.x": 1e300}, *values) == [True, True, False, True, True, False, True]


def test_arrays_have_tolerances_and_their_length_counts(codec) -> None:
    values = [{"ranges": ranges} for ranges in ([1.0, 2.0], [1.1, 1.9], [1.0, 2.5], [1.0, 2.5, 2.5])]
    assert changes(codec, {"ranges": 0.25}, *values) == [True, False, True, True]


def test_large_integers_are_compared_exactly(codec) -> None:
    values = [{"count": str(count)} for count in (2**63, 2**63 + 1, 2**63 + 2, 0, 2**64 - 1)]
    assert changes(codec, {"count": 1}, *values) == [True, False, True, True, True]


@pytest.mark.parametrize("path", ["at", "on", "from", "nothing", "parts.at.x", "ranges[0]", "parts"])
def test_a_tolerance_that_cannot_be_is_refused_by_its_path(codec, path) -> None:
    with pytest.raises(BadValue, match=path.replace("[", r"\[")):
        ChangeDetector(codec, STATE, {path: 1.0})


def test_a_negative_tolerance_is_refused(codec) -> None:
    with pytest.raises(BadValue, match="not negative"):
        ChangeDetector(codec, STATE, {"at.x": -1.0})


def test_fields_go_to_fields_of_another_type(codec) -> None:
    mapping = {"x": "at.y", "at": "at", "ranges": "ranges", "text": "from", "header": "header", "small": "count"}
    mapped = FieldMapping(codec, STATE, FLAT, mapping)
    header = {"stamp": {"sec": 7, "nanosec": 8}, "frame_id": "map"}
    source = data(codec, at={"x": "inf", "y": "nan"}, ranges=[1.5, "-inf"], **{"from": "é"}, header=header, count=5)
    expected = {"x": "nan", "at": {"x": "inf", "y": "nan"}, "ranges": [1.5, "-inf"], "text": "é", "small": 5}
    assert mapped.apply(source) == data(codec, FLAT, header=header, **expected)


def test_a_value_that_the_destination_cannot_hold_is_named(codec) -> None:
    mapped = FieldMapping(codec, STATE, FLAT, {"small": "count"})
    with pytest.raises(BadValue, match="small"):
        mapped.apply(data(codec, count=1000))


@pytest.mark.parametrize("mapping", [{"text": "at"}, {"at": "count"}, {"x": "from"}, {"y": "at.y"}, {"x": "at.z"}])
def test_a_mapping_that_never_fits_is_refused_at_once(codec, mapping) -> None:
    with pytest.raises(BadValue):
        FieldMapping(codec, STATE, FLAT, mapping)


def test_a_mapping_gives_no_field_twice(codec) -> None:
    with pytest.raises(BadInput, match="a part of it"):
        FieldMapping(codec, STATE, FLAT, {"at": "at", "at.x": "at.y"})
