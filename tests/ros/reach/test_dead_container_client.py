"""A process that an engine's client has started survives it, and hears nothing of its death: the lease ends both."""

from __future__ import annotations

import os
import signal
import time
from pathlib import Path

import pytest

from ros2_mcp.link.bootstrap import bootstrap
from ros2_mcp_bridge.finding import Search
from support.agent import FULL, until
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
ROUNDS = 20 if FULL else 1

pytestmark = pytest.mark.timeout(1200 if FULL else 180)


def test_what_it_drives_stands_after_the_lease_and_nothing_of_ours_stays(
    domain_id: int, ros_environment: dict[str, str], observer: Observer, tmp_path: Path
) -> None:
    begun_here: list[int] = []

    def seconds(number: int) -> float:
        """From the death of the client to the last command that moved the robot."""
        topic = f"/contained_{len(begun_here)}_{number}"
        engine = SurvivingEngine(tmp_path / f"{len(begun_here)}_{number}", ("env",))
        way = (str(engine.program), "exec", "-i", "ros")
        start = bootstrap(way, Search(python=OWN_PYTHON, domain_id=domain_id), options=["--orphan-s", str(ORPHAN_S)])
        observer.watch(topic)
        try:
            with begun(start, bare(ros_environment)) as client_of_engine:
                bridge = Client(client_of_engine, start.arrival.feed)
                pid = bridge.hello["pid"]
                begun_here.append(pid)
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

    took_s = [undisturbed(lambda number=number: seconds(number)) for number in range(ROUNDS)]
    print(f"dead client of an engine: {sorted(round(each, 3) for each in took_s)}", flush=True)
    assert max(took_s) <= LEASE_S + 0.3
