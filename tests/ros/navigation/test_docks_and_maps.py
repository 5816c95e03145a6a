"""Finding the robot on its map, its last pose, docks and maps, on the rover with all of Nav2. The judge is a node of
the test's own, which knows the odometry, the battery, and what was told to AMCL.
"""

from __future__ import annotations

import math
import os
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("rclpy", reason="needs the ROS 2 wheels, or a sourced ROS 2")

from ros2_mcp_demo.nav2 import map_files
from ros2_mcp_demo.simulation import MAP_RESOLUTION
from ros2_mcp_demo.world import World
from support.agent import Agent, agent_for, until
from support.commanded import CommandedProcess
from support.demo_robot import Peer, build_interfaces, robot_environment, running_robot
from support.domains import reserved_domains

CHARGING, DISCHARGING = 1, 2
CHARGER = (-1.7, 0.0)


@dataclass
class Judge:
    """What the judge has received."""

    peer: Peer
    odometry: list[Any]
    told: list[Any]
    battery: list[Any]

    def pose(self) -> tuple[float, float, float]:
        """Where the robot is by its odometry, which began at the map's origin: its wheels slip by a few centimetres."""
        self.peer.spin(0.2)
        seen = len(self.odometry)
        self.peer.wait(lambda: len(self.odometry) > seen)
        pose = self.odometry[-1].pose.pose
        return pose.position.x, pose.position.y, 2 * math.atan2(pose.orientation.z, pose.orientation.w)

    def is_at(self, x: float, y: float, within: float = 0.2) -> bool:
        return math.dist(self.pose()[:2], (x, y)) < within

    def stands(self) -> bool:
        self.pose()
        twist = self.odometry[-1].twist.twist
        return abs(twist.linear.x) < 0.01 and abs(twist.angular.z) < 0.02

    def sees_supply(self, status: int) -> bool:
        """Whether the battery says so, as soon as it does: it is published once a second."""
        return bool(self.peer.wait(lambda: self.battery and self.battery[-1].power_supply_status == status, 20.0))

    def told_so_far(self) -> int:
        """How many initial poses were published."""
        self.peer.spin(0.3)
        return len(self.told)


class Robot:
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
    with reserved_domains() as domain_id:
        state = str(tmp_path_factory.mktemp("docks"))
        yield robot_environment(prefixes, ROS_DOMAIN_ID=str(domain_id), XDG_STATE_HOME=state)


@pytest.fixture(scope="module")
def robot(environment: dict[str, str]) -> Iterator[Robot]:
    domain_id = int(environment["ROS_DOMAIN_ID"])
    options = ("--robot", "nav2", "--until-stdin-closes")
    with running_robot(build_interfaces("nav2", later=True), domain_id, *options) as process:
        yield Robot(process)


@pytest.fixture(scope="module")
def judge(environment: dict[str, str], robot: Robot) -> Iterator[Judge]:
    peer = Peer(int(environment["ROS_DOMAIN_ID"]))
    odometry = peer.subscribe("/wheel/odom", "nav_msgs/msg/Odometry")
    told = peer.subscribe("/initialpose", "geometry_msgs/msg/PoseWithCovarianceStamped")
    battery = peer.subscribe("/battery_state", "sensor_msgs/msg/BatteryState")
    yield Judge(peer, odometry, told, battery)
    peer.close()


@pytest.fixture(scope="module")
def agent(environment: dict[str, str], robot: Robot) -> Iterator[Agent]:
    with agent_for(environment, "--tools", "all") as agent:
        agent.knows("/map", "/scan", "/global_costmap/costmap", "/cmd_vel")
        until(lambda: "/dock_robot" in str(agent.call("ros2_list_actions")))
        yield agent


def lose(agent: Agent, robot: Robot, judge: Judge) -> None:
    """Have AMCL place the robot elsewhere, and wait until the transforms do: AMCL's are a second ahead."""
    robot.tell("plant", "28 lost")
    x, y, _ = judge.pose()

    def is_elsewhere() -> bool:
        at = agent.call("ros2_tf_lookup", target="map", source="base_link")["translation"]
        return math.dist((at["x"], at["y"]), (x, y)) > 0.5

    until(is_elsewhere)


def test_a_robot_that_amcl_has_elsewhere_is_found_on_the_map(agent: Agent, robot: Robot, judge: Judge) -> None:
    agent.call("ros2_drive", distance_m=0.4)
    agent.call("ros2_drive", angle_deg=40)
    lose(agent, robot, judge)
    found = agent.call("ros2_nav_localize", search=True)
    x, y, yaw = judge.pose()
    assert math.dist((found["x_m"], found["y_m"]), (x, y)) < 0.15
    assert abs(math.remainder(math.radians(found["yaw_deg"]) - yaw, 2 * math.pi)) < math.radians(5)
    assert (found["is_published"], found["is_taken"]) == (True, True)
    assert found["fit_before"] < 0.5 and found["fit_after"] > 0.9, found
    judge.peer.wait(lambda: judge.told)
    assert judge.told_so_far() == 1
    at = judge.told[-1].pose.pose.position
    assert (at.x, at.y) == pytest.approx((found["x_m"], found["y_m"]))


