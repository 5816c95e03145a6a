"""Stops where the machine itself fails: shared memory without room, and clocks that are set. The zero comes, a stop is
confirmed only where the robot was seen to stand, and nothing is left.

Times are judged in full, where the machine is quiet.
"""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from typing import Any

import pytest

from support.agent import FULL, until
from support.commanded import CommandedProcess
from support.driver import Driver, fresh
from support.full_memory import SharedMemory, shared_memory_of_its_own
from support.observer import Observer, observing
from support.raw_server import children, lives
from support.set_clocks import SetClocks, built
from support.velocities import TWIST, speed

SPEED, BAR_S = 0.3, 0.5
COMES_S = 30.0
"""For a zero that is late."""
CONFIRMS_S = 60.0
"""One try takes seconds on a busy machine, which may also hold up what the robot tells."""
HOUR_S = 3600.0
SERVER = (sys.executable, "-m", "ros2_mcp")
LEFT_S = 15.0
"""A stopper looks for late subscribers for 4 s; a busy machine stretches that."""

pytestmark = pytest.mark.timeout(3600 if FULL else 300)


def drive(server: Driver, observer: Observer, topic: str, **how: Any) -> int:
    """Four subscribers that a repeat drives; returns its request."""
    observer.watch(topic)
    return drive_on(server, observer, topic, **how)


def drive_on(server: Driver, observer: Observer, topic: str, **how: Any) -> int:
    server.knows(topic, 4)
    before = observer.driven(topic=topic)
    asked = {"topic_name": topic, "message_type": TWIST, "data": speed(TWIST, SPEED), "frequency": 20, "duration": 60}
    request = server.tool("ros2_topic_publish", **asked, **how)
    names = [by for by in before if by.startswith(f"{topic} ")]
    until(lambda: all(observer.driven(topic=topic)[by] > before[by] for by in names))
    return request


def zeros_s(observer: Observer, topic: str, since_ns: int) -> float:
    """How long after that time (monotonic) the last of four subscribers had its first zero, once nothing moves it."""
    firsts: dict[str, int] = {}

    def all_have_one() -> bool:
        firsts.clear()
        for one in observer.messages(topic=topic, after=since_ns):
            if not any(one["values"]):
                firsts.setdefault(one["by"], one["at"])
        return len(firsts) >= 4 and not observer.moving(topic=topic)

    until(all_have_one, COMES_S)
    return (max(firsts.values()) - since_ns) / 1e9


def in_time(*took_s: float) -> bool:
    """Whether zeros came as soon as promised; only a quiet machine can tell."""
    print("zeros after", [round(each, 3) for each in took_s])
    return not FULL or max(took_s) <= BAR_S


def stop(server: Driver, observer: Observer, topic: str, robot: CommandedProcess | None) -> tuple[float, dict]:
    """When the zeros of a stop came, and what it said; it says *confirmed* only where the robot stands by the truth."""
    since_ns = time.monotonic_ns()
    stopped = server.stop()[0]
    print(stopped["note"])
    assert robot is None or not (stopped["confirmed"] and robot.state()["speed"] > 0)
    return zeros_s(observer, topic, since_ns), stopped


def confirms(server: Driver) -> bool:
    return server.stop()[0]["confirmed"]


def is_gone(*pids: int) -> bool:
    return not any(map(lives, pids))


# ── /dev/shm is full ───────────────────────────────────────────────────────────────────────────────────────────────


@pytest.fixture(scope="module")
def memory(ros_environment: dict[str, str]) -> Iterator[SharedMemory]:
    """A small one, in which a ROS process has run before: without its page LTTng, which rclpy loads, ends any other."""
    with shared_memory_of_its_own() as found:
        code = "import rclpy; rclpy.init()"
        subprocess.run(found.command(sys.executable, "-c", code), env=ros_environment, check=True)
        yield found


def without_profile(environment: dict[str, str]) -> dict[str, str]:
    return {name: value for name, value in environment.items() if name != "FASTRTPS_DEFAULT_PROFILES_FILE"}


@contextmanager
def robot_in(environment: dict[str, str], before: list[str], base: str) -> Iterator[CommandedProcess]:
    robot = CommandedProcess("control_peer", environment, before)
    try:
        robot.put(base=base)
        yield robot
    finally:
        robot.kill()


def stops_although_it_is_full(
    memory: SharedMemory, environment: dict[str, str], observer: Observer, *, robot_inside: bool, is_full_later: bool
) -> None:
    """A stop, then the death of the server, then of the bridge, each while it drives."""
    base = fresh("full")
    topic, had = f"{base}/cmd_vel", memory.left()
    before = memory.command() if robot_inside else []
    with robot_in(environment, before, base) as robot:
        observer.watch(topic)
        ours: list[int] = []
        took_s: list[float] = []
        for death in ("", "server", "bridge"):
            server = Driver(environment, "--tools", "all", command=memory.command(*SERVER))
            try:
                drive_on(server, observer, topic)
                bridge = server.bridge()
                ours += [server.process.pid, bridge, *children(bridge)]
                assert len(children(bridge)) == 2, "there are no stoppers"
                if is_full_later:
                    memory.fill()
                since_ns = time.monotonic_ns()
                if death:
                    os.kill(server.process.pid if death == "server" else bridge, signal.SIGKILL)
                    took_s.append(zeros_s(observer, topic, since_ns))
                else:
                    after_s, stopped = stop(server, observer, topic, robot)
                    took_s.append(after_s)
                    assert stopped["confirmed"] and stopped["observed"] == "observed still"
                if death == "bridge":
                    until(lambda server=server, former=bridge: server.bridge() not in (0, former))
                    ours.append(server.bridge())
                    until(lambda server=server: confirms(server), CONFIRMS_S)
                if death != "server":
                    server.close()
            finally:
                server.end()
                if is_full_later:
                    with suppress(FileNotFoundError):
                        memory.empty()
        assert in_time(*took_s)
        until(lambda: is_gone(*ours), LEFT_S)
    if not is_full_later:
        assert [name for name in memory.left() if name not in had and name.startswith("ros2_mcp")] == []
        assert robot_inside or memory.left() == had


