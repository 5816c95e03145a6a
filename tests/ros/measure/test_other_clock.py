"""A robot whose clock is an hour ahead of the server's, or behind it, is measured and read as any other."""

from __future__ import annotations

import subprocess
import time
from collections.abc import Iterator
from datetime import datetime
from pathlib import Path
from typing import Any

import pytest

from support.agent import CALL_S, FULL, Agent, agent_for, until
from support.processes import peer_command, running
from support.standstill import undisturbed

BEGUN_S = time.time()
HOUR_S = 3600.0
EXACT_S = 1.0
"""Beside an hour. The way to a bridge on this machine takes milliseconds, and on a busy one tenths of a second."""


@pytest.fixture(scope="module", params=[HOUR_S, -HOUR_S], ids=["behind", "ahead"])
def abroad(
    request: pytest.FixtureRequest,
    ros_environment: dict[str, str],
    robot: subprocess.Popen[str],
    tmp_path_factory: pytest.TempPathFactory,
) -> Iterator[tuple[Agent, float]]:
    """A client of a server to which the robot's clock is wrong; and by how much it is ahead there, in s."""
    command = peer_command("other_clock_server", str(request.param))
    recordings = str(tmp_path_factory.mktemp("recordings"))
    with agent_for(ros_environment, "--tools", "all", "--record-dir", recordings, command=command) as agent:
        yield agent.knows("/scan", "/odom", "/map", "/imu", "/diagnostics"), -request.param


def test_the_status_tells_how_far_the_clocks_are_apart(abroad: tuple[Agent, float]) -> None:
    agent, ahead_s = abroad
    status = agent.call("ros2_status")
    offset_s = status["clock_offset_s"]
    assert offset_s == pytest.approx(ahead_s, abs=status["link_rtt_s"])  # it is not known better than that
    words = "ahead of" if ahead_s > 0 else "behind"
    said = f"The robot's clock is {abs(offset_s):.1f} s {words} this machine's"
    assert any(said in line for line in status["limitations"]), status["limitations"]
    if FULL:
        assert offset_s == pytest.approx(ahead_s, abs=EXACT_S)
        assert 0 < status["link_rtt_s"] < EXACT_S
        assert "3600.0 s" in said


def measured(agent: Agent) -> tuple[dict[str, Any], dict[str, Any]]:
    """A health check, and the statistics of topics by their names."""
    checking = agent.begin("ros2_health_check", rate_check_duration_sec=2)
    stats = agent.begin("ros2_topic_stats", topic_names=["/scan", "/map"], duration_s=2)
    return checking.result(CALL_S), {topic["topic_name"]: topic for topic in stats.result(CALL_S)["topics"]}


def test_a_healthy_robot_is_healthy_and_its_messages_are_new(abroad: tuple[Agent, float]) -> None:
    """With a wrong clock nothing came, or all was sent before. A busy machine may be late for a while."""
    agent, _ = abroad

    def healthy() -> dict[str, Any] | None:
        health, by_name = measured(agent)
        return by_name if (health["verdict"], health["findings"]) == ("HEALTHY", []) else None

    by_name = until(healthy, CALL_S)
    scan = by_name["/scan"]
    assert scan["count"] and (scan["replayed"], "stopped" in scan["note"]) == (0, False)
    assert abs(scan["age_mean_s"]) < HOUR_S / 2
    assert by_name["/map"]["replayed"] == 1


@pytest.mark.full
def test_a_healthy_robot_is_healthy_and_its_rates_are_right(abroad: tuple[Agent, float]) -> None:
    agent, _ = abroad
    health, by_name = undisturbed(lambda: measured(agent))
    assert (health["verdict"], health["findings"]) == ("HEALTHY", [])
    scan, the_map = by_name["/scan"], by_name["/map"]
    # Wide, as a busy machine publishes late: with a wrong clock nothing came, or all was sent before.
    assert scan["rate_hz"] == pytest.approx(10.0, rel=0.3)
    assert (scan["replayed"], "stopped" in scan["note"]) == (0, False)
    assert abs(scan["age_mean_s"]) < EXACT_S
    assert the_map["replayed"] == 1


def test_the_log_is_read_by_seconds_ago(abroad: tuple[Agent, float], ros_environment: dict[str, str]) -> None:
    agent, _ = abroad
    with running(ros_environment, *peer_command("relay_peer", "complain", "1")):
        until(lambda: agent.call("ros2_log_read", since=HOUR_S / 2, pattern="the arm is stuck")["matched"])
        assert agent.call("ros2_log_read", since="1 min ago", pattern="the arm is stuck")["matched"]
    subscribed_since = datetime.fromisoformat(agent.call("ros2_log_read")["subscribed_since"].replace("Z", "+00:00"))
    assert BEGUN_S - HOUR_S / 2 < subscribed_since.timestamp() < time.time() + HOUR_S / 2


def test_the_end_of_a_recording_that_goes_on_is_the_robots_now(abroad: tuple[Agent, float]) -> None:
    agent, _ = abroad
    begun = agent.call("ros2_record_start", topic_names=["/odom"])
    try:
        started = datetime.fromisoformat(begun["started_at"].replace("Z", "+00:00"))
        assert BEGUN_S - HOUR_S / 2 < started.timestamp() < time.time() + HOUR_S / 2
        bag = Path(begun["path"]).name

        def last() -> list[Any]:
            asked = {"bag": bag, "start": "last 2 s", "topic_names": ["/odom"]}
            return [topic for topic in agent.call("ros2_topic_statistics", **asked)["topics"] if topic["count"]]

        assert until(last)
    finally:
        agent.call("ros2_record_stop")
