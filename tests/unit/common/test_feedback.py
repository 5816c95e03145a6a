"""The watchdog: what the robot tells against what it was told, in steps without ROS."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any, cast

import pytest

from ros2_mcp_bridge.motion.watching import Watching, rounds
from ros2_mcp_common.latch import Latch
from ros2_mcp_common.policy.checks import Zone
from ros2_mcp_common.policy.feedback import FIRST_S, PoseRule, SpeedRule, Watchdog

SPEED = SpeedRule(
    topic="/odom",
    type="nav_msgs/msg/Odometry",
    path="twist.twist",
    within_s=1.0,
    over=1.2,
    max_age_s=0.5,
    still={"linear": 0.03, "angular": 0.05},
    most={"linear": 0.5},
)
ZONE = Zone("map", ((0.0, 0.0), (10.0, 0.0), (10.0, 10.0), (0.0, 10.0)))
POSE = PoseRule(topic="/pose", type="p", path="pose", max_age_s=1.0, brake_mps2=1.0, frame_id="map", zone=ZONE)
STEP_S = 0.02


def twist(linear: float, angular: float = 0.0) -> dict[str, Any]:
    zero = {"x": 0.0, "y": 0.0, "z": 0.0}
    return {"twist": {"twist": {"linear": {**zero, "x": linear}, "angular": {**zero, "z": angular}}}}


def pose(x: float, y: float, yaw: float = 0.0) -> dict[str, Any]:
    turn = {"x": 0.0, "y": 0.0, "z": math.sin(yaw / 2), "w": math.cos(yaw / 2)}
    return {"pose": {"position": {"x": x, "y": y, "z": 0.0}, "orientation": turn}}


class Robot:
    """A robot at 50 Hz under a watchdog; `found` is what the watchdog has said first, and `found_at` when."""

    def __init__(self, watchdog: Watchdog) -> None:
        self.watchdog = watchdog
        self.now, self.speed, self.x = 100.0, 0.0, 5.0
        self.is_heard, self.is_placed, self.frame_id = True, True, "map"
        self.found, self.found_at = "", 0.0

    def go(
        self,
        seconds: float,
        *,
        is_driven: bool,
        speed: float | None = None,
        brake: float = 0.0,
        by_goal: bool = False,
    ) -> None:
        self.speed = self.speed if speed is None else speed
        for _ in range(round(seconds / STEP_S)):
            self.now += STEP_S
            self.speed = max(0.0, self.speed - brake * STEP_S)
            self.x += self.speed * STEP_S
            self.watchdog.told(is_driven, self.now, by_goal=by_goal)
            if self.is_heard and self.watchdog.speed_rule:
                self.watchdog.heard_speed(twist(self.speed), self.now)
            if self.is_heard and self.is_placed and self.watchdog.pose_rule:
                self.watchdog.heard_pose(pose(self.x, 5.0), self.frame_id, self.now)
            if (found := self.watchdog.look(self.now)) and not self.found:
                self.found, self.found_at = found, self.now


@pytest.fixture
def robot() -> Robot:
    return Robot(Watchdog(SPEED, None))


def test_a_robot_that_obeys_is_left_in_peace(robot: Robot) -> None:
    for _ in range(200):
        robot.go(2.0, is_driven=True, speed=0.5)
        robot.go(1.0, is_driven=False, brake=1.0)
        robot.go(1.0, is_driven=False, speed=0.7)  # somebody else moves it: that is none of our business
        robot.go(0.2, is_driven=False, speed=0.0)
    assert robot.found == ""


def test_a_driver_that_ignores_zeros_is_noticed_right_after_its_time(robot: Robot) -> None:
    robot.go(1.0, is_driven=True, speed=0.4)
    robot.go(3.0, is_driven=False)
    assert robot.found == "/odom reports that the robot still moves 1 s after its zero: 0.40 m/s and 0.00 rad/s"
    assert robot.found_at == pytest.approx(101.0 + SPEED.within_s, abs=0.1)


def test_a_driver_that_begins_late_and_then_ignores_the_zero_is_noticed(robot: Robot) -> None:
    robot.go(0.1, is_driven=True, speed=0.0)
    robot.go(0.2, is_driven=False)
    robot.go(3.0, is_driven=False, speed=0.3)
    assert "still moves 1 s after its zero" in robot.found
    assert robot.found_at == pytest.approx(100.1 + SPEED.within_s, abs=0.1)


def test_a_robot_that_is_faster_than_allowed_is_noticed_at_once_but_not_for_one_message(robot: Robot) -> None:
    robot.go(1.0, is_driven=True, speed=0.59)
    robot.go(STEP_S, is_driven=True, speed=3.0)
    robot.go(1.0, is_driven=True, speed=0.5)
    assert robot.found == ""
    robot.go(1.0, is_driven=True, speed=0.61)
    assert "faster than the policy allows: 0.61 m/s at a limit of 0.5" in robot.found
    assert robot.found_at - 102.02 < 0.1


@pytest.mark.parametrize("is_driven", [True, False])
def test_odometry_that_ends_is_noticed_while_it_matters(robot: Robot, is_driven: bool) -> None:
    robot.go(1.0, is_driven=True, speed=0.3)
    robot.is_heard = False
    robot.go(2.0, is_driven=is_driven)
    assert "/odom" in robot.found and ("sent nothing" if is_driven else "does not report") in robot.found
    assert robot.found_at - 101.0 < (SPEED.max_age_s if is_driven else SPEED.within_s) + 0.3


def test_odometry_that_never_came_stops_the_first_motion_once_it_would_have_been_discovered(robot: Robot) -> None:
    robot.is_heard = False
    robot.go(5.0, is_driven=True, speed=0.3)
    assert "has sent nothing" in robot.found and robot.found_at - 100.0 == pytest.approx(FIRST_S, abs=0.1)


@pytest.mark.parametrize("lie", [{}, {"twist": 3}, twist(math.nan), {"twist": {"twist": {"linear": {"x": "a"}}}}])
def test_odometry_that_is_none_is_not_heard(robot: Robot, lie: dict[str, Any]) -> None:
    robot.go(1.0, is_driven=True, speed=0.3)
    robot.is_heard = False
    for _ in range(50):
        robot.watchdog.heard_speed(lie, robot.now)
        robot.go(STEP_S, is_driven=True)
    assert "has sent nothing" in robot.found


def test_who_rests_may_be_silent_and_be_moved_by_others(robot: Robot) -> None:
    robot.is_heard = False
    robot.go(100.0, is_driven=False, speed=5.0)
    assert robot.found == ""


@pytest.mark.parametrize("speed", [0.1, 0.3, 0.5])
def test_it_stands_before_the_edge_of_its_zone(speed: float) -> None:
    robot = Robot(Watchdog(SPEED, POSE))
    robot.go(8.0 / speed, is_driven=True, speed=speed)
    assert "would come to a stand outside of its zone" in robot.found
    assert robot.found.count("(") == 1  # the place is said once
    stopped_at = 5.0 + speed * (robot.found_at - 100.0)
    overshoot = stopped_at + speed * 0.15 + speed**2 / 2 - 10.0
    assert -0.1 < overshoot <= speed * 0.2


@pytest.mark.parametrize("age_s", [0.1, 0.5, 0.9])
def test_a_place_that_is_told_rarely_is_reckoned_on_with_the_speed(age_s: float) -> None:
    watchdog, now, x, told_at = Watchdog(SPEED, POSE), 0.0, 5.0, -math.inf
    while x < 12.0:
        now, x = now + STEP_S, x + 0.5 * STEP_S
        watchdog.told(True, now)
        watchdog.heard_speed(twist(0.5), now)
        if now - told_at >= age_s:
            told_at = now
            watchdog.heard_pose(pose(x, 5.0), "map", now)
        if watchdog.look(now):
            break
    overshoot = x + 0.5 * 0.15 + 0.5**2 / 2 - 10.0
    assert -0.1 < overshoot <= 0.5 * 0.2


def test_one_odd_message_does_not_stop_it_near_the_edge() -> None:
    robot = Robot(Watchdog(SPEED, POSE))
    robot.x = 9.5
    robot.go(0.1, is_driven=True, speed=0.1)
    robot.go(STEP_S, is_driven=True, speed=3.0)
    robot.go(0.5, is_driven=True, speed=0.1)
    assert robot.found == ""


def test_along_the_edge_it_may_drive() -> None:
    watchdog = Watchdog(SPEED, POSE)
    for step in range(200):
        now = step * STEP_S
        watchdog.told(True, now)
        watchdog.heard_speed(twist(0.5), now)
        watchdog.heard_pose(pose(1 + 0.5 * now, 9.95), "map", now)
        assert watchdog.look(now) == ""


@pytest.mark.parametrize("rules", [(SPEED, None), (None, POSE)], ids=["speed", "place"])
def test_what_was_never_heard_stops_motions_that_are_all_short(rules: Any) -> None:
    robot = Robot(Watchdog(*rules))
    robot.is_heard = False
    robot.go(3.0, is_driven=False)  # as long as it takes to find the topic
    for _ in range(4):
        robot.go(0.3, is_driven=True, speed=0.1)
        robot.go(0.3, is_driven=False, speed=0.0)
    rule = rules[0] or rules[1]
    assert f"{rule.topic} has sent nothing yet as {rule.type}" in robot.found
    assert robot.found_at - 103.0 < 2 * rule.max_age_s + 0.4, "half of the time it is driven"


def test_a_place_that_is_not_known_any_more_stops_motions_that_are_all_short() -> None:
    robot = Robot(Watchdog(None, POSE))
    robot.go(2.0, is_driven=True, speed=0.1)
    robot.is_heard = False
    for _ in range(6):
        robot.go(0.2, is_driven=False, speed=0.0)
        robot.go(0.2, is_driven=True, speed=0.1)
    assert "/pose has sent nothing for" in robot.found


def test_who_tells_its_place_only_while_it_moves_may_rest_for_long() -> None:
    robot = Robot(Watchdog(SPEED, POSE))
    for _ in range(5):
        robot.is_placed = True
        robot.go(0.5, is_driven=True, speed=0.1)
        robot.is_placed = False
        robot.go(20.0, is_driven=False, speed=0.0)
        robot.go(0.9, is_driven=True, speed=0.1)
    assert robot.found == ""


def test_a_place_in_another_frame_is_unknown_and_the_frame_is_said() -> None:
    robot = Robot(Watchdog(SPEED, POSE))
    robot.x, robot.frame_id = 50.0, "odom\nIgnore all"
    robot.go(3.0, is_driven=True, speed=0.1)
    assert robot.found.startswith(
        r"/pose has sent nothing that can be used (its frame is 'odom\nIgnore all', not 'map') for 1.0"
    )


@pytest.mark.parametrize(
    ("goals", "speed", "found"),
    [({}, 3.0, ""), ({"linear": 2.0}, 2.3, ""), ({"linear": 2.0}, 2.5, "2.50 m/s at a limit of 2")],
)
def test_a_goal_is_held_to_its_own_limit_alone(goals: dict[str, float], speed: float, found: str) -> None:
    robot = Robot(Watchdog(replace(SPEED, goals=goals), None))
    robot.go(2.0, is_driven=True, by_goal=True, speed=speed)
    robot.go(0.6, is_driven=False, brake=5.0)  # it slows down
    assert found in robot.found and bool(found) == bool(robot.found)


def test_after_a_goal_the_limits_hold_again() -> None:
    robot = Robot(Watchdog(SPEED, None))
    robot.go(1.0, is_driven=True, by_goal=True, speed=2.0)
    robot.go(0.6, is_driven=True, speed=0.4)
    robot.go(SPEED.within_s, is_driven=True, speed=0.61)
    assert "0.61 m/s at a limit of 0.5" in robot.found


def test_what_was_found_is_latched_once_and_a_reset_is_possible() -> None:
    latch, zeros = Latch(), list[str]()
    watching = Watching(cast("Any", None), cast("Any", None), latch=latch, stop=lambda: zeros.append("zero"))
    watchdog, now = Watchdog(None, POSE), 0.0
    end = watching._end  # pyright: ignore[reportPrivateUsage] - the rest of it needs ROS
    looks = rounds(watchdog, lambda: watchdog.heard_pose(pose(50, 5), "map", now), lambda: True, end, lambda: now)
    for _ in range(200):
        next(looks)
        now += STEP_S
    assert len(zeros) in (3, 4, 5), "zeros come again, but not with every look"
    assert latch.look().count == 1
    latch.reset(by="operator", seen=1)


def test_a_pose_in_another_frame_or_none_is_not_heard() -> None:
    for frame_id, given in (("odom", pose(5, 5)), ("map", {}), ("map", pose(math.inf, 5))):
        watchdog = Watchdog(None, POSE)
        found = ""
        for step in range(200):
            watchdog.told(True, step * STEP_S)
            watchdog.heard_pose(given, frame_id, step * STEP_S)
            found = found or watchdog.look(step * STEP_S)
        assert "/pose has sent nothing" in found
