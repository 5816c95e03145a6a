"""ros2_drive with nothing but a distance, on the simulated rover in its room: it touches nothing."""

from __future__ import annotations

import random
import subprocess
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import pytest

from support.agent import FULL, Agent, agent_for
from support.standstill import STOOD_STILL_S, TIMES, standstills

ROUNDS = 50
RADIUS_M, NOISE_M = 0.2, 0.03
"""Of the rover, whose scanner sits in its middle; the second is three times what its scan is wrong by."""

pytestmark = pytest.mark.timeout(3600 if FULL else 120)


@pytest.fixture(scope="module")
def rover(demo_environment: dict[str, str], demo_robot: subprocess.Popen[str]) -> Iterator[Agent]:
    with agent_for(demo_environment, "--tools", "all") as client:
        yield client.knows("/cmd_vel", "/odom", "/scan", "/robot_description", "/tf")


@contextmanager
def untouched(rover: Agent) -> Iterator[None]:
    """What is driven in here comes nowhere near anything: by the scanner, and not by what drove."""
    recording = rover.call("ros2_record_start", topic_names=["/scan"])
    yield
    bag = rover.call("ros2_record_stop", recording_id=recording["recording_id"])["bag"]
    near = {"topic_name": "/scan", "condition": f"min(ranges) < {RADIUS_M + NOISE_M}", "bag": bag}
    touched = rover.call("ros2_wait_until", **near)
    print(touched["summary"])
    assert not touched["met"]


def driven(rover: Agent, rng: random.Random) -> dict[str, Any]:
    """Somewhere else, and then towards a wall that is nearer than the distance."""
    rover.call("ros2_drive", angle_deg=rng.uniform(-180, 180), speed=60)
    distance_m, speed = 10 * rng.choice([-1, 1]), rng.uniform(0.2, 0.5)
    for _ in range(TIMES):  # on where its topics were silent for half a second, as on a busy machine
        result = rover.call("ros2_drive", distance_m=distance_m, speed=speed)
        if result["outcome"] != "silent":
            break
    return result


def test_it_drives_towards_a_wall_with_default_arguments_and_does_not_touch_it(rover: Agent) -> None:
    with untouched(rover):
        result = driven(rover, random.Random(34))
    assert result["outcome"] == "guard", result
    assert result["free_m"] > 0.0


@pytest.mark.full
def test_it_drives_towards_many_walls_and_touches_none(rover: Agent) -> None:
    rng = random.Random(34)
    free_m: list[float] = []
    with untouched(rover):
        for _ in range(ROUNDS):
            for _ in range(TIMES):  # again where this machine held up the robot's process or the bridge
                with standstills(STOOD_STILL_S) as held_up:
                    result = driven(rover, rng)
                if not held_up:
                    break
            assert result["outcome"] == "guard", result
            free_m.append(result["free_m"])
    print(f"{ROUNDS} rounds: {min(free_m):.3f} to {max(free_m):.3f} m free at their ends")
