"""Whatever ends a program that drives, every subscriber has its zero. Most ends here; all in full, 20 of each, or as
many as `ROS2_MCP_ROUNDS` says.
"""

from __future__ import annotations

import os
import random
import signal
import time
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

import pytest

pytest.importorskip("pydantic_monty", reason="needs the extra programs")

from support.agent import FULL, Refusal, until
from support.driver import Driver, fresh
from support.observer import Observer
from support.raw_server import children, lives
from support.standstill import undisturbed
from support.velocities import TWIST, speed

ROUNDS = int(os.environ.get("ROS2_MCP_ROUNDS", "20"))
COMES_S = 15.0
"""For a zero that is late."""
BAR_S = 0.5
"""Of "Stop means stop"."""
SPEED = 0.3
LATER_S = (0.3, 1.5)
TIMEOUT_S = 7
DRIVES = f"""
import robot, time
def drive():
    robot.publish(@TOPIC@, message_type="{TWIST}", data={{"linear": {{"x": {SPEED}}}}})
    time.sleep(0.05)
"""
FOR_EVER = f"{DRIVES}\nwhile True: drive()"
ONCE = f"""
import robot, time
robot.publish(@TOPIC@, message_type="{TWIST}", data={{"linear": {{"x": {SPEED}}}}})
"""
WAITS = {
    "a sleep": f"{ONCE}time.sleep(60)",
    "a repeat": ONCE.replace("}})", "}}, frequency=20, duration=60)"),
    "a call": f"{ONCE}for message in robot.messages(@TOPIC@): pass",
}
"""Programs that wait for a minute, while the robot moves."""
FOR_A_WHILE = f"{DRIVES}\nfor _ in range(90): drive()\n"
"""Longer than the 3 s after which a publisher is discovered whose first announcement was missed."""

pytestmark = pytest.mark.timeout(max(1500, 15 * ROUNDS) if FULL else 240)


def started_by(server: Driver, program: str) -> int:
    """The process of the server's own whose program has this name."""

    def found() -> int:
        for pid in started(server):
            with suppress(FileNotFoundError, ProcessLookupError):  # it has ended
                if program in Path(f"/proc/{pid}/cmdline").read_text():
                    return pid
        return 0

    return until(found)


def started(server: Driver) -> list[int]:
    """The processes that any thread of the server has started, and theirs: a sandbox is not the main thread's."""
    own: list[int] = []
    for thread in Path(f"/proc/{server.process.pid}/task").glob("*/children"):
        with suppress(FileNotFoundError, ProcessLookupError):  # that thread has ended
            own += map(int, thread.read_text().split())
    return [*own, *(below for pid in own for below in children(pid))]


def kill(*programs: str) -> Callable[[Driver, int], None]:
    def do(server: Driver, _: int) -> None:
        for pid in [started_by(server, program) if program else server.process.pid for program in programs]:
            os.kill(pid, signal.SIGKILL)

    return do


def end_client(server: Driver, _: int) -> None:
    assert server.process.stdin
    server.process.stdin.close()


def cancel(server: Driver, request: int) -> None:
    server.tell("notifications/cancelled", requestId=request)


def signal_sandbox(number: int) -> Callable[[Driver, int], None]:
    return lambda server, _: os.kill(started_by(server, SANDBOX), number)


SANDBOX, BRIDGE, SERVER = "monty", "ros2_mcp_bridge", ""
DEATHS = {"is killed": signal.SIGKILL, "crashes": signal.SIGABRT, "is stopped": signal.SIGSTOP}
"""Of the sandbox. Out of memory, the kernel kills it, and an allocator aborts it (SIGABRT)."""
FROM_OUTSIDE: dict[str, Callable[[Driver, int], None]] = {
    "the call is cancelled": cancel,
    "ros2_stop": lambda server, _: server.stop() and None,
    "the sandbox is killed": kill(SANDBOX),
    "the server is killed": kill(SERVER),
    "the bridge is killed": kill(BRIDGE),
    **({"the client ends": end_client, "server and bridge are killed": kill(SERVER, BRIDGE)} if FULL else {}),
}
LAST = ("the client ends", "the server is killed", "server and bridge are killed")
"""What the server that the tests share does not outlive."""
BY_ITSELF: dict[str, tuple[str, bool]] = {
    "an error": (f"{FOR_A_WHILE}print(1 / 0)", False),
    "its time": (f"{FOR_A_WHILE}while True: pass", True),
}
if FULL:
    BY_ITSELF |= {
        "its end": (FOR_A_WHILE, False),
        "an end that it asks for": (f"{FOR_A_WHILE}raise SystemExit", False),
        "its time, asleep": (f"{FOR_A_WHILE}time.sleep(60)", True),
        "a limit": (f"{FOR_A_WHILE}[0] * 10**9", False),
        "its memory, used up while it drives": (
            f"{FOR_A_WHILE}kept = []\nwhile True:\n    drive()\n    kept.append('x' * 5_000_000 + str(len(kept)))",
            False,
        ),
    }
