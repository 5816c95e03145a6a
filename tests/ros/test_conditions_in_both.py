"""A condition means the same in the server, on messages of rosbags, and in the bridge, on messages of rclpy."""

from __future__ import annotations

import json
import random
import re
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("rclpy", reason="needs the ROS 2 wheels, or a sourced ROS 2")

from rclpy.serialization import deserialize_message

from ros2_mcp.model.errors import BadInput, BadValue
from ros2_mcp.ops.measure.expression import condition
from ros2_mcp.values.check import check
from ros2_mcp.values.definitions import Definitions
from ros2_mcp.values.select import known_to
from ros2_mcp_bridge.ros import interfaces
from ros2_mcp_bridge.ros.message_types import MessageTypes
from ros2_mcp_common.language import conditions
from ros2_mcp_common.language.paths import PathError
from support.made_windows import CODEC

PAGE = Path(__file__).parents[2] / "docs/reference/conditions.md"
EXAMPLES = [
    (type_name, text, json.loads(value))
    for type_name, text, value in re.findall(r"^\| `(\w+/msg/\w+)` \| `(.+)` \| `(\{.*\})` \|$", PAGE.read_text(), re.M)
]
DEFINITIONS: Definitions = CODEC.definitions
REFLECTED = (
    "nav_msgs/msg/Odometry",
    "sensor_msgs/msg/BatteryState",
    "visualization_msgs/msg/Marker",
    "diagnostic_msgs/msg/DiagnosticStatus",
    "nav_msgs/msg/OccupancyGrid",
    "shape_msgs/msg/SolidPrimitive",
    "std_msgs/msg/Empty",
)
NUMBERS = (0, 1, 2, 3.5, -1.25, 0.5, 5, "nan", "inf", "-inf", 1e9)


def in_both(type_name: str, text: str, value: object) -> tuple[Any, ...]:
    """What the condition says of a value in the server; the bridge says the same."""
    data = CODEC.encode(type_name, check(DEFINITIONS, type_name, value))
    message_class = interfaces.load(type_name)
    server, bridge = (
        condition(DEFINITIONS, type_name, text),
        conditions.condition(MessageTypes(message_class), type_name, text),
    )
    answers = []
    for asked, message in ((server, CODEC.decode(type_name, data)), (bridge, deserialize_message(data, message_class))):
        answers.append((asked.holds(message), asked.values(message), asked.why_undecided(message), list(asked.fields)))
    assert answers[0] == answers[1], (text, value)
    return answers[0]


def varied(value: Any, choose: random.Random) -> Any:
    """The same value with other numbers, and lists that are longer or shorter."""
    if isinstance(value, dict):
        return {key: varied(each, choose) for key, each in value.items()}
    if isinstance(value, list):
        return [varied(each, choose) for each in value for _ in range(choose.randint(0, 2))]
    if isinstance(value, bool | str):
        return value
    return choose.choice(NUMBERS) if isinstance(value, float) else choose.choice((0, 1, 2, value))


def test_the_page_has_examples() -> None:
    assert len(EXAMPLES) > 12
    assert PAGE.read_text().count("` | `{") == len(EXAMPLES)


@pytest.mark.parametrize(("type_name", "text", "value"), EXAMPLES, ids=[text for _, text, _ in EXAMPLES])
def test_each_example_of_the_page_means_the_same_in_server_and_bridge(
    type_name: str, text: str, value: dict[str, Any]
) -> None:
    assert in_both(type_name, text, value)[0] is True
    choose = random.Random(text)
    for _ in range(30):
        in_both(type_name, text, varied(value, choose))


@pytest.mark.parametrize(
    ("text", "value", "expected"),
    [
        ("0.1 in position", {"position": [0.1]}, True),
        ("position[5] > 1", {"position": [1]}, None),
        ('name[*] == "a"', {}, "list"),
        ("min(effort) > 0", {"effort": ["nan"]}, None),
    ],
)
def test_lists_are_read_alike(text: str, value: dict[str, Any], expected: object) -> None:
    if expected == "list":
        with pytest.raises(BadInput, match="any"):
            in_both("sensor_msgs/msg/JointState", text, value)
    else:
        assert in_both("sensor_msgs/msg/JointState", text, value)[0] is expected


def test_numbers_of_single_precision_are_compared_alike() -> None:
    scan = {"angle_increment": 0.1, "ranges": [0.1, 0.3], "range_max": 1}
    for text, expected in (
        ("0.1 in ranges", False),
        ("ranges[0] == 0.1", False),
        ("abs(ranges[0] - 0.1) < 1e-6", True),
    ):
        assert in_both("sensor_msgs/msg/LaserScan", text, scan)[0] is expected


@pytest.mark.parametrize(
    ("type_name", "text"),
    [
        ("sensor_msgs/msg/LaserScan", "rnges[0] > 1"),
        ("sensor_msgs/msg/LaserScan", "nearest(1) > 1"),
        ("sensor_msgs/msg/LaserScan", "range_at(header) > 1"),
        ("sensor_msgs/msg/LaserScan", "nearest(-20, 20)"),
        ("sensor_msgs/msg/JointState", "nearest(-20, 20) > 1"),
        ("diagnostic_msgs/msg/DiagnosticArray", "any(status, range_at(0) > 1)"),
        ("diagnostic_msgs/msg/DiagnosticArray", "any(status, lvl == 2)"),
        ("diagnostic_msgs/msg/DiagnosticArray", "status.level == 2"),
        ("std_msgs/msg/Empty", "structure_needs_at_least_one_member == 0"),
        ("std_msgs/msg/Bool", "__class__ == 1"),
    ],
)
def test_what_is_no_condition_is_refused_with_the_same_words(type_name: str, text: str) -> None:
    with pytest.raises((BadInput, BadValue)) as by_server:
        condition(DEFINITIONS, type_name, text)
    with pytest.raises((conditions.ConditionError, PathError)) as by_bridge:
        conditions.condition(MessageTypes(interfaces.load(type_name)), type_name, text)
    assert (by_bridge.value.message, by_bridge.value.hint) == (
        by_server.value.message.removeprefix(f"{getattr(by_server.value, 'path', '')}: "),
        by_server.value.hint,
    )


@pytest.mark.parametrize("type_name", REFLECTED)
def test_the_classes_of_rclpy_tell_of_types_what_the_definitions_say(type_name: str) -> None:
    bridge, server = MessageTypes(interfaces.load(type_name)), known_to(DEFINITIONS)
    told = {name: str(field.type) for name, field in bridge.fields(type_name).items()}
    assert told == {name: str(field.type).replace("char", "uint8") for name, field in server.fields(type_name).items()}
    assert dict(bridge.constants(type_name)) == dict(server.constants(type_name))
