"""Causes for which robots with Nav2 stand still, planted one at a time in the rover with all of Nav2, beside decoys."""

from __future__ import annotations

import re
from collections.abc import Iterator
from typing import Any

import pytest

from support.agent import Agent, agent_for, until
from support.demo_robot import build_interfaces, robot_environment, running_robot
from support.domains import reserved_domains

CAUSES = {
    "1 stamped against unstamped": "sends Twist, and /base_driver listens for TwistStamped",
    "2 unconnected output": "/cmd_vel_out, which no node subscribes to; /base_controller listens on /cmd_vel",
    "3 rival": "/teleop_node sends zeros on /cmd_vel",
    "4 monitor holds": "its polygon PolygonStop",
    "5 source missing": "its source pointcloud has no publisher",
    "8 clock behind": r"/odom.* 1\.[78]\d s behind the others, always",
    "8 clock ahead": r"/odom.* 0\.[89]\d s ahead of the others",
    "9 wheels silent": "/wheel/odom is silent, so that /ekf_filter_node tells nothing",
    "10 simulated time": "/ekf_filter_node runs on simulated time",
    "11 no odometry transform": "no node publishes the transform from odom to the base",
    "14 frame name": "base_footprint, which no transform has; there is base_link",
    "15 topic in a namespace": "/local_costmap/scan, which has no publisher; the LaserScan is on /scan",
    "17 parameters not applied": "/local_costmap/local_costmap has only default values",
    "18 old plugin name": "/planner_server is unconfigured since it failed to come up; the 6 others only wait",
    "19 never comes": "waits for /route_server, which does not run",
    "20 bond lost": r"down since \d+ s: /bt_navigator missed its heartbeat, and lives; .* took 6 others down",
    "21 acknowledged too late": "/bt_navigator gives up before the servers can answer",
    "23 sees itself": "beams at -180 to -168° of /scan",
    "28 lost": "the scan does not fit the map",
    "30 progress": "progress checker asks for more than the robot may drive",
    "map is volatile": "/map_server publishes /map as volatile",
    "lidar silent": "/scan is silent",
    "motors off": "motors are disabled",
    "paused": "whole stack is paused",
    "13 static and moving": "odom is told twice: as moving by probably /amcl, and as static by .*/map_odom_static",
    "20 server died": "/planner_server died; /lifecycle_manager_navigation took 6 others down",
}
"""Fault → what the first finding says; those that are not healed stand last."""
ALWAYS = ("2 unconnected output", "9 wheels silent", "18 old plugin name", "20 server died")
"""Of each part one; all others with `full`."""
DECOYS = ("decoy: fresh initial pose", "decoy: false rate warning", "decoy: message filter")
NEVER = re.compile(r"docking|rate|Message Filter|deviation|inflation", re.IGNORECASE)


class Planted:
    """The robot's process, told by lines what to plant."""

    def __init__(self, process: Any) -> None:
        self._process = process

    def tell(self, verb: str, fault: str) -> None:
        self._process.stdin.write(f"{verb} {fault}\n")
        self._process.stdin.flush()
        assert self._process.stdout.readline() == f"{verb} {fault}: done\n"


@pytest.fixture(scope="module")
def environment(tmp_path_factory: pytest.TempPathFactory) -> Iterator[dict[str, str]]:
    prefixes = build_interfaces("nav2", later=True)
    state = str(tmp_path_factory.mktemp("nav2"))
    with reserved_domains() as domain_id:
        yield robot_environment(prefixes, ROS_DOMAIN_ID=str(domain_id), XDG_STATE_HOME=state)


@pytest.fixture(scope="module")
def robot(environment: dict[str, str]) -> Iterator[Planted]:
    prefixes = build_interfaces("nav2", later=True)
    domain_id = int(environment["ROS_DOMAIN_ID"])
    with running_robot(prefixes, domain_id, "--robot", "nav2", "--until-stdin-closes") as process:
        yield Planted(process)


@pytest.fixture(scope="module")
def agent(environment: dict[str, str], robot: Planted) -> Iterator[Agent]:
    """A client whose server has found nothing wrong, with the decoys planted."""
    with agent_for(environment, "--tools", "all") as agent:
        agent.knows("/global_costmap/costmap", "/local_costmap/costmap", "/cmd_vel", "/wheel/odom")
        until(lambda: agent.call("ros2_nav_check")["servers"] == "Nav2: 9 of 9 active", 90.0)
        for decoy in DECOYS:
            robot.tell("plant", decoy)
        yield agent


def said(agent: Agent, **arguments: Any) -> list[str]:
    findings = agent.call("ros2_nav_check", **arguments)["findings"]
    return [f"{one['cause']} {one['proof']}" for one in findings]


def test_nothing_is_found_while_it_is_well_beside_decoys_and_the_answer_is_short(agent: Agent) -> None:
    # On a busy machine not all may be read.
    fine = until(lambda: (found := agent.call("ros2_nav_check"))["verdict"] == "FINE" and found, 60.0)
    assert fine["findings"] == []
    told: Any = agent.whole("ros2_nav_check", {}).content[0]
    assert len(told.text.encode()) <= 1500
    assert "Nav2: 9 of 9 active" in str(agent.call("ros2_robot")["stacks"])
    note = agent.call("ros2_nav_check", to={"place": "charger"})["note"]
    assert note.startswith("The goal was not checked") and 'ros2_nav_dock(dock="charger")' in note