"""The program, and whether it is its time that ends it: then it has done nothing for a while."""


def begin(
    server: Driver,
    observer: Observer,
    program: str,
    times: int = 2,
    of: int = 4,
    is_known: bool = False,
    **options: float,
) -> tuple[str, int, int]:
    """A topic with four subscribers that a program drives: its name, the request, and when it was made.

    What is said once may escape the lossy ones: then `of` two it is waited for. With `is_known` all know the publisher
    before: a busy machine may take longer for that than the program drives.
    """
    topic = fresh("programmed")
    names = observer.watch(topic)
    server.knows(topic, 4)
    if is_known:
        server.do("ros2_topic_publish", topic_name=topic, message_type=TWIST, data=speed(TWIST, 0.0))
        until(lambda: all(observer.matched(by=by) > 0 for by in names))
    begun_ns = time.monotonic_ns()
    request = server.tool("ros2_program_run", program=program.replace("@TOPIC@", repr(topic)), **options)
    observer.until_driven(topic, times, of=of)
    return topic, request, begun_ns


def leave(observer: Observer, topic: str) -> None:
    for by in observer.counts(topic=topic):
        if by.startswith(f"{topic} "):
            observer.leave(by=by)
    observer.forget()


def zeros_s(observer: Observer, topic: str, since_ns: int = 0) -> float:
    """How long after that time, or else after its last message that moves, the last of four subscribers has its zero.

    Much, where one has none.
    """
    waited: dict[str, float] = {}
    moved: dict[str, int] = {}
    for one in observer.messages(topic=topic, after=since_ns):
        if any(one["values"]):
            moved[one["by"]] = one["at"]
            waited.pop(one["by"], None) if not since_ns else None
        else:
            waited.setdefault(one["by"], (one["at"] - (since_ns or moved.get(one["by"], one["at"]))) / 1e9)
    return 1e9 if observer.moving(topic=topic) or len(waited) < 4 else max(waited.values())


def seconds(
    server: Driver, observer: Observer, fate: str, after_s: float, program: str = FOR_EVER
) -> tuple[float, list[int]]:
    """How long it takes from a fate of a program that drives until all have their zeros; what ran then."""
    topic, request, _ = begin(server, observer, program, times=1, of=2)
    time.sleep(after_s)
    processes = started(server)
    since_ns = time.monotonic_ns()
    FROM_OUTSIDE[fate](server, request)
    with suppress(AssertionError):
        until(lambda: zeros_s(observer, topic, since_ns) < COMES_S, COMES_S)
    took_s = zeros_s(observer, topic, since_ns)
    leave(observer, topic)
    return took_s, processes


@pytest.mark.parametrize("fate", FROM_OUTSIDE)
def test_a_program_that_is_ended_while_it_drives_leaves_nobody_without_a_zero(
    start_server, server: Driver, observer: Observer, fate: str
) -> None:
    """And with nothing that moves the robot after that zero, by the order in which the messages were written."""
    mine = start_server() if fate in LAST else server
    topic, request, _ = begin(mine, observer, FOR_EVER)
    processes, since_ns = started(mine), time.time_ns()
    FROM_OUTSIDE[fate](mine, request)
    observer.until_stopped(topic, since_ns)
    if fate in LAST:
        mine.end()
        until(lambda: not any(map(lives, processes)))
    elif fate != "the call is cancelled":  # which has no answer
        told = mine.outcome(request)
        assert fate != "the bridge is killed" or "BridgeLost" in told, told
    assert observer.unstopped(topic=topic, since=since_ns) == []
    leave(observer, topic)


