"""Below a controller manager: what is not active, has no active hardware or is frozen is told by name where it is
commanded. The base, the arm and the manager are in a process of their own.
"""

from __future__ import annotations

import os
import signal
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from mcp.types import CallToolResult

pytest.importorskip("rosidl_generator_py", reason="needs the interface generators of the ROS 2 wheels")

from ros2_mcp_interfaces import build, default_cache
from support import commanded
from support.agent import Agent, agent_for, until
from support.commanded import CommandedProcess
from support.demo_robot import build_interfaces, with_interfaces

ACTION = "/arm_controller/follow_joint_trajectory"
TWIST = {"topic_name": "/cmd_vel", "message_type": "geometry_msgs/msg/Twist"}


@pytest.fixture(scope="module")
def ros_environment(ros_environment: dict[str, str]) -> dict[str, str]:
    """With the arm's interfaces, and those of a controller manager."""
    own = Path(commanded.__file__).parent / "interfaces"
    prefixes = [*build_interfaces("arm", later=True), *build([own], default_cache(), lambda _line: None)]
    known = os.pathsep.join(map(str, prefixes))
    return {**with_interfaces(ros_environment, prefixes), "ROS2_MCP_INTERFACES": known}


@pytest.fixture(scope="module")
def robot(ros_environment: dict[str, str]) -> Iterator[CommandedProcess]:
    process = CommandedProcess("managed_peer", ros_environment)
    yield process
    process.kill()


@pytest.fixture(scope="module")
def agent(ros_environment: dict[str, str], robot: CommandedProcess) -> Iterator[Agent]:
    with agent_for(ros_environment, "--tools", "all") as client:
        client.knows("/cmd_vel", "/odom", "/joint_states", "/robot_description")
        until(lambda: client.call("ros2_list_actions")["actions"])
        yield client


def publish(agent: Agent, **topic: Any) -> str:
    data = {"data": {"linear": {"x": 0.1}}} if not topic else {}
    return agent.call("ros2_topic_publish", **{**TWIST, **topic, **data})["note"]


def noted(agent: Agent, *words: str, **topic: Any) -> str:
    """What is noted of a command, as soon as it has these words: a manager that a busy machine holds up for 0.7 s is
    said not to answer.
    """
    return until(lambda: (note := publish(agent, **topic)) and all(one in note for one in words) and note)


def drove(agent: Agent, distance_m: float) -> CallToolResult:
    """A drive: anew where its odometry was silent for half a second, as on a busy machine."""

    def ended() -> CallToolResult | None:
        result = agent.whole("ros2_drive", {"distance_m": distance_m})
        return None if result.content[0].text.startswith("silent") else result

    return until(ended)


def test_of_what_is_active_nothing_is_said(agent: Agent, robot: CommandedProcess) -> None:
    robot.put()
    assert "active" not in publish(agent)
    told = drove(agent, 0.1).content[0].text
    assert told.startswith("reached") and "active" not in told
    moved = agent.call("ros2_joint_move", joints={"shoulder": 0.2}, speed=1)
    assert (moved["outcome"], moved["note"]) == ("reached", "")


def test_a_command_to_a_controller_that_is_inactive_says_so(agent: Agent, robot: CommandedProcess) -> None:
    robot.put(base_controller="inactive")
    noted(agent, "/base_controller is not active", "/controller_manager")
    robot.put(grip_controller="unconfigured")
    given = {"topic_name": "/grip_controller/commands", "message_type": "std_msgs/msg/Float64MultiArray"}
    noted(agent, "/grip_controller is not active: it is unconfigured", **given, data={"data": [1.0]})


def test_a_command_to_a_lifecycle_node_that_no_manager_knows_says_in_which_state_it_is(
    agent: Agent, robot: CommandedProcess
) -> None:
    robot.put()
    given = {"topic_name": "/flipper/commands", "message_type": "std_msgs/msg/Float64MultiArray"}
    noted(agent, "/flipper_driver is not active: it is unconfigured", **given, data={"data": [1.0]})
    agent.call("ros2_lifecycle_change", node_name="/flipper_driver", transition="configure")
    noted(agent, "/flipper_driver is not active: it is inactive", **given, data={"data": [1.0]})
    agent.call("ros2_lifecycle_change", node_name="/flipper_driver", transition="activate")
    assert "active" not in publish(agent, **given, data={"data": [1.0]})


def test_a_command_above_hardware_that_is_not_active_names_it_and_no_other(
    agent: Agent, robot: CommandedProcess
) -> None:
    robot.put(BaseHW="unconfigured", GripHW="inactive")
    assert "GripHW" not in noted(agent, "its hardware BaseHW is unconfigured")
    robot.put(GripHW="inactive")
    assert "HW" not in publish(agent)


