"""A tree of which a publisher is silent is not called healthy."""

from __future__ import annotations

import subprocess
from collections.abc import Callable

import pytest

from support.agent import agent_for, until

pytestmark = pytest.mark.full


def test_a_publisher_that_tells_nothing_is_a_problem_of_the_tree(
    tf_peer: subprocess.Popen[str], ros_environment: dict[str, str], tell: Callable[..., None]
) -> None:
    with agent_for(ros_environment, "--tools", "all") as agent:
        tell("map", "odom", node="amcl", hz=0.001)
        until(lambda: "/amcl publishes on /tf and has sent nothing" in agent.refusal("ros2_tf_tree", picture=False))
        tell("odom", "base_link", node="base")

        def told() -> bool:
            tree = agent.call("ros2_tf_tree", picture=False)
            return any("/amcl publishes on /tf and has sent nothing" in line for line in tree["problems"])

        until(told)
