"""What was seen of the robot in a session, and what of it has left."""

from __future__ import annotations

from ros2_mcp.model.graph import TopicEndpoints
from ros2_mcp.model.qos import Endpoint, QoS
from ros2_mcp.robot.seen import Left, Seen, is_of_robot

SCAN = "sensor_msgs/msg/LaserScan"


def published(topic: str, *nodes: str) -> dict[str, TopicEndpoints]:
    return {topic: TopicEndpoints(topic, [Endpoint(node, SCAN, "", node, QoS()) for node in nodes], ())}


def test_servers_like_this_one_and_tools_of_the_command_line_are_no_robot() -> None:
    no_robots = ["/ros2_mcp_4711", "/_ros2cli_12", "/_ros2cli_daemon_0_4f2e"]
    assert [is_of_robot(node) for node in [*no_robots, "/lidar", "/ros2_mcp_robot", "(not a ROS node)"]] == [
        *(False for _ in no_robots),
        True,
        True,
        True,
    ]


def test_what_was_seen_and_is_there_has_not_left() -> None:
    seen = Seen()
    seen.note("/lidar", dict.fromkeys(["/scan"], SCAN))
    assert seen.left(["/lidar"], published("/scan", "/lidar")) == Left([])
    assert str(seen.left(["/lidar"], published("/scan", "/lidar"))) == ""
    # it is seen by what it publishes before it is among the nodes
    assert seen.left([], published("/scan", "/lidar")) == Left([])


def test_nodes_that_have_left_are_named_with_what_they_alone_published() -> None:
    seen = Seen()
    seen.note("/lidar", dict.fromkeys(["/scan", "/rosout", "/_hidden"], SCAN))
    seen.note("/base", dict.fromkeys(["/odom"], SCAN))
    seen.note("/rear", dict.fromkeys(["/scan"], SCAN))
    left = seen.left(["/rear"], published("/scan", "/rear"))
    assert left == Left(["/lidar", "/base"], {"/odom": ["/base"]}, {"/odom": SCAN})
    assert str(left) == "Seen earlier in this session, and gone: nodes /base, /lidar; topics /odom."


def test_a_publisher_of_this_server_does_not_stand_in_for_the_robots() -> None:
    seen = Seen()
    seen.note("/nav", dict.fromkeys(["/cmd_vel"], SCAN))
    seen.note("/ros2_mcp_4711", dict.fromkeys(["/light"], SCAN))
    assert seen.left(["/nav"], published("/cmd_vel", "/ros2_mcp_4711")) == Left(
        [], {"/cmd_vel": ["/nav"]}, {"/cmd_vel": SCAN}
    )


def test_nodes_that_never_come_back_are_not_missed() -> None:
    seen = Seen()
    for node in ("/launch_ros_4711", "/transform_listener_impl_5581ab4b0a20", "(unknown node)", "/camera_2"):
        seen.note(node, dict.fromkeys(["/status"], SCAN) if node == "(unknown node)" else [])
    assert seen.left([], {}) == Left(["/camera_2"])
    assert seen.knows("/launch_ros_4711"), "who is never noted is not looked at again and again"