def test_a_drive_that_does_not_move_names_the_controller(agent: Agent, robot: CommandedProcess) -> None:
    robot.put(base_controller="inactive")
    result = agent.whole("ros2_drive", {"distance_m": 0.3})
    assert result.is_error
    assert "/base_controller is not active: it is inactive" in result.content[0].text
    robot.put(BaseHW="unconfigured")
    said = drove(agent, 0.3).content[0].text
    assert said.startswith("stuck"), said
    assert "/base_controller is active, its hardware BaseHW is unconfigured" in said


def test_a_goal_that_is_rejected_carries_the_words_of_its_controller(agent: Agent, robot: CommandedProcess) -> None:
    robot.put(arm_controller="inactive")
    moved = agent.call("ros2_joint_move", joints={"shoulder": 0.1}, speed=1)
    assert moved["outcome"] == "rejected"
    assert "/arm_controller is not active" in moved["note"]
    assert "Can't accept new action goals" in moved["note"]
    trajectory = {"joint_names": ["shoulder"], "points": [{"positions": [0.1], "time_from_start": {"sec": 1}}]}
    sent = agent.call("ros2_send_action_goal", action_name=ACTION, goal_fields={"trajectory": trajectory})
    assert sent["status"] == "NOT_ACCEPTED"
    assert "Can't accept new action goals" in sent["note"] and "/arm_controller is not active" in sent["note"]


def test_a_drive_that_is_stuck_quotes_what_the_robot_logged_meanwhile(agent: Agent, robot: CommandedProcess) -> None:
    robot.put(motors_off=True)
    driven = drove(agent, 0.3)
    said = driven.content[0].text
    assert driven.is_error and said.startswith("stuck")
    assert "/motor_driver WARN: «motors are disabled: release the emergency stop»" in said


def test_joints_that_do_not_move_quote_what_the_robot_logged_meanwhile(agent: Agent, robot: CommandedProcess) -> None:
    robot.put(motors_off=True)
    moved = agent.whole("ros2_joint_move", {"joints": {"shoulder": 0.3}, "speed": 1})
    said = moved.content[0].text
    assert moved.is_error and said.startswith("aborted")
    assert said.count("motors are disabled") == 1 and "/motor_driver WARN" in said
    robot.put()
    moved = agent.call("ros2_joint_move", joints={"shoulder": 0.1}, speed=1)
    assert (moved["outcome"], moved["note"]) == ("reached", "")  # what was logged before is not its affair


def test_a_move_above_hardware_that_is_not_active_names_it_through_a_chain(
    agent: Agent, robot: CommandedProcess
) -> None:
    robot.put(ArmHW="unconfigured", GripHW="inactive")
    moved = agent.call("ros2_joint_move", joints={"shoulder": 0.5}, speed=1)
    assert moved["outcome"] == "aborted"
    assert "/arm_controller is active, its hardware ArmHW is unconfigured" in moved["note"]
    assert "GripHW" not in moved["note"]
    robot.put(limiter="inactive", ArmHW="unconfigured")
    below = agent.call("ros2_joint_move", joints={"shoulder": 0.5}, speed=1)
    assert "/limiter is not active" in below["note"]


def test_a_result_that_comes_a_little_late_is_waited_for(agent: Agent, robot: CommandedProcess) -> None:
    """The joints are seen to arrive before the controller says that they have: nothing is cancelled."""
    robot.put(result_late_s=0.15)
    moved = agent.call("ros2_joint_move", joints={"shoulder": 0.3}, duration_s=0.6, tolerance=0.1)
    assert moved["outcome"] == "reached"
    assert robot.cancels() == 0


def test_a_goal_of_another_client_that_is_replaced_is_named(agent: Agent, robot: CommandedProcess) -> None:
    robot.put()
    other = robot.send(target=1.5, seconds=30)
    moved = agent.call("ros2_joint_move", joints={"shoulder": 0.4}, speed=1)
    assert other in moved["note"]
    robot.cancel()
    assert other not in agent.call("ros2_joint_move", joints={"shoulder": 0.3}, speed=1)["note"]


def test_what_is_frozen_does_not_answer_and_that_is_said(agent: Agent, robot: CommandedProcess) -> None:
    """Last: what a frozen process missed, its peers may have given up."""
    robot.put()
    publish(agent)
    os.kill(robot.pid, signal.SIGSTOP)
    try:
        assert "/controller_manager does not answer" in publish(agent)
        drive = agent.whole("ros2_drive", {"distance_m": 0.3})
        assert drive.is_error and "does not answer" in drive.content[0].text
        trajectory = {"joint_names": ["shoulder"], "points": [{"positions": [0.1], "time_from_start": {"sec": 1}}]}
        sent = agent.refusal("ros2_send_action_goal", action_name=ACTION, goal_fields={"trajectory": trajectory})
        assert "/controller_manager does not answer" in sent
    finally:
        os.kill(robot.pid, signal.SIGCONT)
