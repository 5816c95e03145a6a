from __future__ import annotations

from typing import Any

import pytest

from ros2_mcp.model.arguments import Argument, shown, values_of
from ros2_mcp.model.errors import BadInput


@pytest.mark.parametrize(
    ("kind", "text", "value"),
    [
        ("number", " 2.50 ", 2.5),
        ("number", "-3e2", -300.0),
        ("integer", "7", 7),
        ("boolean", "False", False),
        ("boolean", "1", True),
        ("topic", "scan", "/scan"),
        ("topics", "scan, /odom,", ["/scan", "/odom"]),
        ("topics", '["/scan", "odom"]', ["/scan", "/odom"]),
        ("topics", """['/scan', "odom",]""", ["/scan", "/odom"]),
        ("services", "('/reset',)", ["/reset"]),
        ("list", "[]", []),
        ("list", "pose.x, ranges[0:3]", ["pose.x", "ranges[0:3]"]),
        ("message_type", "sensor_msgs/LaserScan", "sensor_msgs/msg/LaserScan"),
        ("string", " kept {{as}} it is ", "kept {{as}} it is"),
    ],
)
def test_text_becomes_a_value_of_its_kind(kind: str, text: str, value: Any) -> None:
    assert Argument("a", "", kind).value(text) == value


@pytest.mark.parametrize(
    ("argument", "text"),
    [
        (Argument("speed", "", "number"), "fast"),
        (Argument("speed", "", "number"), "nan"),
        (Argument("speed", "", "number", minimum=0, maximum=2), "2.1"),
        (Argument("speed", "", "integer"), "1.5"),
        (Argument("speed", "", "boolean"), "maybe"),
        (Argument("speed", "", choices=("slow", "fast")), "faster"),
        (Argument("speed", "", "topic"), "a b"),
        (Argument("speed", "", "topics"), "/ok, not ok"),
        (Argument("speed", "", "list"), "[1, 2]"),
        (Argument("speed", "", "list"), '["open'),
        (Argument("speed", "", "list"), "['a', 2]"),
        (Argument("speed", "", "list"), "[__import__('os').getcwd()]"),
        (Argument("speed", "", "list"), "[" * 5000),
        (Argument("speed", "", "message_type"), "Twist"),
    ],
)
def test_a_wrong_text_is_refused_with_the_argument_the_text_and_what_is_allowed(argument: Argument, text: str) -> None:
    with pytest.raises(BadInput) as refused:
        argument.value(text)
    assert all(part in str(refused.value) for part in ("speed", repr(text), argument.allowed()))


def test_what_is_not_given_gets_its_default_and_empty_text_is_not_given() -> None:
    arguments = [Argument("a", "", "number", default=2.0), Argument("b", "", "topic"), Argument("c", "", default="x")]
    assert values_of(arguments, {"b": "/odom", "c": " "}) == {"a": 2.0, "b": "/odom", "c": "x"}


def test_none_and_null_are_not_given_unless_they_may_be_meant() -> None:
    arguments = [Argument("a", "", "number", default=2.0), Argument("b", "", "list", default=[]), Argument("c", "")]
    assert values_of(arguments, {"a": "None", "b": "null", "c": "None"}) == {"a": 2.0, "b": [], "c": "None"}


def test_a_needed_argument_that_is_missing_is_named() -> None:
    with pytest.raises(BadInput, match=r"needs the argument topic.*the name of a topic"):
        values_of([Argument("topic", "Where", "topic", required=True)], {})


def test_an_unknown_argument_is_an_error_with_the_nearest_name() -> None:
    with pytest.raises(BadInput, match=r"no argument 'durration_sec'\. Did you mean duration_sec"):
        values_of([Argument("duration_sec", "", "number", default=1.0)], {"durration_sec": "3"})


def test_values_are_shown_as_people_write_them() -> None:
    assert [shown(value) for value in (True, 5.0, 2.5, ["a", "b"], None, "x")] == ["true", "5", "2.5", "a, b", "", "x"]