def test_where_the_scan_fits_nowhere_nothing_is_told(agent: Agent, judge: Judge) -> None:
    told = judge.told_so_far()
    result = agent.call("ros2_nav_localize", at={"x": 5.0, "y": 2.0}, search=True, radius_m=1)
    assert result["is_published"] is False and "fits nowhere well" in result["doubt"]
    assert judge.told_so_far() == told
    assert "Give one of the three" in agent.refusal("ros2_nav_localize", last=True, search=True)
    assert "`at` is missing" in agent.refusal("ros2_nav_localize")


def test_the_last_pose_is_offered_by_the_next_server_and_not_where_the_robot_has_left_it(
    agent: Agent, environment: dict[str, str], robot: Robot, judge: Judge
) -> None:
    lose(agent, robot, judge)
    with agent_for(environment, "--tools", "all") as after:
        after.knows("/map", "/scan")
        last = after.call("ros2_nav_localize", last=True)
    assert (last["is_published"], last["is_taken"]) == (True, True), last
    assert "old" in last["how"] and last["fit_after"] > 0.9
    assert math.dist((last["x_m"], last["y_m"]), judge.pose()[:2]) < 0.15
    agent.call("ros2_drive", angle_deg=-100)
    told = judge.told_so_far()
    stale = agent.call("ros2_nav_localize", last=True)
    assert stale["is_published"] is False and stale["doubt"], stale
    assert judge.told_so_far() == told
    assert agent.call("ros2_nav_localize", search=True)["is_taken"]


@pytest.mark.promise("ros2_nav_localize", "If several poses fit nearly as well, none is published")
@pytest.mark.promise("ros2_nav_map", "the map that is published after loading, and the files where they can be seen")
def test_a_map_is_saved_and_another_is_loaded_and_of_two_equal_rooms_none_is_told(
    agent: Agent, judge: Judge, tmp_path: Path
) -> None:
    saved = agent.call("ros2_nav_map", what="save", path=str(tmp_path / "room"))
    assert saved["successful"] and saved["verified"].startswith("Verified"), saved
    cells, (corner_x, corner_y) = World().occupancy(MAP_RESOLUTION)
    assert np.array_equal(map_files.read(tmp_path / "room.yaml")[0], cells)
    map_files.write(tmp_path / "twins", np.hstack([cells, cells]), MAP_RESOLUTION, (corner_x, corner_y))
    loaded = agent.call("ros2_nav_map", what="load", path=str(tmp_path / "twins.yaml"))
    assert loaded["successful"] and loaded["verified"].startswith("Verified: a new map"), loaded
    assert loaded["maps"][0]["width"] == 2 * cells.shape[1]

    told = judge.told_so_far()
    twins = agent.call("ros2_nav_localize", search=True)
    assert twins["is_published"] is False and "1 other pose fits nearly as well" in twins["doubt"], twins
    apart = twins["found"][0]["x_m"] - twins["found"][1]["x_m"]
    assert abs(apart) == pytest.approx(cells.shape[1] * MAP_RESOLUTION, abs=0.1)
    assert judge.told_so_far() == told
    x, y, _ = judge.pose()
    guessed = agent.call("ros2_nav_localize", at={"x": x + 0.5, "y": y}, search=True)
    assert guessed["is_taken"] and math.dist((guessed["x_m"], guessed["y_m"]), (x, y)) < 0.15

    back = agent.call("ros2_nav_map", what="load", path=str(tmp_path / "room.yaml"))
    assert back["successful"] and back["maps"][0]["width"] == cells.shape[1]


def test_a_map_that_is_not_there_and_files_that_cannot_be_seen_are_told_as_such(agent: Agent, tmp_path: Path) -> None:
    missing = agent.call("ros2_nav_map", what="load", path=str(tmp_path / "nothing.yaml"))
    assert missing["successful"] is False and "no such map" in missing["said"]
    (tmp_path / "bad.yaml").write_text("resolution: 0.05\n")
    bad = agent.call("ros2_nav_map", what="load", path=str(tmp_path / "bad.yaml"))
    assert bad["successful"] is False and "YAML" in bad["said"]
    relative = os.path.relpath(tmp_path / "here")
    assert "NOT verified" in agent.call("ros2_nav_map", what="save", path=relative)["verified"]
    shown = agent.call("ros2_nav_map")
    assert [row["topic_name"] for row in shown["maps"]] == ["/map"]
    assert shown["files"] == ["/map_server: room.yaml"]
    assert "slam_toolbox/srv/SerializePoseGraph" in agent.refusal(
        "ros2_nav_map", what="save", path="/tmp/graph", pose_graph=True
    )


