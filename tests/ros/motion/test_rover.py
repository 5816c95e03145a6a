"""ros2_drive with nothing but a distance, on the simulated rover in its room: it touches nothing."""

from __future__ import annotations

import random
import subprocess
from collections.abc import Iterator

import pytest

from support.agent import FULL, Agent, agent_for

ROUNDS = 50 if FULL else 1
RADIUS_M, NOISE_M = 0.2, 0.03
"""Of the rover, whose scanner sits in its middle; the second is three times what its scan is wrong by."""

pytestmark = pytest.mark.timeout(1800 if FULL else 120)


@pytest.fixture(scope="module")
def rover(demo_environment: dict[str, str], demo_robot: subprocess.Popen[str]) -> Iterator[Agent]:
    with agent_for(demo_environment, "--tools", "all") as client:
        client.knows("/cmd_vel", "/odom", "/scan", "/robot_description", "/tf")
        yield client


def test_it_drives_towards_walls_with_default_arguments_and_touches_none(rover: Agent) -> None:
    rng = random.Random(34)
    recording = rover.call("ros2_record_start", topics=["/scan"])
    outcomes: list[str] = []
    for _ in range(ROUNDS):
        turned = rover.call("ros2_drive", angle_deg=rng.uniform(-180, 180), speed=60)
        driven = rover.call("ros2_drive", distance_m=10 * rng.choice([-1, 1]), speed=rng.uniform(0.2, 0.5))
        outcomes += [turned["outcome"], driven["outcome"]]
        assert driven["outcome"] == "guard", driven
        assert driven["free_m"] > 0.0
    bag = rover.call("ros2_record_stop", recording_id=recording["recording_id"])["bag"]
    near = {"topic_name": "/scan", "condition": f"min(ranges) < {RADIUS_M + NOISE_M}", "bag": bag}
    touched = rover.call("ros2_wait_until", **near)  # by the scanner, and not by what drove
    print(f"{ROUNDS} rounds: {outcomes.count('reached')} turns reached their angle, {touched}")
    assert not touched["met"]
