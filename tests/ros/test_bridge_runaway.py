"""A robot that runs away is noticed in time, and one that would leave its zone stops before: over real DDS, by a robot
with physics of its own. That it happens here; how soon, in 20 rounds, in full.
"""

from __future__ import annotations

import json
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from statistics import median

import pytest

from ros2_mcp_common.policy.rules import Rules, RuleSet
from support.agent import until
from support.bridge_client import PATIENCE_S, RELIABLE, Client
from support.commanded import CommandedProcess
from support.standstill import STOOD_STILL_S, TIMES, undisturbed
from support.velocities import TWIST, cdr

ROUNDS = 20
SPEED_MPS, BRAKE_MPS2 = 0.5, 1.0
WITHIN_S, MAX_AGE_S = 0.5, 0.5
NOTICED_S = 0.3
"""The bar: from when it could be known to the latch."""
EDGE_M = 2.0
HEARD_AFTER_S = 4.5
"""From the first command on: by then the watchdog has heard one that it discovered late (`feedback.FIRST_S`)."""
OVERSHOOT_M = SPEED_MPS**2 / (2 * BRAKE_MPS2) + SPEED_MPS * 0.2
"""The bar, from the edge of the zone on."""


@pytest.fixture(scope="module")
def robot(ros_environment: dict[str, str]) -> Iterator[CommandedProcess]:
    process = CommandedProcess("runaway_robot", ros_environment)
    yield process
    process.kill()


class Runs:
    """Bridges that drive the robot, each under a watchdog and with a latch of its own."""

    def __init__(self, robot: CommandedProcess, start: Callable, folder: Path) -> None:
        self.robot, self._start, self._folder, self._number = robot, start, folder, 0

    def run(self, fault: str, *, x: float = 0.0, ends: bool = False) -> tuple[dict[str, float], float, str]:
        """As `_run`; again, a few times at most, where the robot's own process was held up and told nothing."""
        for _ in range(TIMES):
            run = self._run(fault, x=x, ends=ends)
            if run[0]["stood_s"] < STOOD_STILL_S:
                break
        return run

    def _run(self, fault: str, *, x: float = 0.0, ends: bool = False) -> tuple[dict[str, float], float, str]:
        """Drives the robot until it is latched: its state once it stands, when it was latched, and why.

        `ends`: the command is ended with its zero, once the robot was heard for sure.
        """
        self._number += 1
        base, state = f"/{self._folder.name}_{self._number}", self._folder / str(self._number)
        state.mkdir()
        bridge = Client(self._start("ros2_mcp_bridge", "--state", str(state)))
        self.robot.put(base=base, fault=fault, x=x)
        bridge.ok("policy", json.dumps({**RULES, "watch": _watch(base)}).encode())
        topic = f"{base}/cmd_vel"
        bridge.ok("wait_endpoints", topic=topic, publishers=0, subscribers=1, timeout_s=PATIENCE_S)
        until(self.robot.listeners)  # what ends is what was heard before
        bridge.send("failsafe_publish", topic=topic, type=TWIST, qos=RELIABLE)
        given = {"topic": topic, "type": TWIST, "qos": RELIABLE, "epoch": 0, "wait_match_s": PATIENCE_S}
        driving = bridge.send("repeat", cdr(TWIST, SPEED_MPS), rate_hz=50, duration_s=60, **given)
        if ends:
            until(lambda: 0.0 < self.robot.state()["full_at"] < time.monotonic() - HEARD_AFTER_S)
            bridge.send("cancel", request=driving)
        while (told := bridge.next_packet()[0]).get("event") != "latched":
            pass
        latched_at, reason = time.monotonic(), told["reason"]
        found = until(lambda: (now := self.robot.state())["speed"] in (0.0, *([SPEED_MPS] * ends)) and now)
        bridge.close()
        return found, latched_at, reason


RULES = Rules("digest", (RuleSet("test", allows_all=True),)).as_json()


def _watch(base: str) -> dict[str, object]:
    zone = {"frame_id": "map", "polygon": [[-50, -50], [EDGE_M, -50], [EDGE_M, 50], [-50, 50]], "margin_m": 0.0}
    speed = {"topic": f"{base}/odom", "type": "geometry_msgs/msg/TwistStamped", "path": "twist"}
    speed |= {"still": {"linear": 0.03}, "most": {"linear": 1.0}, "within_s": WITHIN_S, "over": 1.2}
    place = {"topic": f"{base}/pose", "type": "geometry_msgs/msg/PoseStamped", "path": "pose", "frame_id": "map"}
    place |= {"brake_mps2": BRAKE_MPS2, "max_age_s": 1.0, "zone": zone}
    return {"feedback": {**speed, "max_age_s": MAX_AGE_S}, "pose": place}


@pytest.fixture
def runs(robot: CommandedProcess, start: Callable, tmp_path: Path) -> Runs:
    return Runs(robot, start, tmp_path)


FAULTS = {
    "ignores": "still moves",
    "silent": "told nothing",
    "nan": "told nothing",
    "too much": "faster than the policy",
}
KNOWN_AFTER_S = {"ignores": WITHIN_S, "silent": MAX_AGE_S, "nan": MAX_AGE_S, "too much": 0.0}


def test_a_runaway_that_ignores_its_zero_is_noticed(runs: Runs) -> None:
    noticed_after_s(runs, "ignores")


@pytest.mark.full
@pytest.mark.parametrize("fault", FAULTS)
@pytest.mark.timeout(1200)
def test_a_runaway_is_noticed_in_time(runs: Runs, fault: str) -> None:
    late = [undisturbed(lambda: noticed_after_s(runs, fault)) - KNOWN_AFTER_S[fault] for _ in range(ROUNDS)]
    print(f"{fault}: noticed {median(late):.3f} s, at most {max(late):.3f} s after it could be, {ROUNDS} rounds")
    assert max(late) <= NOTICED_S


def noticed_after_s(runs: Runs, fault: str) -> float:
    """`ignores`: after its zero; the others (odometry ends, is no number, tells too much): after the fault began."""
    found, latched_at, reason = runs.run(fault, x=-40.0, ends=fault == "ignores")
    assert FAULTS[fault] in reason and (fault == "ignores" or found["fault_at"]), reason
    return latched_at - found["zero_at" if fault == "ignores" else "fault_at"]


def test_a_robot_that_leaves_its_zone_is_stopped_and_not_before(runs: Runs) -> None:
    assert beyond_the_edge_m(runs) > -0.3, "it is not stopped for nothing"


@pytest.mark.full
@pytest.mark.timeout(1200)
def test_a_robot_stops_before_it_has_left_its_zone_by_more_than_its_way_to_brake(runs: Runs) -> None:
    over = [undisturbed(lambda: beyond_the_edge_m(runs)) for _ in range(ROUNDS)]
    print(f"zone at {SPEED_MPS} m/s: {median(over):.3f} m, at most {max(over):.3f} m over the edge, {ROUNDS} rounds")
    assert max(over) <= OVERSHOOT_M
    assert min(over) > -0.3, "it is not stopped for nothing"


def beyond_the_edge_m(runs: Runs) -> float:
    """How far over the edge of its zone a robot comes to stand that was driven out of it."""
    found, _, reason = runs.run("", x=EDGE_M - SPEED_MPS * HEARD_AFTER_S)
    assert "outside of its zone" in reason
    return found["farthest"] - EDGE_M
