"""Whatever dies under a drive or a move_until, the robot has its zero; latch, lease and policy hold in its middle."""

from __future__ import annotations

import os
import signal
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import pytest

from ros2_mcp.guard.state import StateFolder
from support.agent import FULL, Refusal, until
from support.commanded import CommandedProcess
from support.driver import Driver, fresh
from support.raw_server import children
from support.standstill import STOOD_STILL_S, TIMES

ROUNDS = 20
BARS_S = {"bridge": 0.5, "server": 1.0, "both": 0.5, "asleep": 1.1}
"""Those of stopping.md."""
REACTS_S = 0.02
"""After the message that meets a condition, which is the end of its period."""
WAYS = ("ros2_drive", "ros2_move_until")

POLICY = """
policy: 1
name: hall
allow:
  - {publish: "/**/cmd_vel", type: geometry_msgs/msg/Twist, rate_hz: 10, for_s: 5}
limits:
  base:
    types: [geometry_msgs/msg/Twist]
    norm: {linear: 0.4, angular: 0.8}
    ramp: {linear: {up: 0.2}}
"""

pytestmark = pytest.mark.timeout(1800 if FULL else 120)
Start = Callable[..., Driver]


@pytest.fixture
def start(ros_environment: dict[str, str]) -> Iterator[Start]:
    """Start a server of this test's own, with these options."""
    with ExitStack() as stack:

        def begin(*options: str) -> Driver:
            driver = Driver(ros_environment, "--tools", "all", *options)
            stack.callback(driver.end)
            return driver

        yield begin


def moving(server: Driver, robot: CommandedProcess, way: str, speed: float = 0.3, timeout_s: float = 60) -> int:
    """A robot that is moved, far from its end: the request."""
    base = fresh("dies")
    robot.put(base=base)
    server.knows(f"{base}/cmd_vel", 1)
    for topic in ("odom", "scan"):
        until(lambda topic=topic: server.do("ros2_topic_info", topic_name=f"{base}/{topic}")["publishers"])
    if way == "ros2_drive":
        asked: dict[str, Any] = {"topic_name": f"{base}/cmd_vel", "distance_m": 20, "speed": speed, "guard_m": 0.2}
    else:
        asked = {
            "command_topic": f"{base}/cmd_vel",
            "topic_name": f"{base}/odom",
            "linear_x": speed,
            "timeout": timeout_s,
        }
        asked |= {"condition": "pose.pose.position.x > 20"}
    request = server.tool(way, **asked)

    def is_moving() -> bool:
        server.hear()
        if request in server.answers:
            server.result(request)  # raises for what is refused
        return robot.state()["speed"] > 0.6 * speed

    until(is_moving)
    return request


def zero_after(robot: CommandedProcess, since: float) -> float:
    """When the zero came after which no command moved the robot any more, in s after that moment."""
    until(lambda: robot.state()["speed"] < 1e-6)
    # A robot that stands already by its own time-out has its zero later, where the machine is busy.
    return until(lambda: robot.state()["zero_at"]) - since


@pytest.fixture
def robot(ros_environment: dict[str, str]) -> Iterator[CommandedProcess]:
    """A process for each test: of one that has had a hundred bases, a new server no longer hears of the next."""
    process = CommandedProcess("driven_robot", ros_environment)
    yield process
    process.kill()


def happen(what: str, server: Driver) -> None:
    bridge = children(server.process.pid)[0]
    if what == "asleep":
        server.process.send_signal(signal.SIGSTOP)
    for pid in {"bridge": [bridge], "server": [server.process.pid], "both": [server.process.pid, bridge]}.get(what, []):
        os.kill(pid, signal.SIGKILL)


@pytest.mark.promise("stopping", "the bridge is killed, or server and bridge are")
@pytest.mark.parametrize("way", WAYS)
@pytest.mark.full  # each round starts a server; in CI tests/ros/stopping has the same of a drive
@pytest.mark.parametrize("what", BARS_S)
def test_whatever_dies_or_sleeps_in_its_middle_the_robot_has_its_zero(
    start: Start, robot: CommandedProcess, what: str, way: str
) -> None:
    took: list[float] = []
    for _ in range(ROUNDS):
        server = start()
        moving(server, robot, way)
        since = time.monotonic()
        happen(what, server)
        took.append(zero_after(robot, since))
        if what == "asleep":
            server.process.send_signal(signal.SIGCONT)
        server.end()
    print(f"{way}, {what}: worst {max(took):.3f} s, median {sorted(took)[len(took) // 2]:.3f} s of {len(took)}")
    assert max(took) <= BARS_S[what]


