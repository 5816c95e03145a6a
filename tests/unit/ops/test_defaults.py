"""What is said of the fields that nobody gave."""

from __future__ import annotations

from typing import Any

import pytest

from ros2_mcp.ops.acting.defaults import left_at_default
from ros2_mcp.values.definitions import Definitions, DefinitionText


@pytest.mark.parametrize(
    ("type_name", "value", "words"),
    [
        ("std_msgs/msg/Int32", {"data": 3}, ""),
        (
            "geometry_msgs/msg/Twist",
            {"linear": {"x": 0.2, "z": 0.0}},
            "Left at default: linear.y = 0.0, angular (all zero).",
        ),
        (
            "geometry_msgs/msg/Pose",
            {"position": {"x": 1.0, "y": 1.0}},
            "Left at default: position.z = 0.0, orientation (all zero).",
        ),
        ("std_msgs/msg/String", {}, "Left at default: data = «»."),
        (
            "geometry_msgs/msg/TwistStamped",
            {"twist": {"linear": {"x": 1.0, "y": 0.0, "z": 0.0}, "angular": {"x": 0.0, "y": 0.0, "z": 0.0}}},
            "Left at default: header.frame_id = «».",
        ),
        (
            "sensor_msgs/msg/Imu",
            {"header": {}},
            "Left at default: header.stamp (all zero), header.frame_id = «», orientation (all zero), "
            "orientation_covariance (all zero), angular_velocity (all zero), "
            "angular_velocity_covariance (all zero) and 2 more.",
        ),
    ],
)
def test_what_was_sent_without_being_given_is_named_with_its_value(
    definitions: Definitions, type_name: str, value: dict[str, Any], words: str
) -> None:
    assert left_at_default(definitions, type_name, value) == words


def test_defaults_that_are_not_zero_are_named() -> None:
    definitions = Definitions()
    turned = "geometry_msgs/Turn turn\nfloat64[4] matrix [1, 0, 0, 1]\n"
    definitions.add(
        {
            "geometry_msgs/msg/Turn": DefinitionText("msg", "float64 x 0\nfloat64 w 1\n"),
            "geometry_msgs/msg/Turned": DefinitionText("msg", turned),
        }
    )
    said = "Left at default: turn (w = 1.0, the rest zero), matrix ([0] = 1.0, [3] = 1.0, the rest zero)."
    assert left_at_default(definitions, "geometry_msgs/msg/Turned", {}) == said
