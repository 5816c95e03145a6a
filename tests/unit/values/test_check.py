import base64

import pytest

from ros2_mcp.model.errors import BadValue
from ros2_mcp.values.cdr import Codec
from ros2_mcp.values.check import check, missing_fields
from ros2_mcp.values.definitions import Definitions

NUMBERS = "odd_msgs/msg/Numbers"
LISTS = "odd_msgs/msg/Lists"
TEXTS = "odd_msgs/msg/Texts"


def problem(definitions: Definitions, name: str, value: object, **options: bool) -> BadValue:
    with pytest.raises(BadValue) as caught:
        check(definitions, name, value, **options)
    return caught.value


@pytest.mark.parametrize(
    ("field", "given", "stored"),
    [
        ("f64", 1, 1.0), ("f64", "nan", "nan"), ("f64", "-inf", "-inf"), ("f32", 0.1, 0.1), ("f64", 2**60, 2.0**60),
        ("f64", "NaN", "nan"), ("f32", "Infinity", "inf"), ("f64", "-INFINITY", "-inf"), ("f64", "+inf", "inf"),
        ("i8", 3.0, 3), ("i8", -128, -128), ("u64", str(2**64 - 1), 2**64 - 1),
        ("i64", "-9223372036854775808", -(2**63)), ("octet", 255, 255), ("flag", False, False),
    ],
)  # fmt: skip
def test_what_fits_without_loss_is_taken(definitions: Definitions, field: str, given: object, stored: object) -> None:
    value = getattr(check(definitions, NUMBERS, {field: given}), field)
    assert (str(value) if isinstance(stored, str) else value) == stored
    assert type(value) is (float if field.startswith("f") and field != "flag" else type(stored))


@pytest.mark.parametrize(
    ("field", "given", "message", "hint"),
    [
        ("flag", "false", '"false" given, bool expected', "without quotes"),
        ("flag", 0, "0 given, bool expected", "true or false"),
        ("u8", 300, "300 given, uint8, 0 to 255, expected", ""),
        ("i8", -129, "-128 to 127", ""),
        ("i8", 2.5, "2.5 given, int8 expected", "Round it"),
        ("i8", True, "true given, int8 expected", ""),
        ("i8", "5", '"5" given, int8 expected', "without quotes"),
        ("i64", 1e17, "1e+17 given", "beyond 2^53"),
        ("i64", "1.5", '"1.5" given', ""),
        ("i64", "nan", '"nan" given', ""),
        ("u64", str(2**64), "0 to 18446744073709551615", ""),
        ("i64", None, "null given", ""),
        ("f32", 1e39, "1e+39 given, float32", ""),
        ("f64", 2**53 + 1, "9007199254740993 given", "no exact one"),
        ("f64", 10**400, "given, float64 expected", "no exact one"),
        ("f64", "1.5", '"1.5" given', "without quotes"),
        ("f64", True, "true given", ""),
        ("f64", [1.0], "[1.0] given", ""),
    ],
)
def test_what_does_not_fit_is_refused(
    definitions: Definitions, field: str, given: object, message: str, hint: str
) -> None:
    error = problem(definitions, NUMBERS, {field: given})
    assert error.path == field
    assert message in error.message and hint in error.hint


def test_an_unknown_field_names_its_path_the_nearest_and_all_others(definitions: Definitions) -> None:
    error = problem(definitions, "geometry_msgs/msg/PoseArray", {"poses": [{}, {"position": {"X": 1}}]})
    assert error.path == "poses[1].position.X"
    assert error.hint == "Did you mean x? Its fields are x, y, z."


@pytest.mark.parametrize(
    ("value", "path", "message"),
    [
        ({"three": [1, 2]}, "three", "2 elements given; float64[3] takes exactly 3"),
        ({"few": [1, 2, 3]}, "few", "3 elements given; int32[<=2] takes at most 2"),
        ({"few": [1, 2**31]}, "few[1]", "2147483648 given, int32"),
        ({"pair": [{}, {"u8": -1}]}, "pair[1].u8", "-1 given"),
        ({"numbers": [5]}, "numbers[0]", "5 given, an object with the fields of odd_msgs/msg/Numbers"),
        ({"words": "abc"}, "words", '"abc" given, string[] expected'),
        ({"words": [1]}, "words[0]", "1 given, string expected"),
        ({"flags": [True, 1]}, "flags[1]", "1 given, bool"),
        ({"blob": "not base64!"}, "blob", "is not base64"),
        ({"blob": [256]}, "blob[0]", "256 given"),
        ({"id": "AAAA"}, "id", "3 elements given; uint8[16] takes exactly 16"),
        ([], "", "[] given, an object with the fields of odd_msgs/msg/Lists"),
    ],
)
def test_errors_in_lists_name_the_element(definitions: Definitions, value: object, path: str, message: str) -> None:
    error = problem(definitions, LISTS, value)
    assert error.path == path
    assert message in error.message


