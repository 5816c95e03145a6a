"""The rover drives with Nav2 beside keep-out zones of a policy; an observer's node, which knows its pose, judges."""

from __future__ import annotations

import math
import os
import random
from collections import Counter
from collections.abc import Iterator
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("rclpy", reason="needs the ROS 2 wheels, or a sourced ROS 2")

from ros2_mcp_common.latch import FILE, Latch
from ros2_mcp_common.policy.keep_out import KeepOut
from support.agent import FULL, Agent, Refusal, agent_for, until
from support.demo_robot import robot_environment, running_robot
from support.domains import reserved_domains
from support.observer import Observer, observing
from support.velocities import TWIST
from support.zone_drives import entered

ZONES = {
    "stairs": ((0.9, -0.6), (1.5, -0.6), (1.5, 0.4), (0.9, 0.4)),
    "pool": ((-0.6, -1.6), (-0.6, -1.0), (0.0, -1.0)),
}
RADIUS_M = 0.2
POLICY = """
policy: 1
name: hall
robot: zones
allow:
  - {publish: /cmd_vel, type: geometry_msgs/msg/Twist}
  - {goal: /navigate_to_pose, type: nav2_msgs/action/NavigateToPose}
  - {cancel: /navigate_to_pose}
  - {goal: /compute_path_to_pose, type: nav2_msgs/action/ComputePathToPose}
limits: {base: {types: geometry_msgs/msg/Twist, norm: {linear: 0.5, angular: 1.5}}}
keep_out:
  zones:
    stairs: [[0.9, -0.6], [1.5, -0.6], [1.5, 0.4], [0.9, 0.4]]
    pool: [[-0.6, -1.6], [-0.6, -1.0], [0.0, -1.0]]
  radius_m: 0.2
pose: {topic: /tf, frame: map, base: base_link, max_age_s: 3.0}
feedback: {topic: /odom, goals: {linear: 0.25}, max_age_s: 3.0, within_s: 3.0}
"""
"""The times are long: a busy machine holds up a process for half a second and more, which would rightly latch."""
DRIVES = 20


class Rover:
    """The rover under that policy, its server's client, and the observer."""

    def __init__(self, agent: Agent, observer: Observer, latch: Latch, environment: dict[str, str]) -> None:
        self.agent, self.observer, self.latch, self.environment = agent, observer, latch, environment

    def poses(self) -> np.ndarray:
        """Every pose (x, y, yaw) that the observer has heard, and five between two each."""
        told = [one["values"] for one in self.observer.messages(by="judge")]
        poses = np.array([[x, y, math.atan2(2 * w * z, 1 - 2 * z * z)] for x, y, _, _, _, z, w in told])
        shares = np.linspace(0, 1, 6, endpoint=False)[:, None]
        return np.concatenate([one + shares * (other - one) for one, other in pairwise(poses)])

    def check(self) -> np.ndarray:
        """The poses, of which none may be in a zone."""
        poses = self.poses()
        keep_out = KeepOut("observer", "map", ZONES, margin_m=0.0, radius_m=RADIUS_M)
        assert not entered(keep_out, poses).any(), poses[entered(keep_out, poses)]
        return poses

    def at(self) -> tuple[float, float]:
        x, y, _ = self.poses()[-1]
        return float(x), float(y)

    def twist(self, x: float, z: float, seconds: float) -> dict[str, Any]:
        data = {"linear": {"x": x}, "angular": {"z": z}}
        return self.agent.call(
            "ros2_topic_publish",
            topic_name="/cmd_vel",
            message_type=TWIST,
            data=data,
            frequency=20,
            duration=seconds,
        )


