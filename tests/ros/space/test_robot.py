"""`ros2_robot` on the simulated robots: every field against what is known of them."""

from __future__ import annotations

import json
import os
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("rclpy", reason="needs the ROS 2 wheels, or a sourced ROS 2")
pytest.importorskip("rosidl_generator_py", reason="needs the interface generators of the ROS 2 wheels")

from support.agent import FULL, Agent, agent_for, until
from support.demo_robot import build_interfaces
from support.processes import running

ROBOTS = ["rover", "arm", "drone"] if FULL else ["rover"]
"""The others need interfaces that take a minute to build, and a robot each: in all rounds only."""


@pytest.fixture(scope="module", params=ROBOTS)
def simulated(request: pytest.FixtureRequest, ros_environment: dict[str, str]) -> Iterator[tuple[str, Agent]]:
    """The kind of robot, and a client of a server beside it."""
    prefixes: list[Path] = build_interfaces(request.param, later=request.param != "rover")
    known = {
        **ros_environment,
        "AMENT_PREFIX_PATH": os.pathsep.join(map(str, [*prefixes, sys.prefix])),
        "PYTHONPATH": os.pathsep.join(
            [*(str(each / "site-packages") for each in prefixes), ros_environment["PYTHONPATH"]]
        ),
    }
    command = (sys.executable, "-m", "ros2_mcp_demo", "--robot", request.param)
    with running(known, *command), agent_for(ros_environment) as agent:
        yield request.param, agent


@pytest.mark.promise("ros2_robot", "kind, size, command inputs, sensors, joints, where it is")
def test_every_field_is_right_and_all_of_it_is_small(simulated: tuple[str, Agent]) -> None:
    kind, agent = simulated

    def whole() -> dict[str, Any] | None:
        """Once everything has been discovered."""
        found = agent.call("ros2_robot")
        return found if CHECKS[kind](found) else None

    found: dict[str, Any] = {}
    try:
        found = until(whole)
    except AssertionError:
        pytest.fail(json.dumps(agent.call("ros2_robot"), indent=1, ensure_ascii=False))
    assert len(json.dumps(found, ensure_ascii=False).encode()) <= 2000


def is_rover(found: dict[str, Any]) -> bool:
    scan = next((line for line in found["sensors"] if line.startswith("/scan LaserScan")), "")
    return (
        found["kind"].startswith("differential drive base, 2 wheels")
        and found["base_frame"] == "base_link"
        and any(line.startswith("/cmd_vel Twist → /base_controller") for line in found["command_inputs"])
        and "in laser at 0.00 0.00 0.22" in scan
        and " to " in scan
        and found["place"].startswith("In map at x ")
        and "map → odom → base_link" in found["frames"]
        and any(line.startswith("left_wheel_joint continuous now") for line in found["joints"])
    )


def is_arm(found: dict[str, Any]) -> bool:
    return (
        found["kind"] == "arm of 6 joints and a gripper"
        and any(line.startswith("/arm_controller/joint_trajectory JointTraj") for line in found["command_inputs"])
        and "/arm_controller/follow_joint_trajectory" in found["controllers"]
        and found["joints"][0].startswith("shoulder_pan_joint now ")
        and found["joints"][0].endswith(" of -3.1..3.1 rad, ≤ 1.5 rad/s")
        and "fixed there" in found["place"]
        and not found["unhealthy"]
    )


def is_drone(found: dict[str, Any]) -> bool:
    return found["kind"] == "drone, 4 rotors" and "MAVROS" in found["stacks"] and not found["joints"]


CHECKS = {"rover": is_rover, "arm": is_arm, "drone": is_drone}
