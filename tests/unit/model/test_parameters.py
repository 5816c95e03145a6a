from __future__ import annotations

import math
from typing import Any

import pytest

from ros2_mcp.model import parameters
from ros2_mcp.model.errors import BadValue


@pytest.mark.parametrize(
    ("value", "declared", "field", "taken"),
    [
        (1, "double", "double_value", 1),
        ("nan", "double", "double_value", "nan"),
        (3.0, "integer", "integer_value", 3),
        (str(2**60), "integer", "integer_value", 2**60),
        (str(-(2**63)), "integer", "integer_value", -(2**63)),
        (True, "bool", "bool_value", True),
        ("3", "string", "string_value", "3"),
        ([1, 2.0], "integer_array", "integer_array_value", [1, 2]),
        ([], "string_array", "string_array_value", []),
        ([0, 255], "byte_array", "byte_array_value", [0, 255]),
        ("AAE=", "byte_array", "byte_array_value", "AAE="),
    ],
)
def test_a_value_of_the_declared_type_is_taken(value: Any, declared: str, field: str, taken: Any) -> None:
    message = parameters.as_message("p", value, declared)
    assert message == {"type": parameters.TYPES.index(declared), field: taken}
    assert type(message[field]) is type(taken)
    assert parameters.value_of(message) == taken


@pytest.mark.parametrize(
    ("value", "declared", "path"),
    [
        ("3", "integer", "p"),
        (True, "integer", "p"),
        (3.5, "integer", "p"),
        (math.inf, "integer", "p"),
        (math.nan, "integer", "p"),
        (2**63, "integer", "p"),
        (1e300, "integer", "p"),
        ("-", "integer", "p"),
        ("²", "integer", "p"),
        (None, "integer", "p"),
        (True, "double", "p"),
        ("1.5", "double", "p"),
        ([1.0], "double", "p"),
        (1, "bool", "p"),
        ("true", "bool", "p"),
        (3, "string", "p"),
        ("ab", "string_array", "p"),
        ([1, "x"], "integer_array", "p[1]"),
        ([256], "byte_array", "p[0]"),
        ([1, -1], "byte_array", "p[1]"),
        ({"a": 1}, "string", "p"),
    ],
)
def test_a_value_of_another_type_is_refused_where_it_stands(value: Any, declared: str, path: str) -> None:
    with pytest.raises(BadValue) as caught:
        parameters.as_message("p", value, declared)
    assert caught.value.path == path


@pytest.mark.parametrize("declared", ["integer", "string", "bool_array", "byte_array", "dynamic"])
def test_a_long_value_is_not_repeated_in_its_error(declared: str) -> None:
    value = [{"a": "x" * 1_000_000}] if declared in ("string", "dynamic") else "x" * 1_000_000 + "é"
    with pytest.raises(BadValue) as caught:
        parameters.as_message("p", value if declared != "byte_array" else [value], declared)
    assert len(str(caught.value)) < 250 and "xxx" in str(caught.value)


@pytest.mark.parametrize("declared", ["dynamic", "not_set"])
@pytest.mark.parametrize(
    ("value", "kind"),
    [
        (True, "bool"),
        (1, "integer"),
        (1.0, "double"),
        ("1", "string"),
        ([1, 2], "integer_array"),
        ([1, 2.5], "double_array"),
        (["a"], "string_array"),
        (None, "not_set"),
    ],
)
def test_without_a_declared_type_the_value_says_it(value: Any, kind: str, declared: str) -> None:
    message = parameters.as_message("p", value, declared)
    assert parameters.type_name(message["type"]) == kind
    assert parameters.value_of(message) == value


@pytest.mark.parametrize("value", [[], [1, "a"], [True, 1], [[1]], [None], {}, {"a": 1}])
def test_what_can_be_no_parameter_is_refused(value: Any) -> None:
    with pytest.raises(BadValue):
        parameters.as_message("p", value, "dynamic")


def test_a_type_that_is_not_known_yet_has_a_name_and_no_value() -> None:
    assert parameters.type_name(77) == "unknown(77)"
    assert parameters.value_of({"type": 77}) is None