def test_bounds_of_texts_count_what_is_encoded(definitions: Definitions) -> None:
    check(definitions, TEXTS, {"short": "hällo"[:4], "narrow": "äöü"})
    assert "6 bytes; string<=5" in problem(definitions, TEXTS, {"short": "hällo"}).message
    assert "4 characters; wstring<=3" in problem(definitions, TEXTS, {"narrow": "😀😀"}).message
    assert "half a character" in problem(definitions, TEXTS, {"free": "\ud83d"}).message


def test_a_text_that_ros_would_cut_is_refused(definitions: Definitions) -> None:
    assert "NUL" in problem(definitions, TEXTS, {"short": "a\0b"}).message
    assert check(definitions, TEXTS, {"narrow": "a\0b"}).narrow == "a\0b"  # rclpy keeps it in a wstring


def test_bytes_may_be_a_list_or_base64(codec: Codec) -> None:
    def encoded(value: object) -> bytes:
        return codec.encode(LISTS, check(codec.definitions, LISTS, {"blob": value}))

    assert encoded([1, 2, 255]) == encoded(base64.b64encode(b"\1\2\xff").decode())


def test_big_float32_values_in_lists_are_refused_and_infinities_kept(definitions: Definitions) -> None:
    name = "odd_msgs/msg/Deep"
    assert check(definitions, name, {"values": [1.0, float("inf")]}).values.tolist() == [1.0, float("inf")]
    assert check(definitions, name, {"values": [1, "nan", 0.5]}).values[2] == 0.5
    assert problem(definitions, name, {"values": [1.0, 1e39]}).path == "values[1]"


def test_a_list_of_integers_and_fractions_is_exact_or_refused(definitions: Definitions) -> None:
    name = "std_msgs/msg/Float64MultiArray"
    assert check(definitions, name, {"data": [1, 0.5, -(2**53)]}).data.tolist() == [1.0, 0.5, -(2.0**53)]
    assert problem(definitions, name, {"data": [0.5, 2**53 + 1]}).path == "data[1]"


@pytest.mark.parametrize(
    ("name", "given", "message"),
    [
        (
            "geometry_msgs/msg/PoseWithCovariance",
            {"covariance": {"$diagonal": [1, 2, 3]}},
            "3 elements given in $diagonal",
        ),
        ("geometry_msgs/msg/PoseWithCovariance", {"covariance": {"$diagonal": ["x"] * 6}}, '"x" given'),
        ("geometry_msgs/msg/PoseWithCovariance", {"covariance": {"$diagonal": 1}}, "1 given"),
        ("geometry_msgs/msg/PoseWithCovariance", {"covariance": {"$diagonal": [0] * 6, "x": 1}}, "given, float64[36]"),
        (LISTS, {"three": {"$diagonal": [1, 2, 3]}}, "a square covariance matrix"),
        ("unique_identifier_msgs/msg/UUID", {"uuid": {"$diagonal": [1] * 4}}, "a square covariance matrix"),
        (LISTS, {"longs": {"$diagonal": [1]}}, "a square covariance matrix"),
    ],
)
def test_a_diagonal_is_one_of_a_square_matrix(
    definitions: Definitions, name: str, given: dict[str, object], message: str
) -> None:
    error = problem(definitions, name, given)
    assert message in error.message and error.path.startswith(next(iter(given)))


def test_a_summary_is_never_taken_for_a_value(definitions: Definitions) -> None:
    for value in ({"three": {"$summary": "float64[3]"}}, {"words": [{"$summary": "string"}]}, {"$summary": LISTS}):
        error = problem(definitions, LISTS, value)
        assert "this is a summary" in error.message


def test_missing_fields_take_their_defaults_and_can_be_named(definitions: Definitions) -> None:
    message = check(definitions, NUMBERS, {"i8": 1})
    assert (message.i64, message.f64, message.flag, message.u8) == (-5, 1.5, True, 0)
    assert check(definitions, LISTS, {}).pair[1].f64 == 1.5
    assert missing_fields(definitions, "odd_msgs/srv/Add_Request", {"b": 1}) == ["a"]
    assert problem(definitions, "odd_msgs/srv/Add_Request", {"b": 1}, partial=False).path == "a"
