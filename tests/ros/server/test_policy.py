"""A policy over real ROS: the same decision by every way, saying what would be allowed; what is within arrives."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from support.agent import Agent, agent_for, until
from support.observer import Observer
from support.processes import peer_command
from support.velocities import TWIST

POLICY = """
policy: 1
name: small
allow:
  - {publish: "/**/cmd_vel", type: geometry_msgs/msg/Twist, rate_hz: 20, for_s: 2, sole_publisher: true}
  - {goal: /fibonacci, type: test_msgs/action/Fibonacci, fields: {order: {range: [0, 3]}}}
  - {set: /small_robot, names: [start_type_description_service]}
  - {call: /set_lamp, type: std_srvs/srv/SetBool, fields: {data: {is: true}}}
limits:
  base: {types: geometry_msgs/msg/Twist, norm: {linear: 0.2, angular: 0.5}}
"""
SET, ATOMICALLY = "rcl_interfaces/srv/SetParameters", "rcl_interfaces/srv/SetParametersAtomically"


@pytest.fixture(scope="module")
def policy(tmp_path_factory: pytest.TempPathFactory) -> str:
    folder = tmp_path_factory.mktemp("policy")
    folder.chmod(0o700)
    path: Path = folder / "small.yaml"
    path.write_text(POLICY)
    path.chmod(0o600)
    return str(path)


@pytest.fixture(scope="module")
def agent(ros_environment: dict[str, str], policy: str) -> Iterator[Agent]:
    with agent_for({**ros_environment, "ROS2_MCP_POLICY": policy}, "--tools", "all") as client:
        yield client


@pytest.fixture(scope="module")
def small_robot(ros_environment: dict[str, str], agent: Agent) -> Iterator[None]:
    """`server_robot`, discovered."""
    process = subprocess.Popen(peer_command("server_robot"), stdout=subprocess.PIPE, text=True, env=ros_environment)
    assert process.stdout
    assert "ready\n" in process.stdout  # reads until there; how long it starts does not count as discovery
    agent.until_answered("ros2_service_call", service_name="/set_lamp", fields={"data": True}, timeout_sec=1)
    agent.until_answered("ros2_parameter_get", node_name="/small_robot")
    until(lambda: agent.call("ros2_list_actions")["actions"])
    yield
    process.kill()  # rclpy's threads may sleep in a callback
    process.communicate(timeout=20)


def speed(x: float) -> dict:
    return {"linear": {"x": x}}


def test_what_is_within_the_limit_arrives_and_what_is_not_says_what_would_be(agent: Agent, observer: Observer) -> None:
    topic = "/a/cmd_vel"
    observer.join(by=topic, topic=topic, kind=TWIST)
    agent.knows(topic)
    told = agent.refusal("ros2_topic_publish", topic_name=topic, message_type=TWIST, data=speed(0.3))
    assert told.startswith("Refused: Publishing on /a/cmd_vel is refused by the policy: linear is 0.3, at most 0.2 is")
    assert "small: limit base" in told
    told = agent.refusal(
        "ros2_topic_publish", topic_name=topic, message_type=TWIST, data=speed(0.1), frequency=50, duration=1
    )
    assert "at most 20 Hz" in told
    assert observer.counts(topic=topic)[topic] == 0
    agent.call("ros2_topic_publish", topic_name=topic, message_type=TWIST, data=speed(0.2))
    until(lambda: observer.counts(topic=topic)[topic])


def test_a_topic_on_which_a_node_of_the_robot_publishes_is_refused_and_the_node_named(
    agent: Agent, observer: Observer
) -> None:
    topic = "/behind/cmd_vel"
    observer.join(by=topic, topic=topic, kind=TWIST)
    observer.talk(topic=topic, kind=TWIST, hz=5.0, value=0.0)
    agent.knows(topic)
    until(lambda: agent.call("ros2_topic_info", topic_name=topic)["publishers"])
    told = agent.refusal("ros2_topic_publish", topic_name=topic, message_type=TWIST, data=speed(0.1))
    assert "of the robot publishes there itself" in told
    assert "/observer" in told
    observer.hush(topic=topic)


@pytest.mark.parametrize("topic", ["/cmd_vel_raw", "/b/cmd_vel/x", "/goal_pose", "/fibonacci/_action/status"])
def test_other_names_are_refused_and_those_that_are_allowed_named(agent: Agent, topic: str) -> None:
    told = agent.refusal("ros2_topic_publish", topic_name=topic, message_type=TWIST, data={})
    assert "no rule allows it" in told
    assert "/**/cmd_vel" in told


GOALS = [("ros2_send_action_goal", {"action_name": "/fibonacci", "goal_fields": {"order": 4}}),
         ("ros2_service_call", {"service_name": "/fibonacci/_action/send_goal",
                                "service_type": "test_msgs/action/Fibonacci_SendGoal",
                                "fields": {"goal_id": {"uuid": [7] * 16}, "goal": {"order": 4}}})]  # fmt: skip


@pytest.mark.parametrize(("tool", "arguments"), GOALS, ids=["tool", "raw"])
@pytest.mark.usefixtures("small_robot")
def test_a_goal_beyond_its_limit_is_refused_alike_by_tool_and_by_raw_call(
    agent: Agent, tool: str, arguments: dict
) -> None:
    told = agent.refusal(tool, **arguments)
    assert "Sending a goal to /fibonacci is refused by the policy: order is 4, 0 to 3 is allowed" in told


def parameter(name: str, value: bool) -> dict:
    return {"parameters": [{"name": name, "value": {"type": 1, "bool_value": value}}]}


@pytest.mark.parametrize("tool", ["set", "atomic", "raw", "raw atomic"])
@pytest.mark.usefixtures("small_robot")
def test_a_parameter_that_no_rule_names_is_refused_alike_by_every_way(agent: Agent, tool: str) -> None:
    node, name = "/small_robot", "use_sim_time"
    if tool.startswith("raw"):
        kind, service = (ATOMICALLY, "_atomically") if "atomic" in tool else (SET, "")
        where = {"service_name": f"{node}/set_parameters{service}", "service_type": kind}
        told = agent.refusal("ros2_service_call", **where, fields=parameter(name, True))
    else:
        told = agent.refusal("ros2_parameter_set", node_name=node, values={name: True}, atomic=tool == "atomic")
    assert "Setting parameters of /small_robot is refused by the policy: the parameter use_sim_time may not" in told
    assert agent.call("ros2_parameter_get", node_name=node, names=[name])["parameters"] == {name: False}


@pytest.mark.usefixtures("small_robot")
def test_what_a_rule_allows_of_goals_and_services_is_done(agent: Agent) -> None:
    done = agent.call("ros2_send_action_goal", action_name="/fibonacci", goal_fields={"order": 3}, wait_for_result=True)
    assert done["status"] == "SUCCEEDED"
    assert "data is False, only True is allowed" in agent.refusal(
        "ros2_service_call", service_name="/set_lamp", fields={"data": False}
    )
    told = agent.refusal("ros2_service_call", service_name="/slow_lamp", fields={"data": True})
    assert "Calling services is allowed for /set_lamp." in told


def test_a_policy_that_is_wrong_ends_the_start_and_names_its_line(ros_environment: dict[str, str], policy: str) -> None:
    wrong = Path(policy).with_name("wrong.yaml")
    wrong.write_text("policy: 1\nlimts: {}\n")
    wrong.chmod(0o600)
    command = [sys.executable, "-m", "ros2_mcp", "--policy", str(wrong)]
    ended = subprocess.run(
        command, stdin=subprocess.DEVNULL, capture_output=True, text=True, env=ros_environment, check=False
    )
    assert ended.returncode == 1
    assert ended.stdout == ""
    assert "wrong.yaml, line 2: 'limts' means nothing in the policy. Did you mean limits?" in ended.stderr
