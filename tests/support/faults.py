"""Faults of the simulated robot, each for the time of a block."""

from __future__ import annotations

import subprocess
from collections.abc import Iterator
from contextlib import contextmanager, nullcontext
from typing import Any

from support.agent import until
from support.processes import peer_command
from support.prompting import PromptAgent


@contextmanager
def _parameter(agent: PromptAgent, node: str, name: str, broken: Any, sound: Any) -> Iterator[None]:
    agent.agent.call("ros2_parameter_set", node_name=node, values={name: broken})
    yield
    agent.agent.call("ros2_parameter_set", node_name=node, values={name: sound})


@contextmanager
def _deaf_subscriber(agent: PromptAgent, environment: dict[str, str]) -> Iterator[None]:
    with subprocess.Popen(peer_command("deaf_subscriber"), stdout=subprocess.PIPE, env=environment) as peer:
        assert peer.stdout
        assert peer.stdout.readline()
        until(lambda: agent.agent.call("ros2_topic_info", topic_name="/imu")["mismatches"])
        yield
        peer.kill()


FAULTS = {
    "none": lambda _, __: nullcontext(),
    "dead": lambda agent, _: _parameter(agent, "/imu_driver", "enabled", False, True),
    "slow": lambda agent, _: _parameter(agent, "/lidar", "rate", 0.5, 10.0),
    "qos": _deaf_subscriber,
}