@pytest.fixture(scope="module")
def rover(built: Any, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Rover]:
    first, later = built
    folder = tmp_path_factory.mktemp("zones")
    folder.chmod(0o700)
    policy: Path = folder / "policy.yaml"
    policy.write_text(POLICY, encoding="utf-8")
    policy.chmod(0o600)
    prefixes = [*first, later]
    with reserved_domains() as domain_id, running_robot(prefixes, domain_id) as _:
        known = os.pathsep.join(map(str, prefixes))
        environment = robot_environment(
            prefixes, ROS_DOMAIN_ID=str(domain_id), XDG_STATE_HOME=str(folder / "state"), ROS2_MCP_INTERFACES=known
        )
        latch = Latch(folder / "state" / "ros2-mcp" / "zones" / FILE)
        with (
            observing(environment) as observer,
            agent_for(environment, "--tools", "all", "--policy", str(policy)) as agent,
        ):
            observer.join(by="judge", topic="/pose", kind="geometry_msgs/msg/PoseWithCovarianceStamped")
            observer.join(by="limit", topic="/speed_limit", kind="nav2_msgs/msg/SpeedLimit")
            agent.knows("/odom", "/tf", "/cmd_vel")
            until(lambda: "/navigate_to_pose" in str(agent.call("ros2_list_actions")))
            until(lambda: len(observer.messages(by="judge")) > 2)
            yield Rover(agent, observer, latch, environment)


def test_the_policy_tells_the_zones_and_what_is_done_at_their_edges(rover: Rover) -> None:
    told = str(rover.agent.call("ros2_policy"))
    assert "keep-out zone stairs in the frame map has the corners (0.9, -0.6)" in told
    assert "a circle of 0.2 m, keeps 0.2 m from keep-out zones" in told


def test_the_scene_shows_the_zones(rover: Rover) -> None:
    layers = rover.agent.call("ros2_scene")["layers"]
    assert {one["name"] for one in layers if one["kind"] == "keep-out zone"} == set(ZONES)


def test_a_goal_in_a_zone_and_a_path_through_one_are_refused_before_anything_moves(rover: Rover) -> None:
    before = rover.at()
    inside = rover.agent.refusal("ros2_navigate", to=[{"x": 0.0, "y": 0.5}, {"x": 1.2, "y": 0.0, "yaw_deg": 0}])
    assert "in the keep-out zone stairs" in inside and "keep_out" in inside
    edge = rover.agent.refusal("ros2_navigate", to=[{"x": 0.55, "y": 0.0, "yaw_deg": 180}])
    assert "0.15 m from the keep-out zone stairs at (0.55, 0.00)" in edge
    beyond = rover.agent.refusal("ros2_navigate", to=[{"x": 2.0, "y": 0.0}])
    assert "On the planned path the robot's outline would be" in beyond and "keep-out zone stairs at (" in beyond
    previewed = rover.agent.call("ros2_nav_preview", to={"x": 2.0, "y": 0.0})
    assert previewed["note"].startswith("The policy refuses it: the robot's outline would be")
    raw = {"pose": {"header": {"frame_id": "odom"}, "pose": {"position": {"x": -0.5}}}}
    assert "in the frame 'odom'" in rover.agent.refusal(
        "ros2_send_action_goal", action_name="/navigate_to_pose", goal_fields=raw
    )
    rover.check()
    assert math.dist(before, rover.at()) < 0.06  # two poses, each 8 mm wrong: five sigma


def test_velocities_towards_a_zone_end_before_it_and_lead_away_again(rover: Rover) -> None:
    def came_near() -> bool:
        """Drive until the policy ends it: far from the zone, too, where a busy machine has heard no pose for 2 s."""
        ended = rover.twist(0.25, 0.0, 30.0)  # it takes 2 s; longer where the commands of a busy machine have gaps
        assert "ended by the policy, before a keep-out zone" in ended["summary"], ended
        until(lambda: rover.agent.call("ros2_status") and abs(rover.poses()[-1][0] - rover.poses()[-12][0]) < 0.01)
        return bool(rover.check()[-1][0] > 0.3)

    until(came_near, 90.0)
    poses = rover.check()
    if FULL:  # a bridge that is held up lets it go on until the base's own time-out, 0.1 m further
        assert poses[-1][0] < 0.6, "it stood before the margin's half"
    assert not rover.latch.look().is_set
    rover.twist(-0.25, 0.0, 1.5)
    until(lambda: rover.at()[0] < 0.3 or not rover.twist(-0.25, 0.0, 0.5))  # again where commands had gaps
    rover.check()


