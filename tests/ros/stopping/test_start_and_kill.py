"""Servers that are started and killed again and again, with one state folder: the base stands, and nothing is left.

A few cycles here; in full 200, or as many as `ROS2_MCP_ROUNDS` says, and how soon.
"""

from __future__ import annotations

import os
import random
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import suppress
from pathlib import Path

import pytest

from support import own_processes, shared_memory
from support.agent import FULL, until
from support.driver import Driver
from support.observer import Observer
from support.own_processes import Process
from support.processes import running
from support.raw_server import children
from support.standstill import undisturbed
from support.velocities import TWIST

CYCLES = int(os.environ.get("ROS2_MCP_ROUNDS", "200")) if FULL else 3
Victims = tuple[str, ...]
VICTIMS: tuple[Victims, ...] = (("server", "bridge"), ("bridge",), ("server",), ("bridge", "server"))
APART_S = 0.05
LATEST_S = 3.0
STANDS_S = 1.0
"""After the server was killed; after the bridge alone it is half of that."""
COMES_S = 15.0
PATIENCE_S = 60.0
"""This only ends a hang."""
DEAF = 0.02
"""Of the deaths: a subscriber that shares a locked port of shared memory with the dead hears nobody for 1 s (decision
33)."""
CMD_VEL = "/cmd_vel"

pytestmark = pytest.mark.timeout(max(1800, 12 * CYCLES) if FULL else 300)


@pytest.fixture(scope="module")
def robot(demo_environment: dict[str, str]) -> Iterator[subprocess.Popen[str]]:
    with running(demo_environment, sys.executable, "-m", "ros2_mcp_demo") as process:
        yield process


def zero_s(observer: Observer, since_ns: int) -> float:
    """From that time to the arrival of the first zero after the last command that moves; 0 where none had come."""
    assert observer.comes_to_rest(CMD_VEL, PATIENCE_S) == []
    heard = observer.messages(topic=CMD_VEL)
    last_move = max((one["at"] for one in heard if any(one["values"])), default=0)
    zero = min((one["at"] for one in heard if one["at"] > last_move), default=0)
    return max(0.0, (zero - since_ns) / 1e9) if last_move else 0.0


def in_shared_memory(since: float) -> tuple[int, int]:
    """How many segments the dead have left since then, and how many ports of anybody there are."""
    segments = [one for one in shared_memory.dead_segments() if one.at >= since]
    return len(segments), len(list(shared_memory.FOLDER.glob("*_port*")))


def in_state(folder: Path) -> list[str]:
    """The files in a state folder."""
    return sorted(str(path.relative_to(folder)) for path in folder.rglob("*") if not path.is_dir())


def has_ended(one: Process) -> bool:
    """Whether it has, also where another process has got its number since."""
    now = own_processes.process(one.pid)
    return now is None or now.started_s != one.started_s


def test_cycles_of_start_and_kill_leave_nothing_and_each_next_start_works(
    start_server: Callable[..., Driver], observer: Observer, robot: object, ros_environment: dict[str, str]
) -> None:
    chance, left = random.Random(32), list[Process]()
    took_s, sizes = list[tuple[float, Victims]](), list[tuple[int, int, int]]()
    state, began = Path(ros_environment["XDG_STATE_HOME"]), time.time()
    observer.join(by="base", topic=CMD_VEL, kind=TWIST)

    def note(server: Driver) -> None:
        left.extend(filter(None, map(own_processes.process, (server.process.pid, *children(server.process.pid)))))

    def cycle(number: int) -> float:
        victims, later_s = VICTIMS[number % len(VICTIMS)], chance.uniform(0.0, LATEST_S)
        observer.forget()
        server = start_server()
        found = {"server": server.process.pid}
        if number % 3:
            found["bridge"] = server.bridge()
            turning = {"data": {"angular": {"z": 0.3}}, "frequency": 20, "duration": 60}
            server.tool("ros2_topic_publish", topic_name=CMD_VEL, message_type=TWIST, **turning)
            observer.until_driven(CMD_VEL)
            time.sleep(later_s / 3)
        else:  # its bridge may still be starting
            time.sleep(later_s)
            if own := children(server.process.pid):
                found["bridge"] = own[0]
        note(server)
        since_ns = time.monotonic_ns()
        for victim in victims:
            with suppress(ProcessLookupError):
                os.kill(found.get(victim, found["server"]), signal.SIGKILL)
            time.sleep(chance.uniform(0.0, APART_S))
        took = zero_s(observer, since_ns)
        note(server)
        server.end()
        return took

    for number in range(CYCLES):
        victims = VICTIMS[number % len(VICTIMS)]
        took_s.append((undisturbed(lambda n=number: cycle(n)) if FULL else cycle(number), victims))
        sizes.append((*in_shared_memory(began), len(in_state(state))))
        told = f"{number}, {' then '.join(victims)}: {took_s[-1][0]:.3f} s; segments, ports and files: {sizes[-1]}"
        print(told, flush=True)
    print("zero after", sorted(round(each, 3) for each, _ in took_s), flush=True)
    until(lambda: all(map(has_ended, left)), PATIENCE_S)
    last = start_server()
    bridges = [node for node in last.do("ros2_node_list")["nodes"] if "ros2_mcp" in node]
    print("of the dead are in the graph:", bridges, "and in the state folder:", in_state(state), flush=True)
    until(lambda: last.do("ros2_stop")["confirmed"], PATIENCE_S)  # once it has discovered the robot's odometry
    if FULL:
        judge(took_s, sizes)


def judge(took_s: list[tuple[float, Victims]], sizes: list[tuple[int, int, int]]) -> None:
    """Nothing grows with the number of cycles, and the base stands in time."""
    tenth = max(1, CYCLES // 10)
    early, late = sizes[tenth : 2 * tenth], sizes[-tenth:]
    for place in range(3):
        assert max(one[place] for one in late) <= 1.5 * max(one[place] for one in early) + 2, (early, late)
    bar_s = {victims: STANDS_S if "server" in victims else STANDS_S / 2 for victims in VICTIMS}
    assert max(took for took, _ in took_s) < COMES_S
    late_ones = [took for took, victims in took_s if took > bar_s[victims]]
    assert len(late_ones) <= max(1, DEAF * CYCLES), late_ones