@pytest.mark.promise("ros2_nav_dock", "whether the battery says that it charges")
def test_it_docks_and_undocks_and_the_battery_is_the_witness(agent: Agent, judge: Judge) -> None:
    docked = agent.call("ros2_nav_dock", dock="charger", timeout_s=55)
    if docked["outcome"] == "under way":  # on a busy machine
        docked = agent.call("ros2_nav_dock", job_id=docked["job_id"], timeout_s=55)
    assert (docked["outcome"], docked["is_charging"]) == ("docked", True), docked
    assert docked["states"] == [
        "drives to the staging pose",
        "looks for the dock",
        "drives to the dock",
        "waits until it charges",
    ]
    assert judge.is_at(*CHARGER) and judge.sees_supply(CHARGING) and judge.stands()
    assert docked["away_m"] < 0.2
    undocked = agent.call("ros2_nav_dock", undock=True)
    assert (undocked["outcome"], undocked["is_charging"]) == ("undocked", False), undocked
    assert undocked["moved_m"] == pytest.approx(0.7, abs=0.15)
    assert judge.sees_supply(DISCHARGING) and judge.is_at(-1.0, 0.0, 0.3)


def test_a_dock_that_nav2_does_not_know_is_refused_before_anything_moves(agent: Agent, judge: Judge) -> None:
    assert "Did you mean charger" in agent.refusal("ros2_nav_dock", dock="chargr")
    assert "There are several docks: charger, parking" in agent.refusal("ros2_nav_dock")
    assert "heading" in agent.refusal("ros2_nav_dock", at={"x": 1.0, "y": 2.0})
    assert "no dock" in agent.refusal("ros2_nav_dock", dock="charger", undock=True)
    wrong = agent.call("ros2_nav_dock", at={"x": 1.0, "y": 2.3, "yaw_deg": 90}, dock_type="hook")
    assert wrong["outcome"] == "failed" and wrong["error"].startswith("DOCK_NOT_VALID (902)")
    assert judge.stands()


@pytest.mark.full
def test_a_dock_without_power_is_tried_again_and_the_reason_told(agent: Agent, robot: Robot, judge: Judge) -> None:
    robot.tell("plant", "dock unpowered")
    failed = agent.call("ros2_nav_dock", dock="charger", timeout_s=59)
    robot.tell("heal", "dock unpowered")
    assert failed["outcome"] == "failed" and failed["retries"] == 1, failed
    assert failed["error"].startswith("FAILED_TO_CHARGE (906)") and "tries again" in failed["states"]
    assert failed["is_charging"] is False and judge.stands()


@pytest.mark.promise("ros2_nav_dock", "After a time-out, call again with the job_id")
@pytest.mark.promise("ros2_nav_dock", "ros2_stop ends it")
def test_a_docking_goes_on_after_its_time_out_and_a_stop_ends_it(agent: Agent, judge: Judge) -> None:
    begun = agent.call("ros2_nav_dock", dock="parking", timeout_s=2)
    assert begun["outcome"] == "under way"
    judge.peer.wait(lambda: not judge.stands())
    waiting = agent.begin("ros2_nav_dock", job_id=begun["job_id"], timeout_s=50)
    agent.call("ros2_stop")
    ended = waiting.result(60)
    assert (ended["outcome"], ended["dock"]) == ("canceled", "parking")
    judge.peer.wait(judge.stands, 5.0)  # it brakes


@pytest.mark.full
def test_what_a_killed_docking_server_left_running_is_ended(
    agent: Agent, environment: dict[str, str], judge: Judge
) -> None:
    peer = CommandedProcess("dock_peer", environment)
    try:
        until(lambda: "/dock_here" in str(agent.call("ros2_list_actions")))
        at = {"x": 4.0, "y": 1.0, "yaw_deg": 0}
        waiting = agent.begin("ros2_nav_dock", at=at, action_name="/dock_here", timeout_s=55)
        judge.peer.wait(lambda: not judge.stands())
    finally:
        peer.kill()
    ended = waiting.result(55)
    assert ended["outcome"] == "failed" and "/navigate_to_pose" in ended["note"], ended
    assert judge.stands()
    assert not agent.call("ros2_action_status")["goals"] or not [
        goal for goal in agent.call("ros2_action_status")["goals"] if goal["status"] in ("ACCEPTED", "EXECUTING")
    ]
