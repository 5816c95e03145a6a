"""Hostile programs under a policy, over the real server: some here, every one in full."""

from __future__ import annotations

import json
import math
import os
import struct
import time
from collections.abc import Iterator, Sequence
from pathlib import Path

import pytest

pytest.importorskip("pydantic_monty", reason="needs the extra programs")

from support.agent import FULL
from support.driver import Driver, fresh
from support.hostile_programs import PROGRAMS, Trap, trap
from support.observer import Observer
from support.outlets import FORGED, faults_of, hostile
from support.velocities import TWIST

SEVERAL = (  # one of each way to do harm
    "escapes: reads a file by open",
    "endless: catches its own end",
    "output: returns lists of lists of the same list",
    "unicode: prints escapes of a terminal",
    "commands: drives faster than allowed",
    "commands: drives faster and faster and catches the refusals",
    "commands: drives to and fro at once",
)
STRING = "std_msgs/msg/String"
ANSWERED_S = 60.0
"""For a machine that is busy."""
REST_S = 5.0 if FULL else 30.0
"""In CI this only ends a hang."""
MOST_M_S, MOST_RAD_S = 0.4, 0.8
"""The policy of these tests."""
MOST_TIMES = 2.0
"""Of the issue: how long other calls take beside such programs, by what they take without; p99."""
JUST_OVER = 1.0 + 1e-6


@pytest.fixture
def host(tmp_path: Path) -> Iterator[Trap]:
    (tmp_path / "trap").mkdir()
    with trap(tmp_path / "trap") as host:
        yield host


@pytest.fixture
def server(ros_environment, policy_file: Path, tmp_path: Path, observer: Observer, host: Trap) -> Iterator[Driver]:
    environment = {**ros_environment, **host.environment(), "XDG_STATE_HOME": str(tmp_path / "state")}
    driver = Driver(environment, "--tools", "all", "--policy", str(policy_file))
    yield driver
    driver.end()


def over_the_policy(observer: Observer, topic: str) -> list[str]:
    """What arrived that the policy does not allow."""
    faults = observer.unsound(topic=topic)
    for one in observer.messages(topic=topic):
        x, y, z, roll, pitch, yaw = one["values"]
        fast = math.hypot(x, y, z) > MOST_M_S * JUST_OVER or abs(yaw) > MOST_RAD_S * JUST_OVER
        if fast or any((y, z, roll, pitch)):
            faults.append(repr(one["values"]))
    return faults


def beside(server: Driver, request: int) -> list[float]:
    """How long other calls take until that request is answered, in s."""
    took_s: list[float] = []
    deadline = time.monotonic() + ANSWERED_S
    while not server.answered(request):
        assert time.monotonic() < deadline, "no answer"
        took_s.append(listing_s(server))
        time.sleep(0.02)
    return took_s


def listing_s(server: Driver) -> float:
    """How long a call takes that has nothing to do with programs, in s."""
    asked = time.monotonic()
    server.answer(server.tool("ros2_topic_list"))
    return time.monotonic() - asked


def p99(seconds: list[float]) -> float:
    return sorted(seconds)[min(len(seconds) - 1, int(0.99 * len(seconds)))]


def test_no_hostile_program_reaches_the_host_or_a_robot_beyond_its_policy(
    server: Driver, observer: Observer, host: Trap
) -> None:
    """Other calls are answered meanwhile."""
    run_all(SEVERAL, server, observer, host, timeout_s=1)


@pytest.mark.full
@pytest.mark.timeout(3000)
def test_no_hostile_program_of_all_does_nor_keeps_other_calls_waiting(
    server: Driver, observer: Observer, host: Trap
) -> None:
    """ROS2_MCP_ONLY has a part of the names of those that are wanted."""
    names = [name for name in PROGRAMS if os.environ.get("ROS2_MCP_ONLY", "") in name]
    quiet_s, busy_s = run_all(names, server, observer, host, timeout_s=2, quiet_calls=5)
    print(f"p99 of {len(busy_s)} calls {p99(busy_s):.4f} s, quiet {p99(quiet_s):.4f} s", flush=True)
    assert p99(busy_s) <= MOST_TIMES * p99(quiet_s)


def run_all(
    names: Sequence[str], server: Driver, observer: Observer, host: Trap, *, timeout_s: float, quiet_calls: int = 0
) -> tuple[list[float], list[float]]:
    """Runs these programs, none of which does harm; how long other calls took before each and beside it, in s."""
    topic = f"{fresh('hostile')}/cmd_vel"
    observer.join(by=topic, topic=topic, kind=TWIST)
    server.knows(topic, 1)
    bridge = server.bridge()
    faults: dict[str, list[str]] = {}
    busy_s: list[float] = []
    quiet_s: list[float] = []
    for name in names:
        for _ in range(quiet_calls):
            quiet_s.append(listing_s(server))
            time.sleep(0.02)
        program = host.set_for(PROGRAMS[name], server.process.pid, topic)
        request = server.tool("ros2_program_run", program=program, timeout_s=timeout_s)
        took_s = beside(server, request)
        line = server.answer(request)
        found = [
            *host.sprung(json.dumps(line, ensure_ascii=False)),
            *over_the_policy(observer, topic),
            *faults_of(line),
        ]
        if server.bridge() != bridge:
            bridge, found = server.bridge(), [*found, "another bridge"]
        if observer.comes_to_rest(topic, REST_S):
            found.append("moves on")
        observer.forget()
        busy_s += took_s
        if found:
            faults[name] = found
        answer = json.dumps(line.get("result", line).get("structuredContent", line))
        print(
            f"{name}: others ≤ {max(took_s, default=0):.3f} s: {answer[:240]}"
            f" {'FAULT ' + ascii(found)[:300] if found else ''}",
            flush=True,
        )
    print(f"{len(names) - len(faults)} of {len(names)} held", flush=True)
    assert faults == {}
    return quiet_s, busy_s


def test_a_hostile_text_of_the_robot_stays_data_whatever_a_program_does_with_it(
    server: Driver, observer: Observer
) -> None:
    """What it prints, returns, fails with and asks for is shown as all text of the robot is."""
    topic = fresh("hostile_text")
    observer.offer(topic=topic, kind=STRING)
    text = hostile().encode()
    body = (b"\0\1\0\0" + struct.pack("<I", len(text) + 1) + text + b"\0").hex()
    for does in ("print(text)", "{text: [text]}", "raise ValueError(line)", "robot.latest(line)", "{}[line]"):
        read = f"import robot\ntext = robot.latest({topic!r}, timeout=60)['data']"
        program = f"{read}\nline = text.replace(chr(10), ' ')\n{does}"
        request = server.tool("ros2_program_run", program=program, timeout_s=60)
        while not server.answered(request):
            observer.say(topic=topic, kind=STRING, bodies=[body])
        line = server.answer(request)
        said = line["result"]["structuredContent"]
        assert (said["outcome"], said["calls"] > 0) in {("ended", True), ("failed", True)}, said
        assert FORGED in json.dumps(said, ensure_ascii=False), does
        assert faults_of(line) == [], does
