"""The profile `arm-slow` before a controller that interpolates as the real one does: what the points leave open between
them, a stamp of the past, and a first point far away are refused; what is approved does not go beyond the limits.
"""

from __future__ import annotations

import re
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("rclpy", reason="needs the ROS 2 wheels, or a sourced ROS 2")

from ros2_mcp.guard.state import StateFolder
from support.agent import Agent, agent_for, until
from support.commanded import CommandedProcess
from support.demo_robot import build_interfaces, with_interfaces

pytestmark = pytest.mark.timeout(180)
ACTION, TOPIC = "/arm_controller/follow_joint_trajectory", "/arm_controller/joint_trajectory"
MOST = 0.3 * 1.02
"""rad/s, by differences of 0.01 s on a busy machine's clock."""


@pytest.fixture(scope="module")
def ros_environment(ros_environment: dict[str, str]) -> dict[str, str]:
    return with_interfaces(ros_environment, build_interfaces("arm", later=True))


@pytest.fixture(scope="module")
def arm(ros_environment: dict[str, str]) -> Iterator[CommandedProcess]:
    process = CommandedProcess("spline_arm", ros_environment)
    yield process
    process.kill()


@pytest.fixture(scope="module")
def state(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("state")


@pytest.fixture(scope="module")
def agent(ros_environment: dict[str, str], state: Path, arm: CommandedProcess) -> Iterator[Agent]:
    environment = {**ros_environment, "XDG_STATE_HOME": str(state)}
    with agent_for(environment, "--tools", "all", "--policy", "arm-slow") as client:
        yield client.knows("/joint_states", TOPIC)


@pytest.fixture(autouse=True)
def _at_zero(arm: CommandedProcess, agent: Agent) -> None:
    """For the server, too: it judges by what it has heard of the joints."""
    arm.begin(places=[0.0, 0.0])
    told = {"topic_name": "/joint_states", "timeout": 30}
    until(lambda: agent.call("ros2_topic_echo_wait", **told)["message"]["position"] == [0.0, 0.0])


def operate(ros_environment: dict[str, str], state: Path, *words: str) -> str:
    env = {**ros_environment, "XDG_STATE_HOME": str(state)}
    folder = StateFolder.of(domain_id=int(ros_environment["ROS_DOMAIN_ID"]), env=env).path
    command = [sys.executable, "-m", "ros2_mcp", "operate", "--state", str(folder), *words]
    return subprocess.run(command, check=True, capture_output=True, text=True).stdout


def point(seconds: float, positions: list[float], *more: list[float]) -> dict[str, Any]:
    at = {"sec": int(seconds), "nanosec": round(seconds % 1 * 1e9)}
    named = dict(zip(("velocities", "accelerations"), more, strict=False))
    return {"positions": positions, **named, "time_from_start": at}


def goal(
    *points: dict[str, Any], stamp_s: float = 0.0, names: tuple[str, ...] = ("joint_1", "joint_2")
) -> dict[str, Any]:
    stamp = {"sec": int(stamp_s), "nanosec": round(stamp_s % 1 * 1e9)}
    trajectory = {"header": {"stamp": stamp}, "joint_names": list(names), "points": list(points)}
    return {"action_name": ACTION, "goal_fields": {"trajectory": trajectory}}


STILL = [0.0, 0.0]
FAULTS: dict[str, tuple[dict[str, Any], str]] = {
    "a cubic between slow points": (
        goal(point(2, STILL, STILL), point(4, [0.45, 0.0], STILL)),
        "joint_1 would run at 0.3375 per second, at most 0.3 is allowed, on its way to points[1]",
    ),
    "from 0 to 0 with accelerations": (
        goal(point(2, STILL, STILL, STILL), point(14, STILL, STILL, [0.5, 0.0])),
        "joint_1 would run at",
    ),
    "a first point far away": (goal(point(2, [2.5, 0.0])), "joint_1 would run at 1.25 per second"),
    "beyond what the description allows": (goal(point(20, [0.0, 3.0], STILL)), "joint_2 would be at 3, -1.57 to 1.57"),
    "names in another order": (
        goal(point(20, [3.0, 0.0], STILL), names=("joint_2", "joint_1")),
        "joint_2 would be at 3, -1.57 to 1.57",
    ),
    "accelerations without velocities": (
        goal({**point(8, [0.5, 0.0]), "accelerations": STILL}),
        "accelerations but no velocities",
    ),
}


def approved(agent: Agent, ros_environment: dict[str, str], state: Path, sent: dict[str, Any]) -> dict[str, Any]:
    """Sends a goal that a person approves."""
    refusal = agent.refusal("ros2_send_action_goal", **sent)
    assert "needs_approval" in refusal, refusal
    operate(ros_environment, state, "approve", refusal.partition("needs_approval ")[2][:4])
    return agent.call("ros2_send_action_goal", **sent)


@pytest.mark.parametrize("fault", FAULTS)
def test_what_a_controller_would_do_between_the_points_is_refused(agent, arm, fault: str) -> None:
    sent, why = FAULTS[fault]
    refusal = agent.refusal("ros2_send_action_goal", **sent)
    assert why in refusal
    assert arm.seen()["goals"] == 0


@pytest.mark.parametrize("away_s", [-20.0, -1.5, 20.0])  # what is ahead comes nearer while a busy machine waits
def test_a_stamp_of_another_time_is_refused(agent, arm, away_s: float) -> None:
    sent = goal(point(10, [1.0, 0.0], STILL), stamp_s=time.time() + away_s)
    refusal = agent.refusal("ros2_send_action_goal", **sent)
    assert re.search(r"trajectory\.header\.stamp is \d+\.\d s (ago|ahead)", refusal), refusal
    assert arm.seen()["goals"] == 0


def test_an_approval_does_not_age_the_stamp_of_a_goal(agent, arm, ros_environment, state) -> None:
    def asked() -> tuple[dict[str, Any], str] | None:
        """A goal that waits for a person; none where a busy machine judges its stamp more than a second later."""
        sent = goal(point(4, [0.5, 0.0], STILL), stamp_s=time.time())
        refusal = agent.refusal("ros2_send_action_goal", **sent)
        return (sent, refusal.partition("needs_approval ")[2][:4]) if "needs_approval" in refusal else None

    sent, waiting = until(asked)
    told = operate(ros_environment, state, "show", waiting)
    assert "joint_1 from 0 to 0.5 rad, joint_2 from 0 to 0 rad" in told
    assert "Top speed 0.1875 rad/s of joint_1; 1 point in 4 s." in told
    assert "tool comes at most 0.9 m away from base_link" in told
    time.sleep(1.2)  # past the second within which a stamp is taken for now
    operate(ros_environment, state, "approve", waiting)
    assert agent.call("ros2_send_action_goal", **sent)["accepted"]
    until(lambda: arm.seen()["joints"]["joint_1"]["high"] == 0.5)
    seen = arm.seen()["joints"]["joint_1"]
    assert seen["speed"] < MOST, seen


def test_what_is_within_the_limits_is_approved_and_done(agent, arm, ros_environment, state) -> None:
    sent = goal(point(2, [0.2, 0.1], STILL), point(4, [-0.1, 0.3], STILL))
    assert approved(agent, ros_environment, state, sent)["accepted"]
    until(lambda: arm.seen()["joints"]["joint_2"]["high"] == 0.3)
    seen = arm.seen()
    assert seen["goals"] == 1
    assert all(joint["speed"] < MOST for joint in seen["joints"].values()), seen


def test_a_move_of_joints_is_approved_and_done_and_one_that_is_too_fast_is_refused(
    agent, arm, ros_environment, state
) -> None:
    refusal = agent.refusal("ros2_joint_move", joints={"joint_1": 0.5}, duration_s=1.5)
    assert "joint_1 would run at 0.5 per second, at most 0.3 is allowed" in refusal
    sent = {"joints": {"joint_1": 0.3}, "duration_s": 3.0}
    refusal = agent.refusal("ros2_joint_move", **sent)
    operate(ros_environment, state, "approve", refusal.partition("needs_approval ")[2][:4])
    assert agent.call("ros2_joint_move", **sent)["outcome"] == "reached"
    seen = arm.seen()
    assert seen["goals"] == 1
    assert seen["joints"]["joint_1"]["speed"] < MOST, seen


def test_a_goal_that_replaces_a_motion_is_judged_with_the_speed_of_then(agent, arm) -> None:
    sent = goal(point(120, [3.0, 0.0], STILL))
    assert "needs_approval" in agent.refusal("ros2_send_action_goal", **sent)  # while the joints stand

    def moves() -> bool:
        if not arm.seen()["goals"]:
            arm.want(topic=TOPIC, seconds=20.0, to=3.0, away_s=0.0)
        return arm.seen()["joints"]["joint_1"]["high"] > 0.5

    until(moves)  # of another client: at 0.2 rad/s, which the new goal would begin with
    before = arm.seen()["goals"]
    assert "joint_1 would be at" in agent.refusal("ros2_send_action_goal", **sent)
    at_once = goal(point(0, [arm.seen()["joints"]["joint_1"]["high"], 0.0], STILL), point(120, [3.0, 0.0], STILL))
    assert "points[0] is to be reached at once" in agent.refusal("ros2_send_action_goal", **at_once)
    assert arm.seen()["goals"] == before


def test_a_policy_is_drafted_with_the_joints_of_the_arm_and_their_limits(arm, ros_environment, state) -> None:
    command = [sys.executable, "-m", "ros2_mcp", "policy", "init"]
    env = {**ros_environment, "XDG_STATE_HOME": str(state)}

    def drafted() -> bool:  # a new server has to discover the robot first
        text = subprocess.run(command, check=True, capture_output=True, text=True, env=env).stdout
        rule = f"  - goal: {ACTION} # /arm_controller moves joint_1, joint_2\n"
        limits = ["joint_1: {position: [-3.14, 3.14], speed: 0.3}", "joint_2: {position: [-1.57, 1.57], speed: 0.3}"]
        return all(part in text for part in (rule, *limits))

    until(drafted, 90.0)  # each try starts a server


RELAYS = """
policy: 1
name: relays
allow:
  - {relay: /arm_controller/joint_trajectory, type: trajectory_msgs/msg/JointTrajectory, from: /wanted}
  - {publish: /arm_controller/joint_trajectory, type: trajectory_msgs/msg/JointTrajectory}
limits:
  arm: {types: [trajectory_msgs/msg/JointTrajectory], curve: {"": {speed: 0.3}}}
"""


@pytest.fixture
def relaying(ros_environment: dict[str, str], tmp_path: Path, arm: CommandedProcess) -> Iterator[Agent]:
    """A client of a server whose policy lets another node's trajectories pass, which the bridge alone sees."""
    tmp_path.chmod(0o700)
    file = tmp_path / "policy.yaml"
    file.write_text(RELAYS, encoding="utf-8")
    file.chmod(0o600)
    environment = {**ros_environment, "XDG_STATE_HOME": str(tmp_path)}
    with agent_for(environment, "--tools", "all", "--policy", str(file)) as client:
        yield client.knows("/joint_states", TOPIC)


def test_the_bridge_judges_the_trajectories_of_others_and_sets_their_stamps_to_zero(relaying, arm) -> None:
    arm.want(topic="/wanted", seconds=20.0, to=0.0, away_s=0.0)  # so that the topic is there
    until(lambda: relaying.call("ros2_topic_info", topic_name="/wanted")["publishers"])
    started = relaying.call("ros2_relay_start", source_topic="/wanted", destination_topic=TOPIC, transform="identity")

    def comes(count: str, **wanted: float) -> bool:
        """Whether a trajectory that is published again and again has been counted so."""
        arm.want(topic="/wanted", **wanted)
        [relay] = [
            each for each in relaying.call("ros2_relay_list")["relays"] if each["relay_id"] == started["relay_id"]
        ]
        return relay[count] > 0

    until(lambda: comes("errors", seconds=2.0, to=2.0, away_s=0.0))  # 1.5 rad/s in its middle
    assert arm.seen()["goals"] == 0
    until(lambda: comes("published", seconds=6.0, to=0.6, away_s=-20.0))
    until(lambda: arm.seen()["joints"]["joint_1"]["high"] > 0.1)
    seen = arm.seen()["joints"]["joint_1"]
    assert seen["speed"] < MOST, seen
    data = goal(point(1, [1.0, 0.0]))["goal_fields"]["trajectory"]
    assert "joint_1 would run at" in relaying.refusal("ros2_topic_publish", topic_name=TOPIC, data=data)
