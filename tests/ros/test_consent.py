"""Where a person confirms, nothing arrives that nobody approved, and what was approved arrives once."""

from __future__ import annotations

import json
import re
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("rclpy", reason="needs the ROS 2 wheels, or a sourced ROS 2")

from ros2_mcp.guard.chain import entries, file_name, verify
from support.agent import Agent, agent_for, until
from support.observer import Observer
from support.velocities import TWIST

TOPIC = "/cmd_vel"


def policy(state: Path) -> str:
    return f"""
policy: 1
name: hall-3
robot: hall-3
mode: confirm
state: {state}
allow:
  - {{publish: {TOPIC}, type: {TWIST}, rate_hz: 50, for_s: 10}}
  - {{record: "/**"}}
"""


@pytest.fixture(scope="module")
def observer(observer: Observer) -> Observer:
    observer.watch(TOPIC)
    return observer


@pytest.fixture
def state(tmp_path: Path) -> Path:
    """The state folder of the robot."""
    return tmp_path / "state" / "hall-3"


@pytest.fixture
def options(tmp_path: Path) -> list[str]:
    """Of a server under the policy."""
    return options_in(tmp_path)


def options_in(folder: Path) -> list[str]:
    file = folder / "policy.yaml"
    file.write_text(policy(folder / "state"))
    file.chmod(0o600)
    return ["--policy", str(file), "--tools", "all", "--record-dir", str(folder / "recordings")]


@pytest.fixture(scope="module")
def shared_folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("shared")


@pytest.fixture(scope="module")
def shared_agent(ros_environment: dict[str, str], shared_folder: Path) -> Iterator[Agent]:
    """Of a server under the policy that several tests share."""
    with agent_for(ros_environment, *options_in(shared_folder)) as agent:
        yield agent.knows(TOPIC)


def operate(state: Path, *words: str) -> str:
    command = [sys.executable, "-m", "ros2_mcp", "operate", "--state", str(state), *words]
    return subprocess.run(command, check=True, capture_output=True, text=True).stdout


def drive(speed: float) -> dict[str, Any]:
    return {"topic_name": TOPIC, "data": {"linear": {"x": speed}}}


def asked(agent: Agent, speed: float) -> str:
    """The id under which this call waits."""
    refusal = agent.refusal("ros2_topic_publish", **drive(speed))
    assert "ros2-mcp operate" in refusal
    return refusal.partition("needs_approval ")[2][:4]


@pytest.mark.promise("ros2_audit_read", "what you did to this robot, what was refused and why")
@pytest.mark.promise("ros2_record_start", "Your calls are on /agent/calls")
def test_what_a_person_has_approved_is_carried_out_once_and_the_audit_and_a_recording_show_it(
    ros_environment: dict[str, str], observer: Observer, options: list[str], state: Path
) -> None:
    with agent_for(ros_environment, *options) as agent:
        agent.knows(TOPIC)
        observer.forget()
        request_id = asked(agent, 0.1)
        assert asked(agent, 0.2) != request_id
        assert "linear.x 0.1 m/s; every other value is 0 or empty." in operate(state)
        assert operate(state, "approve", request_id) == f"{request_id} is approved, once.\n"
        assert asked(agent, 0.10000000000000002) not in ("", request_id)
        assert not any(observer.driven(topic=TOPIC).values())
        agent.call("ros2_topic_publish", **drive(0.1))
        observer.until_driven(TOPIC, of=4)
        assert asked(agent, 0.1) != request_id
        assert set(observer.driven(topic=TOPIC).values()) == {1}
        acts = agent.call("ros2_audit_read")["entries"]
        done = [act for act in acts if act["outcome"] == "done"]
        assert [(act["name"], act["tool"], act["approval"]) for act in done] == [
            (TOPIC, "ros2_topic_publish", request_id)
        ]
        assert sum("ApprovalNeeded" in act["reason"] for act in acts) == 4

        record_id = refused_recording(agent)
        operate(state, "approve", record_id)
        agent.call("ros2_record_start", name="incident")
        asked(agent, 0.3)
        agent.call("ros2_record_stop")
        read = agent.call("ros2_bag_read", bag="incident", topic_name="/agent/calls")["messages"]
        calls = [json.loads(message["data"]) for message in read]
        assert [(call["kind"], call.get("name")) for call in calls] == [("asked", TOPIC), ("waits", TOPIC)]
    verdict = verify(state / "audit")
    assert verdict.faults == []
    digests = {entry["digest"] for entry in entries(state / "audit") if entry.get("approval") == request_id}
    assert len(digests) == 1