@pytest.mark.parametrize("way", [pytest.param("ros2_drive", marks=pytest.mark.full), "ros2_move_until"])
def test_a_lease_and_a_latch_in_its_middle_end_it_and_it_says_so(
    start: Start, robot: CommandedProcess, ros_environment: dict[str, str], way: str
) -> None:
    server = start("--policy", "lab")
    request = moving(server, robot, way)
    server.process.send_signal(signal.SIGSTOP)
    zero_after(robot, 0.0)
    server.process.send_signal(signal.SIGCONT)
    result = server.result(request)
    assert result["outcome"] == "interrupted"
    assert "link lease" in result["note"]

    request = moving(server, robot, way, speed=0.2)
    latch = StateFolder.of(domain_id=int(ros_environment["ROS_DOMAIN_ID"]), env=ros_environment).latch()
    latch.set(by="operator", reason="somebody is in the way")
    try:
        zero_after(robot, 0.0)
        result = server.result(request)
        assert result["outcome"] == "interrupted"
        assert "somebody is in the way" in result["note"]
        with pytest.raises(Refusal, match="the latch of this robot is set"):
            moving(server, robot, way, speed=0.2)
    finally:
        latch.reset(by="operator", seen=latch.look().count)


@pytest.mark.full  # in CI tests/ros/motion/test_move_until.py has the same of a server that is awake
def test_a_condition_is_judged_beside_the_robot_though_the_server_sleeps(start: Start, robot: CommandedProcess) -> None:
    server, took = start(), list[float]()
    for _ in range(ROUNDS):
        for _ in range(TIMES):  # again where the robot's process was held up
            base = fresh("sleeps")
            robot.put(base=base, discs=[[1.2, 0.0, 0.2]])
            server.knows(f"{base}/cmd_vel", 1)
            until(lambda base=base: server.do("ros2_topic_info", topic_name=f"{base}/scan")["publishers"])
            robot.note_near(range_m=0.6)
            given = {"topic_name": f"{base}/scan", "condition": "nearest(-20, 20) < 0.6", "timeout": 30}
            request = server.tool("ros2_move_until", command_topic=f"{base}/cmd_vel", linear_x=0.3, **given)
            until(lambda: server.hear() or robot.state()["truth"][0] > 0.3)  # a third of a second before it is met
            server.process.send_signal(signal.SIGSTOP)
            zero_after(robot, 0.0)
            state = robot.state()
            server.process.send_signal(signal.SIGCONT)
            result = server.result(request)
            if state["stood_s"] < STOOD_STILL_S:
                break
        assert (result["outcome"], result["met"]) == ("met", True), result["note"]
        took.append(state["zero_at"] - state["near_at"])
    took.sort()
    print(f"asleep, met: worst {took[-1] * 1000:.1f} ms, median {took[len(took) // 2] * 1000:.1f} ms of {len(took)}")
    assert took[0] > 0 and took[-1] <= REACTS_S


@pytest.mark.full
@pytest.mark.parametrize("_", range(ROUNDS))
def test_a_metre_at_15_centimetres_a_second_fits_into_what_teleop_slow_allows(
    start: Start, robot: CommandedProcess, _: int
) -> None:
    server, base = start("--policy", "teleop-slow"), fresh("slow")
    robot.put(base=base)
    server.knows(f"{base}/cmd_vel", 1)
    until(lambda: server.do("ros2_topic_info", topic_name=f"{base}/scan")["publishers"])
    result = server.result(server.tool("ros2_drive", topic_name=f"{base}/cmd_vel", distance_m=1.0, speed=0.15))
    assert result["outcome"] == "reached", result
    assert result["elapsed_s"] <= 10.0


@pytest.mark.full
@pytest.mark.parametrize("way", WAYS)
def test_a_policy_holds_in_its_middle(start: Start, robot: CommandedProcess, way: str, tmp_path: Path) -> None:
    """Its speed is asked of the whole motion before anything moves, its ramp and its time of each command."""
    tmp_path.chmod(0o700)
    file = tmp_path / "policy.yaml"
    file.write_text(POLICY, encoding="utf-8")
    file.chmod(0o600)
    server = start("--policy", str(file))
    with pytest.raises(Refusal, match=r"linear is 0\.5, at most 0\.4 is allowed \(hall: limit base\)"):
        moving(server, robot, way, speed=0.5, timeout_s=4)
    assert robot.state()["moved_at"] == 0.0
    result = server.result(moving(server, robot, way, speed=0.3, timeout_s=4))
    assert result["outcome"] == "timeout"
    assert result["elapsed_s" if way == "ros2_drive" else "elapsed"] <= 5.0
    assert "were sent slower than they were" in result["note"]
    zero_after(robot, 0.0)
