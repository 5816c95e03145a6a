"""Programs in the sandbox, with a robot that moves: what they read, what they do, and what ends them."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import pytest

pytest.importorskip("rclpy", reason="needs the ROS 2 wheels, or a sourced ROS 2")
pytest.importorskip("pydantic_monty", reason="needs the extra `programs`")

from support.agent import Agent, until
from support.commanded import CommandedProcess

BASE = "/robot_1"
INPUTS = {"odom": f"{BASE}/odom", "scan": f"{BASE}/scan", "cmd": f"{BASE}/cmd_vel"}


@pytest.fixture(scope="module")
def driven(ros_environment: dict[str, str], agent: Agent) -> Iterator[CommandedProcess]:
    """`driven_robot`, which the server has discovered."""
    process = CommandedProcess("driven_robot", ros_environment)
    process.put(base=BASE)
    agent.knows(*INPUTS.values())
    yield process
    process.kill()


def run(agent: Agent, *lines: str, **more: Any) -> dict[str, Any]:
    return agent.call("ros2_program_run", program="\n".join(["import robot", *lines]), inputs=INPUTS, **more)


def test_it_reads_every_message_and_prints_what_it_found(agent: Agent, driven: CommandedProcess) -> None:
    ran = run(
        agent,
        "seen = []",
        "for m in robot.messages(odom, scan, fields=None, message_limit=80):",  # one may be matched seconds later
        "    seen.append(m['_topic'])",
        "print(len(seen), sorted(set(seen)))",
        "robot.mean([1, 2, 3])",
    )
    assert ran["outcome"] == "ended", ran
    assert ran["printed"] == [f"80 {sorted([INPUTS['odom'], INPUTS['scan']])}"]
    assert ran["returned"] == {"value": 2.0}


def test_what_it_drives_stands_when_it_has_ended(agent: Agent, driven: CommandedProcess) -> None:
    ran = run(
        agent,
        "for m in robot.messages(odom, message_limit=5):",
        "    robot.publish(cmd, {'linear': {'x': 0.3}})",
        "print('went')",
    )
    assert (ran["outcome"], ran["printed"]) == ("ended", ["went"])
    assert ran["commands"][0]["line"] == 3
    assert any("zero" in each for each in ran["stopped_at_end"]), ran
    until(lambda: driven.state()["speed"] < 1e-3)


def test_an_error_is_told_with_its_line_and_ends_what_was_begun(agent: Agent, driven: CommandedProcess) -> None:
    ran = run(agent, "robot.publish(cmd, {'linear': {'x': 0.3}})", "x = {}", "x['y']")
    assert (ran["outcome"], ran["error"]["line"], ran["error"]["source"]) == ("failed", 4, "x['y']")
    assert any("zero" in each for each in ran["stopped_at_end"]), ran
    until(lambda: driven.state()["speed"] < 1e-3)


def test_what_cannot_be_right_is_refused_before_it_runs(agent: Agent, driven: CommandedProcess) -> None:
    said = agent.refusal(
        "ros2_program_run", program="import robot\nrobot.publish('/cmd_vel', {})\nrobot.lates('/odom')"
    )
    assert "line 3" in said and "latest" in said
    assert "line 2" in agent.refusal("ros2_program_run", program="x = (")


def test_its_commands_stand_in_the_audit_with_their_lines(agent: Agent, driven: CommandedProcess) -> None:
    ran = run(agent, "", "robot.publish(cmd, {})")
    acts = agent.call("ros2_audit_read")["entries"]
    assert any(act["program"] == f"{ran['program_id']}, line 3" for act in acts), acts


def test_a_dry_run_reads_and_tells_what_would_be_done(agent: Agent, driven: CommandedProcess) -> None:
    ran = run(
        agent,
        "print(robot.scan(scan)['nearest_m'] is not None or 'far')",
        "r = robot.publish(cmd, {'linear': {'x': 0.3}})",
        "if r['sent']: print('sent')",
        dry_run=True,
    )
    assert (ran["outcome"], len(ran["printed"])) == ("ended", 1), ran
    assert ran["commands"] == [
        {"line": 3, "function": "publish", "outcome": f"Publishing on {INPUTS['cmd']}: would be done"}
    ]
    assert driven.state()["speed"] < 1e-3


def test_names_that_are_nearly_right_are_refused_before_it_runs(agent: Agent, driven: CommandedProcess) -> None:
    said = agent.refusal("ros2_program_run", program="import robot\nrobot.latest('/robot_1/odo')")
    assert "line 2" in said and INPUTS["odom"] in said
    said = agent.refusal(
        "ros2_program_run", program="import robot\n\nrobot.latest('/robot_1/odom', fields=['pose.pse'])"
    )
    assert "line 3" in said and "Did you mean pose?" in said


def test_a_stop_ends_a_program_and_what_it_drives(agent: Agent, driven: CommandedProcess) -> None:
    began = agent.begin(
        "ros2_program_run",
        program="import robot\nfor m in robot.messages(odom):\n    robot.publish(cmd, {'linear': {'x': 0.3}})",
        inputs=INPUTS,
    )
    until(lambda: driven.state()["speed"] > 0.1)
    agent.call("ros2_stop")
    assert began.result(60)["outcome"] == "stopped"
    until(lambda: driven.state()["speed"] < 1e-3)


def test_a_read_only_server_runs_programs_that_only_read(start_agent: Any, driven: CommandedProcess) -> None:
    reader = start_agent("--read-only").knows(INPUTS["odom"])
    ran = run(reader, "print(robot.latest(odom)['_topic'])")
    assert ran["printed"] == [INPUTS["odom"]], ran
    assert "publish" in reader.refusal("ros2_program_run", program="import robot\nrobot.publish('/cmd_vel', {})")
