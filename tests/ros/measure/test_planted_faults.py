"""Every kind of fault planted in one robot of real nodes: all are named, and nothing while it is well."""

from __future__ import annotations

import subprocess
from collections.abc import Iterator
from typing import Any

import pytest

from support.agent import Agent, until
from support.processes import peer_command, running


@pytest.fixture(scope="module")
def planted(ros_environment: dict[str, str], agent: Agent) -> Iterator[subprocess.Popen[str]]:
    """The robot of `planted_robot`, discovered."""
    with running(ros_environment, *peer_command("planted_robot"), sigterm=False) as process:
        agent.knows("/scan", "/odom", "/pressure", "/joint_states", "/diagnostics")
        yield process


@pytest.fixture(scope="module")
def well(agent: Agent, planted: subprocess.Popen[str]) -> dict[str, Any]:
    """The first check that finds nothing, while it is well: a robot on a busy machine is late for a while."""
    last: list[dict[str, Any]] = []

    def found() -> dict[str, Any] | None:
        last.append(agent.call("ros2_health_check"))
        has_all = last[-1]["other_topics"].get("/map_name", "").startswith("OK")  # which comes late as well
        return last[-1] if last[-1]["verdict"] == "HEALTHY" and has_all else None

    try:
        return until(found, 60.0)
    except AssertionError as error:
        raise AssertionError(last[-1]["findings"]) from error


@pytest.fixture(scope="module")
def faults(
    agent: Agent, planted: subprocess.Popen[str], well: dict[str, Any], ros_environment: dict[str, str]
) -> dict[str, str]:
    """What is said of each subject once the faults are there and were discovered."""
    assert planted.stdin
    planted.stdin.write("plant\n")
    planted.stdin.flush()
    agent.knows("/gripper/joint_states", "/chatter", "/chatter_remapped", "/robot_description")

    def found() -> dict[str, str] | None:
        rows = agent.call("ros2_health_check")["findings"]
        said = {row["subject"]: row["problem"] for row in rows}
        return said if said.keys() == EXPECTED.keys() else last.append(said)  # what is late for a while is named, too

    last: list[dict[str, str]] = []
    with running(ros_environment, *peer_command("planted_robot", "rival"), sigterm=False):
        try:
            return until(found, 60.0)
        except AssertionError as error:
            raise AssertionError(last[-1]) from error


EXPECTED = {
    "/home": "/driver_a, /driver_b offer the service",
    "/tare": "One service with 2 types",
    "/odom": "NaN or infinite",
    "/joint_states": "contradict each other: elbow",
    "/by_another_clock": "use_sim_time is true",
    "/driver_never_configured": "unconfigured",
    "/tuned": "share is 1.5, outside 0 to 1",
    "/chatter_remapped": "/chatter, which has no subscriber",
    "/robot_description": "/waits_for_description subscribes to /robot_description, which has no publisher",
    "hardware: parts": "«ArmHW» is «unconfigured»",
    "/pressure": "/lidar publishes it, but no message came",
}


def test_nothing_is_found_while_it_is_well_and_what_is_latched_tells_its_age(well: dict[str, Any]) -> None:
    assert well["findings"] == []
    assert (
        well["other_topics"]["/map_name"].startswith("OK, 1 message, ")
        and "from before" in well["other_topics"]["/map_name"]
    )


@pytest.mark.parametrize("subject", EXPECTED)
def test_each_fault_is_named(faults: dict[str, str], subject: str) -> None:
    assert EXPECTED[subject] in faults[subject]


def test_two_servers_of_an_action_are_named_with_their_services(faults: dict[str, str]) -> None:
    assert "the action /dock" in faults["/home"]


def test_no_other_fault_is_named(faults: dict[str, str]) -> None:
    others = faults.keys() - EXPECTED.keys()
    assert not others, {subject: faults[subject] for subject in others}
