"""The health of the simulated robot: healthy, with a dead sensor, a slow one, a mismatched QoS, a missing topic."""

from __future__ import annotations

import subprocess
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from typing import Any

import pytest

from support.agent import CALL_S, Agent, until
from support.standstill import undisturbed


@contextmanager
def setting(agent: Agent, name: str, value: object, usual: object) -> Iterator[None]:
    node, _, parameter = name.partition(".")
    agent.call("ros2_parameter_set", node_name=node, values={parameter: value})
    try:
        yield
    finally:
        agent.call("ros2_parameter_set", node_name=node, values={parameter: usual})


def subjects(found: dict[str, Any]) -> list[str]:
    return [finding["subject"] for finding in found["findings"]]


def state(found: dict[str, Any], topic: str) -> str:
    rows = {row["topic_name"]: row["state"] for row in found["topics"]}
    return rows[topic] if topic in rows else found["other_topics"][topic].partition(",")[0]


LISTEN = {"rate_check_duration_sec": 2}
"""Components speak of themselves every second."""


HEALTHY = {
    "expected_topics": ["/scan", "/odom", "/map"],
    "expected_nodes": ["/lidar"],
    "expected_services": ["/self_test"],
    **LISTEN,
}


def as_soon_as(
    agent: Agent, verdict: str, subject: str = "", of: str = "", is_state: str = "", **arguments: Any
) -> dict[str, Any]:
    """The first check with that verdict, that one finding, and that state of a topic: a robot on a busy machine is late
    for a while.
    """

    def found() -> dict[str, Any] | None:
        last.append(agent.call("ros2_health_check", **arguments))
        is_found = (last[-1]["verdict"], subjects(last[-1])) == (verdict, [subject] if subject else [])
        return last[-1] if is_found and (not of or state(last[-1], of) == is_state) else None

    last: list[dict[str, Any]] = []
    with suppress(AssertionError):
        return until(found, CALL_S)
    raise AssertionError(last[-1])


@pytest.mark.promise("ros2_health_check", "The verdict is HEALTHY, DEGRADED or CRITICAL")
def test_a_healthy_robot_is_healthy(agent: Agent, robot: subprocess.Popen[str]) -> None:
    found = as_soon_as(agent, "HEALTHY", **HEALTHY)
    assert state(found, "/scan") == "OK"
    assert found["diagnostics"]


@pytest.mark.full
def test_a_healthy_robot_is_healthy_at_the_first_look(agent: Agent, robot: subprocess.Popen[str]) -> None:
    found = undisturbed(lambda: agent.call("ros2_health_check", **HEALTHY))
    assert (found["verdict"], found["findings"]) == ("HEALTHY", [])


@pytest.mark.promise("ros2_health_check", "silent or slow sensors")
def test_a_dead_sensor_is_found(agent: Agent, robot: subprocess.Popen[str]) -> None:
    with setting(agent, "lidar.enabled", False, True):
        # what it says of itself, and its topic: one fault
        found = as_soon_as(agent, "CRITICAL", "/lidar", **LISTEN)
    assert "lidar: status" in found["findings"][0]["problem"] and "/scan" in found["findings"][0]["problem"]
    assert state(found, "/scan") == "SILENT"


@pytest.mark.promise("ros2_health_check", "silent or slow sensors")
def test_a_slow_sensor_is_found(agent: Agent, robot: subprocess.Popen[str]) -> None:
    with setting(agent, "lidar.rate", 0.5, 10.0):
        as_soon_as(agent, "DEGRADED", "/scan", of="/scan", is_state="SLOW")  # silent at first, where it began late


@pytest.mark.full
@pytest.mark.parametrize(
    ("name", "value", "usual", "listen", "said"),
    [
        ("lidar.enabled", False, True, LISTEN, ("CRITICAL", ["/lidar"], "SILENT")),
        ("lidar.rate", 0.5, 10.0, {}, ("DEGRADED", ["/scan"], "SLOW")),
    ],
)
def test_a_sensor_that_is_dead_or_slow_is_found_at_the_first_look(
    agent: Agent,
    robot: subprocess.Popen[str],
    name: str,
    value: object,
    usual: object,
    listen: dict[str, float],
    said: tuple[Any, ...],
) -> None:
    with setting(agent, name, value, usual):
        found = undisturbed(lambda: agent.call("ros2_health_check", **listen))
    assert (found["verdict"], subjects(found), state(found, "/scan")) == said


@pytest.mark.promise("ros2_health_check", "QoS mismatches")
@pytest.mark.promise("ros2_topic_info", "why pairs do not match")
def test_a_mismatch_of_qos_is_found(
    agent: Agent, robot: subprocess.Popen[str], stranger: subprocess.Popen[str]
) -> None:
    until(lambda: "/stranger" in str(agent.call("ros2_topic_info", topic_name="/scan")["subscribers"]))
    found = as_soon_as(agent, "DEGRADED", "/scan", check_rates=False, **LISTEN)
    assert "/lidar → /stranger: the publisher offers best_effort" in found["findings"][0]["problem"]


@pytest.mark.promise("ros2_health_check", "missing names")
@pytest.mark.promise(
    "ros2_health_check", "The verdict is HEALTHY, DEGRADED or CRITICAL, with findings and recommendations"
)
def test_what_is_missing_is_critical_with_the_nearest_name(agent: Agent, robot: subprocess.Popen[str]) -> None:
    found = agent.call("ros2_health_check", expected_topics=["/scann"], check_rates=False, **LISTEN)
    assert (found["verdict"], found["findings"][0]["recommendation"]) == ("CRITICAL", "Did you mean /scan?")


@pytest.mark.promise("ros2_wait_until", "returns the one that met it")
def test_a_condition_on_the_moving_robot_is_met(agent: Agent, robot: subprocess.Popen[str]) -> None:
    waiting = agent.begin(
        "ros2_wait_until",
        topic_name="/odom",
        condition="hypot(pose.pose.position.x, pose.pose.position.y) > 0.1",
        timeout=50,
    )
    command = {"linear": {"x": 0.3}}
    driving = agent.begin("ros2_topic_publish", topic_name="/cmd_vel", data=command, frequency=10, duration=30)
    found = waiting.result(CALL_S)
    driving.cancel()
    assert found["met"] and found["values"]["pose.pose.position.x"] > 0


def test_an_element_of_a_list_is_waited_for_by_its_name(agent: Agent, robot: subprocess.Popen[str]) -> None:
    dead = 'max(status[*].level) == 2 and any(status, name == "lidar: status" and level == ERROR)'
    with setting(agent, "lidar.enabled", False, True):
        found = agent.call("ros2_wait_until", topic_name="/diagnostics", condition=dead, timeout=50)
    assert found["met"] and "lidar: status" in found["values"]["status[*].name"]
