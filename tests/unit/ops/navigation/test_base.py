"""Who else commands the base that Nav2 drives, and which parameters say that it may not move."""

from __future__ import annotations

from collections.abc import Sequence

import pytest

from ros2_mcp.model.graph import TopicEndpoints
from ros2_mcp.model.qos import Endpoint, QoS
from ros2_mcp.ops.navigation.base import chain_of, is_greatest_speed, is_zero, others_of

TWIST = "geometry_msgs/msg/Twist"


def topic(name: str, publishers: Sequence[str], subscribers: Sequence[str], ours: Sequence[str] = ()) -> TopicEndpoints:
    def ends(nodes: Sequence[str]) -> list[Endpoint]:
        return [Endpoint(node, TWIST, "", "", QoS(), node in ours) for node in nodes]

    return TopicEndpoints(name, ends(publishers), ends(subscribers))


def said(*present: TopicEndpoints) -> list[str]:
    return [other.sentence(sends=False) for other in others_of(present, *chain_of(present))]


def test_through_smoother_and_multiplexer_everybody_else_is_found() -> None:
    chain = (
        topic("/cmd_vel_nav", ["/controller_server", "/behavior_server"], ["/velocity_smoother"]),
        topic("/cmd_vel_smoothed", ["/velocity_smoother"], ["/twist_mux"]),
        topic("/base/cmd_vel", ["/twist_mux"], ["/base_driver"]),
    )
    assert said(*chain) == []
    joy = topic("/joy_vel", ["/joy_teleop"], ["/twist_mux"])
    assert said(*chain, joy) == [
        "/joy_teleop may send velocities on /joy_vel, to which /twist_mux listens beside Nav2."
    ]
    foreign = topic("/base/cmd_vel", ["/twist_mux", "/one", "/other"], ["/base_driver"])
    assert said(*chain[:2], foreign) == ["/one, /other may send velocities on /base/cmd_vel, as Nav2 does."]


def test_this_server_another_robot_and_what_nobody_hears_are_nobody_else() -> None:
    nav = topic("/cmd_vel", ["/controller_server", "/bridge"], ["/base"], ours=["/bridge"])
    assert said(nav, topic("/arm/cmd_vel", ["/teleop"], ["/arm"]), topic("/unused", ["/teleop"], [])) == []
    assert said(topic("/cmd_vel", ["/teleop"], ["/base"])) == [], "no Nav2, no foreign publisher"


@pytest.mark.parametrize(
    ("name", "is_one"),
    [
        ("max_linear_speed", True), ("FollowPath.max_vel_x", True), ("FollowPath.max_vel_theta", True),
        ("FollowPath.vx_max", True), ("FollowPath.wz_max", True), ("FollowPath.desired_linear_vel", True),
        ("max_velocity", True), ("linear.x.max_velocity", True), ("angular.z.max_velocity", True),
        ("FollowPath.max_vel_y", False), ("FollowPath.vy_max", False), ("FollowPath.min_speed_xy", False),
        ("min_velocity", False), ("max_accel", False), ("linear.x.max_acceleration", False),
        ("max_planning_time", False), ("FollowPath.max_angular_accel", False), ("linear.y.max_velocity", False),
    ],
)  # fmt: skip
def test_a_greatest_speed_is_known_by_its_name(name: str, is_one: bool) -> None:
    assert is_greatest_speed(name) == is_one


def test_only_0_ahead_is_a_limit_that_holds_the_robot() -> None:
    assert is_zero(0) and is_zero(0.0) and is_zero([0.0, 0.0, 1.0])
    assert not any(map(is_zero, (0.1, [0.5, 0.0, 0.0], [], False, None, "0", float("nan"))))