def test_a_goal_goes_through_the_whole_chain(agent: Agent) -> None:
    assert agent.call("ros2_navigate", to=[{"x": 0.6, "y": 0.3}], timeout_sec=40)["outcome"] == "reached"


@pytest.mark.parametrize(
    ("faults", "causes"),
    [
        (
            ("26 lidar turned a little", "27 wheels exchanged"),
            (
                "The lidar is turned against its transform by",
                "turns against its commands, and odometry does not see it",
            ),
        ),
        pytest.param((), (), marks=pytest.mark.full),
        pytest.param(("26 lidar turned",), (r"turned against its transform by (17|18)\d°",), marks=pytest.mark.full),
        pytest.param(
            ("27 odometry turns the wrong way",), ("Odometry turns the wrong way: /odom",), marks=pytest.mark.full
        ),
        pytest.param(("27 odometry counts half",), ("Odometry counts 0.[45]",), marks=pytest.mark.full),
    ],
)
def test_a_small_move_tells_what_only_a_motion_shows(
    agent: Agent, robot: Planted, faults: tuple[str, ...], causes: tuple[str, ...]
) -> None:
    for fault in faults:
        robot.tell("plant", fault)
    try:
        probed = agent.call("ros2_nav_probe")
        if probed["verdict"] == "NOT KNOWN":  # of a motion that a busy machine has cut short
            probed = agent.call("ros2_nav_probe")
    finally:
        for fault in faults:
            robot.tell("heal", fault)
    assert probed["verdict"] == ("WRONG" if faults else "AS COMMANDED"), probed
    assert len(probed["findings"]) == len(causes)
    for finding, cause in zip(probed["findings"], causes, strict=True):
        assert re.search(cause, finding["cause"])


@pytest.mark.parametrize(
    ("fault", "told"),
    [
        ("4 monitor holds", r"polygon PolygonStop, with something at 0\.[23]\d m, bearing"),
        # A busy machine makes rates of its own.
        pytest.param("22 rate missed", r"misses its rate: [23]\.\d of 10 Hz on /cmd_vel_nav", marks=pytest.mark.full),
    ],
)
def test_what_holds_a_robot_on_its_way_is_told_while_it_is_under_way(
    agent: Agent, robot: Planted, fault: str, told: str
) -> None:
    def is_told() -> bool:
        """On a busy machine a look may come too late: the goal has failed by then."""
        agent.call("ros2_stop")
        going = agent.call("ros2_navigate", to=[{"x": 2.0, "y": 0.3}], timeout_s=4.5)
        return going["outcome"] == "under way" and bool(re.search(told, str(going["health"])))

    robot.tell("plant", fault)
    try:
        until(is_told, 60.0)
    finally:
        agent.call("ros2_stop")
        robot.tell("heal", fault)


@pytest.mark.parametrize(
    "fault", [pytest.param(one, marks=() if one in ALWAYS else pytest.mark.full) for one in CAUSES]
)
def test_a_planted_cause_is_the_first_that_is_told_and_no_decoy_is(agent: Agent, robot: Planted, fault: str) -> None:
    robot.tell("plant", fault)
    seen: list[list[str]] = []

    def first_is_right() -> bool:
        seen.append(said(agent))
        return bool(seen[-1]) and bool(re.search(CAUSES[fault], seen[-1][0]))

    try:
        until(first_is_right, 60.0)  # each look takes seconds on a busy machine
    except AssertionError as error:
        raise AssertionError(seen[-1]) from error
    finally:
        robot.tell("heal", fault)
    assert not [line for line in seen[-1] if NEVER.search(line) and not re.search(CAUSES[fault], line)]


def test_a_dead_server_is_one_finding_of_the_health_check(agent: Agent) -> None:
    """It died in the test before: nothing of it heals."""
    seen: list[dict[str, Any]] = []

    def is_one() -> bool:
        """Of a look in which a busy machine has let every node answer."""
        seen.append(agent.call("ros2_health_check"))
        rows = seen[-1]["findings"]
        of_nav2 = [row["problem"] for row in rows if "planner" in row["problem"] or row["subject"] == "lifecycle"]
        return len(of_nav2) == 1 and "/planner_server died" in of_nav2[0] and seen[-1]["verdict"] == "CRITICAL"

    try:
        until(is_one)
    except AssertionError as error:
        raise AssertionError(seen[-1]["findings"]) from error


@pytest.mark.full
@pytest.mark.parametrize(
    ("fault", "to", "cause"),
    [
        ("12 no initial pose", None, "/amcl does not know where the robot is"),
        ("32 unknown space", {"x": 5.4, "y": 0.5}, "lies in unknown space, and the planner may not enter it"),
    ],
)
def test_a_cause_that_is_there_from_the_start_is_told(
    environment: dict[str, str], fault: str, to: dict[str, float] | None, cause: str
) -> None:
    prefixes = build_interfaces("nav2", later=True)
    with reserved_domains() as domain_id:
        own = {**environment, "ROS_DOMAIN_ID": str(domain_id)}
        options = ("--robot", "nav2", "--until-stdin-closes", "--faults", fault)
        with running_robot(prefixes, domain_id, *options), agent_for(own, "--tools", "all") as agent:
            agent.knows("/global_costmap/costmap", "/cmd_vel", "/scan")
            given = {"to": to} if to else {}
            until(lambda: any(cause in line for line in said(agent, **given)[:1]), 40.0)