def test_the_audit_has_calls_that_did_not_come_as_far_as_the_policy(observer: Observer, shared_agent: Agent) -> None:
    agent = shared_agent
    before = len(agent.call("ros2_audit_read")["entries"])
    agent.refusal("ros2_topic_publish", topic_name=TOPIC, message_type="no_such_msgs/msg/Thing", data={})
    agent.refusal("ros2_topic_publish", topic=TOPIC, speed=50)
    agent.refusal("ros2_topic_info", topic_name="/not_there")  # reads
    acts = agent.call("ros2_audit_read")["entries"][before:]
    assert [(act["tool"], act["verb"]) for act in acts] == [("ros2_topic_publish", "refused")] * 2
    assert "no_such_msgs/msg/Thing" in acts[0]["reason"] and "speed" in acts[1]["reason"]


def refused_recording(agent: Agent) -> str:
    return agent.refusal("ros2_record_start", name="incident").partition("needs_approval ")[2][:4]


def test_a_restart_forgets_what_was_approved_and_keeps_the_mode(
    ros_environment: dict[str, str], observer: Observer, options: list[str], state: Path
) -> None:
    with agent_for(ros_environment, *options) as agent:
        agent.knows(TOPIC)
        operate(state, "approve", asked(agent, 0.1))
        operate(state, "mode", "observe")
    observer.forget()
    with agent_for(ros_environment, *options) as agent:
        agent.knows(TOPIC)
        assert "observe" in agent.refusal("ros2_topic_publish", **drive(0.1))
        operate(state, "mode", "confirm")
        asked(agent, 0.1)
    assert not any(observer.driven(topic=TOPIC).values())


def test_under_a_policy_nothing_is_done_that_cannot_be_written_down(
    ros_environment: dict[str, str], observer: Observer, options: list[str], state: Path
) -> None:
    observer.forget()
    with agent_for(ros_environment, *options) as agent:
        agent.knows(TOPIC)
        request_id = asked(agent, 0.1)
        operate(state, "approve", request_id)
        for path in (state / "audit").glob("*.jsonl"):
            path.unlink()
        for number in range(1, 50):  # the next file cannot be made, whichever line it begins with
            (state / "audit" / file_name(number)).mkdir()
        assert "audit cannot be written" in agent.refusal("ros2_topic_publish", **drive(0.1))
        agent.call("ros2_stop")
    assert not any(observer.driven(topic=TOPIC).values())


def test_a_program_waits_for_a_person_and_a_dry_run_tells_what_would_be_held(
    observer: Observer, shared_agent: Agent, shared_folder: Path
) -> None:
    agent, state = shared_agent, shared_folder / "state" / "hall-3"
    pytest.importorskip("pydantic_monty", reason="needs the extra programs")
    code = """import robot
def drive(speed):
    robot.publish("/cmd_vel", {"linear": {"x": speed}})
drive(0.1)
print("went")
drive(0.2)
"""

    def waiting(speed: float) -> str:
        """The id under which the program waits for a person."""
        line = until(
            lambda: next((each for each in operate(state).splitlines() if f"linear.x {speed} m/s" in each), "")
        )
        before = operate(state).partition(line)[0]
        return re.findall(r"\b[A-Z0-9]{4}\b", before)[-1]

    observer.forget()
    other = 'robot.publish("/other", {"data": 1}, message_type="std_msgs/msg/UInt64")\n'
    dry = agent.call("ros2_program_run", program=f"{code}{other}", dry_run=True)
    assert [(one["line"], one["outcome"].partition(": ")[2][:25]) for one in dry["commands"]] == [
        (3, "would wait for a person's"),
        (3, "would wait for a person's"),
        (7, "would be refused: Publish"),
    ], dry
    running = agent.begin("ros2_program_run", program=code, timeout_s=60)
    operate(state, "approve", waiting(0.1))
    observer.until_driven(TOPIC, of=4)
    assert not running.done()
    operate(state, "deny", waiting(0.2))
    ran = running.result(60)
    assert (ran["outcome"], ran["printed"], ran["error"]["line"]) == ("failed", ["went"], 3), ran
    assert "denied" in ran["error"]["message"]
    assert set(observer.driven(topic=TOPIC).values()) == {1}
