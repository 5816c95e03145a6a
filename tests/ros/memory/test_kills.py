"""`kill -9` of the bridge and of the server while they record: the files open, and at most a second is missing.

First the bridge of a server is killed that records two topics, then, when the recordings go on with the next one, the
server itself. How much is missing is measured in full, of 1 message/s and 20 MB/s at once. What nobody could hear
between two bridges is told as the outage.
"""

from __future__ import annotations

import os
import random
import shutil
import signal
import struct
import subprocess
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from itertools import pairwise
from pathlib import Path

import pytest

from ros2_mcp.bags.bag import Bag
from ros2_mcp.model.samples import Sample
from support.agent import Agent, Refusal, agent_for, until
from support.standstill import standstills

StartPeer = Callable[..., "subprocess.Popen[str]"]
KILLS = 200
NAMES = ("slow", "fast")
NUMBER_AT = 16
MOST_MISSING_S = 1.0


def written(agent: Agent) -> dict[str, int]:
    found = agent.call("ros2_record_status")["recordings"]
    return {each["bag"]: each["messages"] for each in found}


def wait_written(agent: Agent, more_than: dict[str, int], seconds: float = 30.0) -> None:
    deadline = time.monotonic() + seconds
    while not all(count > more_than[name] for name, count in written(agent).items()):
        assert time.monotonic() < deadline, agent.call("ros2_record_status")
        time.sleep(0.1)


def wait_next_bridge(agent: Agent, former: int, seconds: float = 30.0) -> None:
    deadline = time.monotonic() + seconds
    while bridge_of(agent) in (None, former):
        assert time.monotonic() < deadline, "there is no next bridge"
        time.sleep(0.1)


def bridge_of(agent: Agent) -> int | None:
    """The process of its bridge; None where it is being lost."""
    try:
        return agent.call("ros2_status")["bridge_pid"]
    except Refusal:
        return None


def parent_of(pid: int) -> int:
    return int(Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[1])


def kill(pid: int, chance: random.Random) -> float:
    """Kills it at a random moment; returns when that was, as Unix time."""
    time.sleep(chance.uniform(0.0, 1.5))
    os.kill(pid, signal.SIGKILL)
    return time.time()


def number(sample: Sample) -> int:
    return struct.unpack_from("<Q", sample.data, NUMBER_AT)[0]


def witnessed(log: Path, topic: str) -> dict[int, float]:
    """When the independent subscriber received each message of a topic, by its number, as Unix times."""
    lines = [line.split() for line in log.read_text().splitlines()]
    return {int(line[1]): float(line[2]) for line in lines if len(line) == 3 and line[0] == topic}


def lost_s(
    heard: dict[int, float],
    kept: list[int],
    killed: dict[str, float],
    resumed: float,
    still: list[tuple[float, float]],
) -> dict[str, float]:
    """How long before each kill the oldest message was witnessed that is not in the file, and the time between two
    bridges; times when the machine stood still do not count."""
    in_file = set(kept)
    missed = [at for number, at in heard.items() if number > kept[0] and number not in in_file]

    def before(kill: float, earliest: float) -> float:
        return max((running_s(at, kill, still) for at in missed if earliest < at < kill), default=0.0)

    return {
        "bridge": before(killed["bridge"], 0.0),
        "outage": resumed - killed["bridge"],
        "server": before(killed["server"], resumed),
    }


def running_s(begin: float, end: float, still: list[tuple[float, float]]) -> float:
    return end - begin - sum(max(0.0, min(end, until) - max(begin, since)) for since, until in still)


def test_what_was_on_the_disk_before_and_between_kills_of_bridge_and_server_is_in_files_that_open(
    start_peer: StartPeer, ros_environment: dict[str, str], tmp_path: Path
) -> None:
    """The recordings go on with the next bridge, and nothing is in them twice."""
    start_peer("stream", "/slow:4:100", "/fast:50:4000")
    with recording(ros_environment, tmp_path) as agent:
        bridge = agent.call("ros2_status")["bridge_pid"]
        server = parent_of(bridge)
        until(lambda: all(kept_numbers(tmp_path / name) for name in NAMES))
        os.kill(bridge, signal.SIGKILL)
        until(lambda: all(has_an_outage(kept_numbers(tmp_path / name)) for name in NAMES))
        on_disk = {name: kept_numbers(tmp_path / name) for name in NAMES}
        os.kill(server, signal.SIGKILL)
    for name in NAMES:
        assert kept_numbers(tmp_path / name)[: len(on_disk[name])] == on_disk[name]


def has_an_outage(numbers: list[int]) -> bool:
    return any(after - before > 1 for before, after in pairwise(numbers))


@contextmanager
def recording(environment: dict[str, str], folder: Path) -> Iterator[Agent]:
    """A server that records, and has written of each topic."""
    with agent_for(environment, "--tools", "all", "--record-dir", str(folder)) as agent:
        for name in NAMES:
            agent.call("ros2_record_start", topic_names=[f"/{name}"], name=name)
        wait_written(agent, dict.fromkeys(NAMES, 0))
        yield agent


def kept_numbers(path: Path) -> list[int]:
    """The numbers of the messages in a recording that was not closed, which are in order."""
    with Bag(path) as bag:
        numbers = [number(sample) for _, sample in bag.messages()]
        assert bag.problems  # no index: it was not closed
    assert all(b > a for a, b in pairwise(numbers))
    return numbers


@pytest.mark.full
@pytest.mark.timeout(KILLS * 15 + 60)
def test_a_killed_bridge_or_server_has_lost_at_most_one_second(
    start_peer: StartPeer, ros_environment: dict[str, str], tmp_path: Path
) -> None:
    """What is missing is what an independent subscriber had at that time, and the file has not."""
    log = tmp_path / "witnessed"
    start_peer("stream", "/slow:1:100", "/fast:50:400000")
    start_peer("witness", str(log), "/slow", "/fast")
    chance = random.Random(1)
    worst = {f"{when} {name}": 0.0 for when in ("bridge", "outage", "server") for name in NAMES}
    for run in range(KILLS // 2):
        folder = tmp_path / str(run)
        with recording(ros_environment, folder) as agent:
            bridge = agent.call("ros2_status")["bridge_pid"]
            server = parent_of(bridge)
            with standstills() as still:
                killed = {"bridge": kill(bridge, chance)}
                wait_next_bridge(agent, bridge)  # what came before is counted long before it is there
                wait_written(agent, written(agent))
                resumed = time.time()
                killed["server"] = kill(server, chance)
        for name in NAMES:
            numbers = kept_numbers(folder / name)
            for when, seconds in lost_s(witnessed(log, f"/{name}"), numbers, killed, resumed, still).items():
                worst[f"{when} {name}"] = max(worst[f"{when} {name}"], seconds)
        shutil.rmtree(folder)
        print(2 * run + 2, "kills; at most", {key: round(value, 3) for key, value in worst.items()}, flush=True)
    assert all(seconds <= MOST_MISSING_S for key, seconds in worst.items() if not key.startswith("outage")), worst
