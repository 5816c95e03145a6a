"""The simulated arm, servers that know its interfaces, and a witness in this process who hears its joints."""

from __future__ import annotations

import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from typing import Any

import pytest

pytest.importorskip("rclpy", reason="needs the ROS 2 wheels, or a sourced ROS 2")

from support.agent import Agent, agent_for
from support.demo_robot import Peer, build_interfaces, with_interfaces
from support.processes import running
from support.raw_server import MODERN, RawServer

STATES_HZ = 50
STANDS = 0.004
"""Of a joint between two looks: encoders tell steps of 0.0001 rad."""


class Witness:
    """Hears the joint states in this process."""

    def __init__(self, domain_id: int) -> None:
        self.peer = Peer(domain_id)
        self._heard = self.peer.subscribe("/joint_states", "sensor_msgs/msg/JointState")

    def joints(self) -> dict[str, float]:
        """Where they are now."""
        state = self._now()
        return dict(zip(state.name, state.position, strict=True))

    def speed(self) -> float:
        """Of the fastest joint, per s."""
        return max(map(abs, self._now().velocity))

    def _now(self) -> Any:
        """A state that was written from now on: in DDS wait up to ten that are older, as long as nobody spins."""
        asked_ns = self.peer.node.get_clock().now().nanoseconds
        self._heard.clear()

        def is_new() -> bool:
            stamp = self._heard[-1].header.stamp if self._heard else None
            return stamp is not None and stamp.sec * 10**9 + stamp.nanosec >= asked_ns

        self.peer.wait(is_new)
        return self._heard[-1]

    def until_moving(self) -> dict[str, float]:
        """Where the joints are as soon as one moves at more than 0.1 a second."""
        self.peer.wait(lambda: self.speed() > 0.1)
        return self.joints()

    def until_still(self) -> dict[str, float]:
        """Where the joints are as soon as all stand, and have for half a second of their own messages."""
        still = 0
        for _ in range(60 * STATES_HZ):
            still = still + 1 if self.speed() <= STANDS else 0
            if still == STATES_HZ // 2:
                return self.joints()
        raise AssertionError("the arm did not come to rest")


@pytest.fixture(scope="module")
def ros_environment(ros_environment: dict[str, str]) -> dict[str, str]:
    """With the arm's interfaces."""
    return with_interfaces(ros_environment, build_interfaces("arm", later=True))


@pytest.fixture(scope="module", autouse=True)
def arm(ros_environment: dict[str, str]) -> Iterator[subprocess.Popen[str]]:
    """The simulated arm of a file of tests."""
    with running(ros_environment, sys.executable, "-m", "ros2_mcp_demo", "--robot", "arm") as robot:
        yield robot


@pytest.fixture(scope="module")
def witness(domain_id: int, arm: object) -> Iterator[Witness]:
    """Hears the arm, and nobody else."""
    with pytest.MonkeyPatch.context() as patched:
        patched.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
        found = Witness(domain_id)
        yield found
        found.peer.close()


@pytest.fixture(scope="module")
def agent(ros_environment: dict[str, str], arm: object) -> Iterator[Agent]:
    """A client of a server with all tools, which knows the arm."""
    with agent_for(ros_environment, "--tools", "all") as client:
        yield client.knows("/joint_states", "/arm_controller/joint_trajectory")


@pytest.fixture
def start_server(ros_environment: dict[str, str], arm: object) -> Iterator[Callable[[], RawServer]]:
    """Start a server of this test's own, to be killed."""
    with ExitStack() as stack:

        def begin() -> RawServer:
            server = RawServer(ros_environment, "--tools", "all")
            stack.callback(server.end)
            server.begin(MODERN)
            deadline = time.monotonic() + 30.0
            while not server.call("ros2_topic_list", pattern="arm_controller")["structuredContent"]["topics"]:
                assert time.monotonic() < deadline, "the arm was not discovered"
            return server

        yield begin