def test_a_drive_by_feedback_ends_before_a_zone(rover: Rover) -> None:
    try:
        told = str(rover.agent.call("ros2_drive", distance_m=2.0, speed=0.25, guard_m=0))
    except Refusal as refusal:
        told = str(refusal)
    assert "keep-out zone stairs" in told, told
    poses = rover.check()
    if FULL:
        assert poses[-1][0] < 0.6
    assert not rover.latch.look().is_set
    rover.agent.call("ros2_drive", distance_m=-0.4, speed=0.25, guard_m=0)
    rover.check()


def test_a_goal_whose_path_leads_into_a_zone_is_cancelled_while_it_is_driven(rover: Rover) -> None:
    raw = {
        "pose": {"header": {"frame_id": "map"}, "pose": {"position": {"x": 2.0, "y": 0.0}, "orientation": {"w": 1.0}}}
    }
    sent = rover.agent.call(
        "ros2_send_action_goal",
        action_name="/navigate_to_pose",
        goal_fields=raw,
        wait_for_result=True,
        timeout_sec=30,
    )
    assert sent["status"] == "CANCELED" and "before a keep-out zone" in sent["note"], sent
    rover.check()
    assert not rover.latch.look().is_set


def test_the_goal_of_a_client_without_a_policy_is_cancelled_too(rover: Rover, tmp_path: Path) -> None:
    pose = {"position": {"x": 2.0, "y": -0.1}, "orientation": {"w": 1.0}}
    elsewhere = {**rover.environment, "XDG_STATE_HOME": str(tmp_path)}
    with agent_for(elsewhere, "--tools", "all") as other:
        until(lambda: "/navigate_to_pose" in str(other.call("ros2_list_actions")))
        sent = other.call(
            "ros2_send_action_goal",
            action_name="/navigate_to_pose",
            goal_fields={"pose": {"header": {"frame_id": "map"}, "pose": pose}},
            wait_for_result=True,
            timeout_sec=30,
        )
    assert sent["status"] == "CANCELED", sent
    rover.check()


def test_a_place_past_the_zones_is_reached(rover: Rover) -> None:
    done = rover.agent.call("ros2_navigate", to=[{"x": -0.8, "y": 0.3}])
    assert done["outcome"] == "reached" and "not checked" not in done["note"], done
    rover.check()
    assert not rover.latch.look().is_set, "it drives 0.4 m/s where nobody tells Nav2 the policy's speed for goals"
    (limit,) = {tuple(one["values"]) for one in rover.observer.messages(by="limit")}
    assert limit[-1] == 0.25


@pytest.mark.full
@pytest.mark.timeout(1500)
def test_on_many_drives_the_observer_sees_no_entry(rover: Rover) -> None:
    rng, became = random.Random(41), Counter[str]()
    for number in range(DRIVES):
        x, y = rng.uniform(-1.5, 2.2), rng.uniform(-2.2, 2.2)
        raw = {"header": {"frame_id": "map"}, "pose": {"position": {"x": x, "y": y}, "orientation": {"w": 1.0}}}
        try:
            if number % 3 == 0:
                became[rover.agent.call("ros2_navigate", to=[{"x": x, "y": y}], timeout_s=40)["outcome"]] += 1
            elif number % 3 == 1:
                sent = rover.agent.call(
                    "ros2_send_action_goal",
                    action_name="/navigate_to_pose",
                    goal_fields={"pose": raw},
                    wait_for_result=True,
                    timeout_sec=40,
                )
                became[sent["status"]] += 1
            else:
                rover.twist(rng.uniform(0.1, 0.25), rng.uniform(-0.6, 0.6), 4.0)
                became["driven"] += 1
        except Refusal as refusal:
            became["refused" if "keep-out zone" in str(refusal) else str(refusal)] += 1
        rover.check()
        state = rover.latch.look()
        if state.is_set:
            became["latched"] += 1
            rover.latch.reset(by="operator", seen=state.count)
            until(lambda: not rover.agent.call("ros2_status")["latched"])
    print(f"{DRIVES} drives: {dict(became)}")
    assert FULL and became["latched"] == 0, became
