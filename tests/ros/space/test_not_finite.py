"""A robot whose map, frames, odometry, scans, footprint and battery tell what is not finite: each tool says so."""

from __future__ import annotations

import re
import subprocess
from collections.abc import Iterator

import pytest

from support.agent import Agent, agent_for, until
from support.processes import peer_command, running

SPOKEN = re.compile(r"\b[+-]?(nan|inf)\b|fault of this server")
QUOTED = re.compile(r'"(?:\\.|[^"\\])*"|«[^»]*»')


@pytest.fixture(scope="module")
def agent(demo_environment: dict[str, str]) -> Iterator[Agent]:
    with agent_for(demo_environment, "--tools", "all") as client:
        yield client


@pytest.fixture(scope="module", autouse=True)
def odd(demo_environment: dict[str, str], agent: Agent) -> Iterator[subprocess.Popen[str]]:
    with running(demo_environment, *peer_command("odd_numbers_peer")) as process:
        agent.knows("/odom", "/tf", "/scan_step", "/map", "/local_costmap/published_footprint")
        until(lambda: "translation.x is NaN" in told(agent, "ros2_tf_tree", picture=False, duration=0.5))
        yield process


def told(agent: Agent, tool: str, **arguments: object) -> str:
    return agent.whole(tool, dict(arguments)).content[0].text  # type: ignore[union-attr]


def spoken(agent: Agent, tool: str, **arguments: object) -> str:
    """The answer of a tool, in which no number stands as Python writes it."""
    said = told(agent, tool, **arguments)
    assert not SPOKEN.search(QUOTED.sub("", said)), said
    return said


def says(agent: Agent, tool: str, *words: str, **arguments: object) -> None:
    """That an answer of the tool has all these words; on a busy machine a part may come too late for the first."""
    until(lambda: all(each in said for said in [spoken(agent, tool, **arguments)] for each in words))


def test_the_robot_the_scene_and_the_frames_name_what_is_not_finite(agent: Agent) -> None:
    says(
        agent,
        "ros2_robot",
        "pose is unknown: in /odom, pose.pose.position.x is NaN",
        "/scan_step has no bearings: angle_increment is 0",
        "published_footprint is not a valid footprint: polygon.points[0].x is NaN",
        whole=True,
    )
    says(agent, "ros2_scene", "The grid /map is not shown", "info.origin.position.x is NaN")
    assert "base_link → laser is refused: its rotation.z is NaN" in spoken(agent, "ros2_tf_tree", picture=False)
    assert "translation.x is NaN" in spoken(agent, "ros2_tf_lookup", target="map", source="odom")


def test_a_health_check_names_every_source_of_such_numbers(agent: Agent) -> None:
    named = (
        "/odom",
        "/imu",
        "/goal_pose",
        "published_footprint is not a valid footprint",
        "/scan_step has no bearings",
    )
    says(agent, "ros2_health_check", *named)


def test_a_drive_by_such_odometry_or_such_a_scan_moves_nothing_and_says_why(agent: Agent) -> None:
    by_odometry = agent.call("ros2_drive", distance_m=0.3, guard_m=0)
    assert (by_odometry["outcome"], by_odometry["measured"]) == ("silent", None)
    assert "messages came from /odom, but none that can be used (pose.pose.position.x is NaN)" in by_odometry["note"]
    said = agent.refusal("ros2_drive", distance_m=0.3, scan="/scan_step")
    assert "/scan_step has no bearings, so it cannot be used to detect obstacles: angle_increment is 0" in said


def test_a_motion_until_a_condition_of_such_a_scan_holds_is_not_met_and_says_why(agent: Agent) -> None:
    asked = {"topic_name": "/scan_angle", "condition": "nearest(-30, 30) < 0.4", "timeout": 0.6}
    says(agent, "ros2_wait_until", "was not met", "no bearings: angle_min is NaN", **asked)


def test_a_program_gets_no_bearings_of_such_a_scan(agent: Agent) -> None:
    said = spoken(agent, "ros2_program_run", program="import robot\nprint(robot.scan('/scan_step'))")
    assert "no bearings: angle_increment is 0" in said