@pytest.mark.full
def test_a_full_shared_memory_keeps_no_stop_from_the_robot(
    memory: SharedMemory, ros_environment: dict[str, str], observer: Observer
) -> None:
    memory.fill()
    try:
        stops_although_it_is_full(
            memory, without_profile(ros_environment), observer, robot_inside=False, is_full_later=False
        )
    finally:
        memory.empty()


@pytest.mark.full
def test_a_full_shared_memory_of_robot_and_server_keeps_no_stop_from_the_robot(
    memory: SharedMemory, ros_environment: dict[str, str], observer: Observer
) -> None:
    memory.fill()
    try:
        stops_although_it_is_full(
            memory, without_profile(ros_environment), observer, robot_inside=True, is_full_later=False
        )
    finally:
        memory.empty()


@pytest.mark.full
def test_a_shared_memory_that_is_filled_while_it_drives_keeps_no_stop_from_the_robot(
    memory: SharedMemory, ros_environment: dict[str, str]
) -> None:
    environment = without_profile(ros_environment)
    with observing(environment, memory.command()) as inside:
        stops_although_it_is_full(memory, environment, inside, robot_inside=True, is_full_later=True)


# ── clocks are set ─────────────────────────────────────────────────────────────────────────────────────────────────


@pytest.fixture(scope="module")
def clocks(tmp_path_factory: pytest.TempPathFactory) -> SetClocks:
    folder = tmp_path_factory.mktemp("clocks")
    return SetClocks(folder, built(folder))


@pytest.fixture(scope="module")
def ground(ros_environment: dict[str, str], clocks: SetClocks) -> Iterator[tuple[Driver, CommandedProcess, str]]:
    """A server and a robot whose clocks can be set, and the robot's base."""
    environment, base = without_profile(ros_environment), fresh("clocked")
    with robot_in({**environment, **clocks.of("robot")}, [], base) as robot:
        server = Driver({**environment, **clocks.of("server")}, "--tools", "all")
        try:
            yield server, robot, base
        finally:
            server.end()


WHOSE = {"all": ("server", "bridge", "robot"), "server": ("server",), "bridge": ("bridge",), "robot": ("robot",)}


@pytest.mark.parametrize("whose", [pytest.param(each, marks=[pytest.mark.full] * (each != "all")) for each in WHOSE])
def test_a_clock_that_jumps_by_an_hour_and_back_while_it_drives_keeps_no_stop_from_the_robot(
    ground: tuple[Driver, CommandedProcess, str], clocks: SetClocks, observer: Observer, whose: str
) -> None:
    server, robot, base = ground
    topic = f"{base}/cmd_vel"
    observer.forget()
    observer.watch(topic)
    took_s: list[float] = []
    for ahead_s in (HOUR_S, 0.0, -HOUR_S, 0.0):
        request = drive_on(server, observer, topic)
        clocks.set(ahead_s, *WHOSE[whose])
        after_s, _ = stop(server, observer, topic, robot)
        took_s.append(after_s)
        server.outcome(request)
    until(lambda: confirms(server), CONFIRMS_S)  # clocks are as before
    assert in_time(*took_s)


def test_a_joint_that_moves_while_the_clocks_are_set_is_never_seen_to_stand(
    ground: tuple[Driver, CommandedProcess, str], clocks: SetClocks
) -> None:
    server, robot, _ = ground
    until(lambda: confirms(server), CONFIRMS_S)
    robot.push(joint_speed=0.15)
    try:
        for number in range(10 if FULL else 3):
            request = server.tool("ros2_stop")
            time.sleep(0.1 * (number % 4))  # at another moment of its observation each time
            clocks.set(HOUR_S * ((number + 1) % 2), *WHOSE["all"])
            stopped = server.answer(request)["result"]["structuredContent"]
            assert (stopped["confirmed"], stopped["observed"]) == (False, "not observed"), stopped["note"]
    finally:
        robot.push()
        clocks.set(0.0, *WHOSE["all"])
    until(lambda: confirms(server), CONFIRMS_S)


@pytest.mark.full
@pytest.mark.parametrize("ahead_s", [HOUR_S, -HOUR_S])
@pytest.mark.parametrize("victim", ["server", "bridge"])
def test_who_dies_while_the_clocks_are_set_leaves_a_zero(
    ros_environment: dict[str, str], clocks: SetClocks, observer: Observer, victim: str, ahead_s: float
) -> None:
    server, topic = Driver({**without_profile(ros_environment), **clocks.of("server")}), fresh("clocked")
    try:
        drive(server, observer, topic)
        bridge = server.bridge()
        clocks.set(ahead_s, *WHOSE["all"])
        since_ns = time.monotonic_ns()
        os.kill(server.process.pid if victim == "server" else bridge, signal.SIGKILL)
        assert in_time(zeros_s(observer, topic, since_ns))
    finally:
        server.end()
        clocks.set(0.0, *WHOSE["all"])
