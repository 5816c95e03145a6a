"""A process that an engine's client has started survives it, and hears nothing of its death: the lease ends both."""

from __future__ import annotations

import itertools
import os
import signal
import time
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

import pytest

from ros2_mcp.link.bootstrap import bootstrap
from ros2_mcp_common.start.finding import Search
from support.agent import until
from support.bridge_client import PATIENCE_S, RELIABLE, Client
from support.far_side import OWN_PYTHON, SurvivingEngine, bare, begun
from support.observer import Observer
from support.raw_server import lives
from support.standstill import undisturbed
from support.velocities import TWIST, cdr

LEASE_S = 2.0
"""That of every robot elsewhere."""
ORPHAN_S = 4
"""In place of 15 s, which are as long for no other reason than outages."""
ROUNDS = 20


@dataclass
class Robot:
    """Robots in a container, one after the other, each driven by a bridge of its own."""

    domain_id: int
    environment: dict[str, str]
    observer: Observer
    folder: Path
    numbers: Iterator[int] = field(default_factory=itertools.count)

    def stands_after_s(self) -> float:
        """From the death of the engine's client to the last command that moved the robot; the bridge ends, too."""
        number, observer = next(self.numbers), self.observer
        topic = f"/contained_{number}"
        engine = SurvivingEngine(self.folder / str(number), ("env",))
        way = (str(engine.program), "exec", "-i", "ros")
        start = bootstrap(
            way, Search(python=OWN_PYTHON, domain_id=self.domain_id), options=["--orphan-s", str(ORPHAN_S)]
        )
        observer.watch(topic)
        try:
            with begun(start, bare(self.environment)) as client_of_engine:
                bridge = Client(client_of_engine, start.arrival.feed)
                pid = bridge.hello["pid"]
                bridge.send("failsafe_publish", topic=topic, type=TWIST, qos=RELIABLE)
                drives = {"topic": topic, "type": TWIST, "qos": RELIABLE, "epoch": 0, "wait_match_s": PATIENCE_S}
                bridge.send("repeat", cdr(TWIST, 0.5), rate_hz=20, duration_s=600, **drives)
                observer.until_driven(topic, 10, of=4)
                bridge.ok("ping", lease_s=LEASE_S)
                died_ns = time.monotonic_ns()
                os.kill(client_of_engine.pid, signal.SIGKILL)
                assert observer.comes_to_rest(topic, PATIENCE_S) == []
                last_ns = max(one["at"] for one in observer.messages(topic=topic) if any(one["values"]))
                until(lambda: not lives(pid), ORPHAN_S + PATIENCE_S)
                return (last_ns - died_ns) / 1e9
        finally:
            engine.end()
            for by in observer.counts(topic=topic):
                if by.startswith(f"{topic} "):
                    observer.leave(by=by)
            observer.forget()


@pytest.fixture
def robot(domain_id: int, ros_environment: dict[str, str], observer: Observer, tmp_path: Path) -> Robot:
    return Robot(domain_id, ros_environment, observer, tmp_path)


def test_what_it_drives_stands_after_the_lease_and_nothing_of_ours_stays(robot: Robot) -> None:
    robot.stands_after_s()


@pytest.mark.full
@pytest.mark.timeout(1200)
def test_it_stands_within_a_third_of_a_second_of_the_leases_end(robot: Robot) -> None:
    took_s = [undisturbed(robot.stands_after_s) for _ in range(ROUNDS)]
    print(f"dead client of an engine: {sorted(round(each, 3) for each in took_s)}", flush=True)
    assert max(took_s) <= LEASE_S + 0.3
