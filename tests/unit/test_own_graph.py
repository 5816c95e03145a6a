"""The graph of a simulated robot is its own."""

from __future__ import annotations

import socket
import subprocess
import sys
from contextlib import suppress

import pytest

from ros2_mcp.commands.simulation import Graph, reach_of_this_machine

CHOOSE = """import sys
from ros2_mcp.commands.simulation import Graph
print(Graph.private().domain_id, flush=True)
sys.stdin.read()"""


@pytest.mark.promise("README", "It uses a ROS domain of its own")
def test_a_domain_in_which_somebody_on_this_machine_is_is_not_chosen() -> None:
    chosen = Graph.private().domain_id
    assert 1 <= chosen <= 100
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as participant:
        with suppress(OSError):  # who has the port is in the domain, too
            participant.bind(("127.0.0.1", 7400 + 250 * (chosen - 1) + 11))
        assert Graph.private().domain_id < chosen - 1


def test_those_who_choose_at_the_same_time_choose_different_domains() -> None:
    command = [sys.executable, "-c", CHOOSE]
    several = [
        subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, close_fds=True)
        for _ in range(4)
    ]
    try:
        chosen = [(one.stdout.readline() if one.stdout else "").strip() for one in several]
        assert all(chosen) and len(set(chosen)) == len(several), chosen
    finally:
        for one in several:
            one.communicate()
    assert [one.returncode for one in several] == [0] * len(several)


@pytest.mark.promise("README", "on this machine only")
@pytest.mark.parametrize(
    ("distro", "env", "reach"),
    [
        ("jazzy", {}, {"ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST"}),
        ("humble", {}, {"ROS_LOCALHOST_ONLY": "1"}),
        ("jazzy", {"ROS_AUTOMATIC_DISCOVERY_RANGE": "SUBNET"}, {}),
        ("humble", {"ROS_LOCALHOST_ONLY": "0"}, {}),
    ],
)
def test_it_stays_on_this_machine_unless_the_environment_says_how_far_it_goes(
    distro: str, env: dict[str, str], reach: dict[str, str]
) -> None:
    assert reach_of_this_machine(distro, env) == reach
