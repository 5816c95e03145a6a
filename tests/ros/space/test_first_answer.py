"""The first `ros2_robot` of a new server has what comes seldom, or says that it was not heard."""

from __future__ import annotations

import re
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from typing import Any

import pytest

pytest.importorskip("rclpy", reason="needs the ROS 2 wheels, or a sourced ROS 2")
pytest.importorskip("rosidl_generator_py", reason="needs the interface generators of the ROS 2 wheels")

from ros2_mcp.ops.space.first_heard import FIRST_S, YOUNG_S
from support.agent import Agent, agent_for, until
from support.faulty_peer import FaultyPeer

SELDOM_HZ = 0.4
"""Every 2.5 s: an answer that listens for 1.4 s, as later ones do, misses most of them."""
NEVER_HZ = 0.001
KINDS = {"/diagnostics": "diagnostic_msgs/msg/DiagnosticArray", "/odom": "nav_msgs/msg/Odometry"}
WAITED = re.compile(r"\(no message in ([\d.]+) s")


@contextmanager
def publishing(environment: dict[str, str], topic: str, kind: str, rate_hz: float) -> Iterator[None]:
    """A node that publishes empty messages."""
    peer = FaultyPeer(environment, ("repeat", topic, kind, str(rate_hz)))
    try:
        yield
    finally:
        peer.process.terminate()
        peer.end()


@pytest.fixture
def seldom(ros_environment: dict[str, str], tell: Any) -> Iterator[None]:
    """A robot that tells its frames, its odometry and its diagnostics every 2.5 s."""
    with ExitStack() as stack:
        for topic, kind in KINDS.items():
            stack.enter_context(publishing(ros_environment, topic, kind, SELDOM_HZ))
        tell("odom", "base_link", hz=SELDOM_HZ)
        with agent_for(ros_environment) as looking:  # until everything is there
            looking.knows(*KINDS, "/tf")
        yield
        tell("odom", "base_link", hz=0)


def waited_s(agent: Agent) -> dict[str, float]:
    """Of each topic that was not heard, how long it was listened to, in s."""
    told = agent.call("ros2_robot").get("not_read", ())
    return {one.split(" ")[0]: float(found[1]) for one in told if (found := WAITED.search(one))}


def test_the_first_answer_of_a_server_waits_for_what_comes_seldom(
    ros_environment: dict[str, str], seldom: None
) -> None:
    def first() -> dict[str, Any] | None:
        """The first answer of another server that has it all; one without has waited as long as it should."""
        with agent_for(ros_environment) as agent:
            found = agent.call("ros2_robot")
        waited = [float(one[1]) for one in map(WAITED.search, found.get("not_read", ())) if one]
        assert all(seconds >= FIRST_S for seconds in waited), found
        return None if "not_read" in found else found

    found = until(first, 45.0)
    assert "In odom at" in found["place"], found
    assert found["frames"].startswith("odom → base_link"), found


def test_what_is_silent_is_named_and_waited_for_by_a_young_bridge_alone(ros_environment: dict[str, str]) -> None:
    with ExitStack() as stack:
        for topic, kind in KINDS.items():
            stack.enter_context(publishing(ros_environment, topic, kind, NEVER_HZ))
        with agent_for(ros_environment) as looking:
            looking.knows(*KINDS)
        agent = stack.enter_context(agent_for(ros_environment))
        first = waited_s(agent)
        assert first.keys() >= KINDS.keys(), first  # the node of the frames may still publish none
        assert min(first.values()) >= FIRST_S
        until(lambda: max(waited_s(agent).values()) < FIRST_S, 4 * YOUNG_S)
