"""A robot is reached from a server that has nothing of what Windows lacks: threads wait for its pipes."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

pytest.importorskip("rclpy", reason="needs the ROS 2 wheels, or a sourced ROS 2")

from support.raw_server import MODERN, RawServer

TESTS = Path(__file__).parents[2]


@pytest.fixture
def server(ros_environment: dict[str, str]) -> Iterator[RawServer]:
    command = [sys.executable, "-m", "support.like_windows"]
    robot = ("--robot-command", "env", "--bridge-python", sys.executable)
    begun = RawServer({**ros_environment, "PYTHONPATH": str(TESTS)}, "--log-level", "error", *robot, command=command)
    yield begun
    begun.end()


def test_a_robot_is_reached_and_a_megabyte_goes_there_and_comes_back(server: RawServer) -> None:
    server.begin(MODERN)
    topic, kind, sent = "/from_a_laptop", "std_msgs/msg/String", "x" * 1_000_000
    data = {"topic_name": topic, "message_type": kind, "data": {"data": sent}}
    repeat = server.send("tools/call", name="ros2_topic_publish", arguments={**data, "frequency": 5, "duration": 100})
    came = server.call("ros2_topic_echo_wait", topic_name=topic, message_type=kind, timeout=50)["structuredContent"]
    assert came["truncated"] == ["data"]  # more of it than is shown
    assert server.call("ros2_stop")["structuredContent"]["repeats_stopped"] == 1
    server.answer(repeat)
    assert server.close() < 20.0
