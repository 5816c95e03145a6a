"""Clouds that come live, as numbers in programs: a small one, and one that is too large to be given whole."""

from __future__ import annotations

from typing import Any

import pytest

pytest.importorskip("rclpy", reason="needs the ROS 2 wheels, or a sourced ROS 2")
pytest.importorskip("pydantic_monty", reason="needs the extra `programs`")

from ros2_mcp.programs.arrays import USUAL_POINTS
from ros2_mcp.programs.streams import MOST_BYTES
from support.agent import Agent
from support.processes import peer_command, running

RED, RED_POINTS, NEAREST_RED_M = 0xFF2020, 3 * 72, 1.75
"""Of the ball of `cloud_peer`: rings of 5, 15 and 25 cm about x = 2 m."""
LARGE = 400**2
"""Points of 20 bytes each: 3.2 MB, more than a program is given whole."""


def ran(agent: Agent, text: str) -> dict[str, Any]:
    found = agent.call("ros2_program_run", program=f"import robot\n{text}", timeout_s=60)
    assert found["outcome"] == "ended", found
    return found


def test_of_a_live_cloud_points_are_found_by_their_colour(agent: Agent, ros_environment: dict[str, str]) -> None:
    with running(ros_environment, *peer_command("cloud_peer")):
        agent.knows("/cloud")
        text = (
            f"p = [p for p in robot.points(robot.latest('/cloud'), fields=['rgb']) if p[3] == {RED}]\n"
            "[len(p), robot.min([one[0] for one in p])]"
        )
        count, nearest = ran(agent, text)["returned"]["value"]
        assert (count, nearest) == (RED_POINTS, pytest.approx(NEAREST_RED_M))


def test_a_large_live_cloud_is_read_message_by_message(agent: Agent, ros_environment: dict[str, str]) -> None:
    assert LARGE * 20 > MOST_BYTES
    with running(ros_environment, *peer_command("cloud_peer", "laser", str(LARGE))):
        agent.knows("/cloud")
        text = (
            "found = []\n"
            "for m in robot.messages('/cloud', message_limit=2):\n"
            "    p = robot.points(m)\n"
            "    found.append([len(p), p[0][0], robot.unpack('<f', m['data'])[0], m['data']['length']])\n"
            "found"
        )
        result = ran(agent, text)
        for count, first_x, same_x, length in result["returned"]["value"]:
            assert USUAL_POINTS / 2 < count <= USUAL_POINTS
            assert first_x == same_x
            assert length == LARGE * 20
        # The first point of every second message is elsewhere, so that each message has been read.
        assert {first_x for _, first_x, _, _ in result["returned"]["value"]} == {-10.0, -14.0}
        assert f"of {LARGE} points" in result["note"]