@pytest.mark.full
@pytest.mark.parametrize("fate", FROM_OUTSIDE)
def test_a_program_that_is_ended_while_it_drives_leaves_nobody_without_a_zero_for_half_a_second(
    start_server, server: Driver, observer: Observer, fate: str
) -> None:
    chance, processes = random.Random(15), list[int]()

    def once() -> float:
        mine = start_server() if fate in LAST else server
        took_s, ran = seconds(mine, observer, fate, chance.uniform(*LATER_S))
        if fate in LAST:
            processes.extend(ran)
            mine.end()
        return took_s

    took_s = [undisturbed(once) for _ in range(ROUNDS)]
    print(f"{fate}: {sorted(round(each, 3) for each in took_s)}", flush=True)
    assert max(took_s) <= BAR_S
    until(lambda: not any(map(lives, processes)))


WAITED = [("a sleep", "is killed"), ("a repeat", "is killed"), ("a call", "crashes"), ("a sleep", "is stopped")]


@pytest.mark.parametrize(("wait", "death"), WAITED, ids=map(" in ".join, WAITED))
def test_a_sandbox_that_dies_while_its_program_waits_is_seen_and_what_it_moves_is_stopped(
    server: Driver, observer: Observer, wait: str, death: str
) -> None:
    """Long before the wait is over, and with its own name."""
    topic, request, _ = begin(server, observer, WAITS[wait], times=1, of=2, timeout=90)
    since_ns = time.time_ns()
    signal_sandbox(DEATHS[death])(server, request)
    assert "crashed" in server.outcome(request, within_s=45.0)
    observer.until_stopped(topic, since_ns)
    assert observer.unstopped(topic=topic, since=since_ns) == []
    leave(observer, topic)


@pytest.mark.full
@pytest.mark.parametrize("death", DEATHS)
@pytest.mark.parametrize("wait", WAITS)
def test_a_sandbox_that_dies_while_its_program_waits_leaves_a_zero_within_half_a_second(
    server: Driver, observer: Observer, wait: str, death: str
) -> None:
    chance = random.Random(32)
    FROM_OUTSIDE[death] = signal_sandbox(DEATHS[death])

    def once() -> float:
        return seconds(server, observer, death, chance.uniform(*LATER_S), WAITS[wait])[0]

    took_s = [undisturbed(once) for _ in range(ROUNDS)]
    print(f"in {wait} it {death}: {sorted(round(each, 3) for each in took_s)}", flush=True)
    assert max(took_s) <= BAR_S


@pytest.mark.parametrize("fate", BY_ITSELF)
def test_a_program_that_ends_by_itself_while_it_drives_leaves_a_zero(
    server: Driver, observer: Observer, fate: str
) -> None:
    program, _ = BY_ITSELF[fate]
    topic, request, _ = begin(server, observer, program, is_known=True, timeout=TIMEOUT_S)
    with suppress(Refusal):
        server.result(request)
    until(lambda: not observer.moving(topic=topic))
    leave(observer, topic)


@pytest.mark.full
@pytest.mark.parametrize("fate", BY_ITSELF)
def test_a_program_that_ends_by_itself_while_it_drives_leaves_a_zero_within_half_a_second(
    server: Driver, observer: Observer, fate: str
) -> None:
    program, is_by_time = BY_ITSELF[fate]

    def once() -> float:
        topic, request, begun_ns = begin(server, observer, program, timeout=TIMEOUT_S)
        with suppress(Refusal):
            server.result(request)
        left = observer.comes_to_rest(topic, COMES_S)
        took_s = zeros_s(observer, topic, begun_ns) - TIMEOUT_S if is_by_time else zeros_s(observer, topic)
        leave(observer, topic)
        return 1e9 if left else took_s

    took_s = [undisturbed(once) for _ in range(ROUNDS)]
    print(f"{fate}: {sorted(round(each, 3) for each in took_s)}", flush=True)
    assert max(took_s) <= BAR_S
