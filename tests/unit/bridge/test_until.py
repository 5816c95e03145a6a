"""The controller of ros2_move_until, stepped without ROS: what it commands, and what ends it."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import pytest

from ros2_mcp.values.select import known_to
from ros2_mcp_bridge.motion.asking import Asking
from ros2_mcp_bridge.motion.controller import Feed
from ros2_mcp_bridge.motion.drive import LATE_S
from ros2_mcp_bridge.motion.until import Until
from support.made_windows import CODEC, decoded

SCAN = "sensor_msgs/msg/LaserScan"
ODOMETRY = "nav_msgs/msg/Odometry"
FORWARD = {"linear.x": 0.2}
STAND = {"linear.x": 0.0}
STEP_S = 0.01


class World:
    """A robot that drives towards a wall as it is told, with a scan and odometry at their rates; times in s."""

    def __init__(self, until: Until, wall_m: float = 2.0, scan_hz: float = 10.0, odometry_hz: float = 50.0) -> None:
        self.until = until
        self.now = 100.0
        self.wall_m, self.x_m, self.speed = wall_m, 0.0, 0.0
        self.periods = {"condition": 1 / scan_hz, "odometry": 1 / odometry_hz}
        self.due = dict.fromkeys(self.periods, self.now)
        self.silent_from: dict[str, float] = {}
        self.silent_until: dict[str, float] = {}
        self.commands: list[tuple[float, float]] = []
        self.met_at = math.inf

    def run(self, at_most_s: float) -> None:
        end = self.now + at_most_s
        while self.now < end:
            self.now += STEP_S
            self.x_m += self.speed * STEP_S
            for role in (feed.role for feed in self.until.feeds):
                if self.now >= self.due[role]:
                    self.due[role] += self.periods[role]
                    if not self.silent_from.get(role, math.inf) <= self.now < self.silent_until.get(role, math.inf):
                        self.until.hear(role, self.message(role), self.now)
            if self.until.awaits():
                continue
            command = self.until.step(self.now)
            self.speed = 0.0 if command is None else command["linear.x"]
            self.commands.append((self.now, self.speed))
            if command is None:
                return

    def message(self, role: str) -> object:
        if role == "odometry":
            return decoded(ODOMETRY, {"pose": {"pose": {"position": {"x": self.x_m}}}})
        free_m = self.wall_m - self.x_m
        if free_m < 0.5999:  # as a float32 it is below 0.6, too
            self.met_at = min(self.met_at, self.now)
        return decoded(SCAN, scan([free_m] * 3))


def scan(ranges: Sequence[float]) -> dict[str, Any]:
    return {"angle_min": -0.1, "angle_increment": 0.1, "range_max": 10, "ranges": list(ranges)}


def until(
    text: str = "nearest(-10, 10) < 0.6", *, type_name: str = SCAN, has_odometry: bool = True, **options: Any
) -> Until:
    return Until(
        topic=Feed("condition", "/scan", type_name),
        asking=Asking(known_to(CODEC.definitions), type_name, text),
        velocity=options.pop("velocity", FORWARD),
        odometry=Feed("odometry", "/odom", ODOMETRY) if has_odometry else None,
        **options,
    )


def test_it_drives_until_the_condition_is_met_and_ends_with_the_message_that_met_it() -> None:
    world = World(until())
    world.run(30)
    assert world.until.outcome == "met"
    assert world.now - world.met_at <= STEP_S
    assert {speed for _, speed in world.commands} == {0.2, 0.0}
    report = world.until.report()
    assert report["values"] == {"nearest(-10, 10)": pytest.approx(world.wall_m - world.x_m, abs=1e-6)}
    assert report["distance_m"] == pytest.approx(world.x_m, abs=0.02)
    assert (report["met"], report["paused_s"]) == (True, 0.0)


def test_a_condition_that_is_met_already_moves_nothing() -> None:
    world = World(until(), wall_m=0.5)
    world.run(5)
    assert (world.until.outcome, world.x_m, world.until.report()["looked_at"]) == ("met", 0.0, 1)


def test_the_limit_of_the_way_ends_it_by_odometry() -> None:
    world = World(until(max_distance_m=0.5), wall_m=20)
    world.run(30)
    assert world.until.outcome == "distance"
    assert "0.5 m" in world.until.why
    assert 0.5 <= world.x_m < 0.5 + 0.2 * (1 / 50 + 2 * STEP_S)


def test_the_way_is_that_of_the_path_and_not_of_trembling() -> None:
    controller = until(max_distance_m=9)
    for number in range(400):
        angle = math.pi * number / 200  # a circle of 1 m
        trembling = 0.002 if number % 2 else -0.002
        place = {"x": math.cos(angle) + trembling, "y": math.sin(angle)}
        controller.hear("odometry", decoded(ODOMETRY, {"pose": {"pose": {"position": place}}}), number / 50)
        if number == 3:
            for _ in range(3):
                controller.hear("condition", decoded(SCAN, scan([5])), number / 50)
            controller.step(number / 50)
    assert controller.report()["distance_m"] == pytest.approx(2 * math.pi, rel=0.05)


@pytest.mark.parametrize("role", ["condition", "odometry"])
def test_a_topic_that_goes_silent_is_stood_still_for_at_once_and_ends_it(role: str) -> None:
    world = World(until(), wall_m=20)
    world.silent_from[role] = 102.0
    world.run(30)
    assert world.until.outcome == "silent"
    assert ("/scan" if role == "condition" else "/odom") in world.until.why
    stood_at = next(at for at, speed in world.commands if at > 102 and speed == 0)
    assert stood_at - 102.0 <= world.periods[role] + 0.1  # one period and 100 ms


def test_after_a_short_pause_it_goes_on() -> None:
    world = World(until(), wall_m=3)
    world.silent_from["condition"], world.silent_until["condition"] = 102.0, 102.4
    world.run(30)
    assert world.until.outcome == "met"
    paused_s = world.until.report()["paused_s"]
    assert isinstance(paused_s, float) and 0.1 < paused_s < 0.5


def test_a_topic_of_events_may_be_silent() -> None:
    pressed = until("data", type_name="std_msgs/msg/Bool", has_odometry=False, may_be_silent=True)
    assert pressed.awaits() == ""
    assert pressed.step(1.0) == FORWARD
    pressed.hear("condition", decoded("std_msgs/msg/Bool", {"data": False}), 5.0)
    assert pressed.step(60.0) == FORWARD
    pressed.hear("condition", decoded("std_msgs/msg/Bool", {"data": True}), 60.5)
    assert (pressed.step(60.5), pressed.outcome) == (None, "met")
    assert pressed.report()["values"] == {"data": True}


def test_the_age_of_a_message_from_before_that_met_it_is_reported() -> None:
    pressed = until("data", type_name="std_msgs/msg/Bool", has_odometry=False, may_be_silent=True)
    pressed.hear("condition", decoded("std_msgs/msg/Bool", {"data": False}), 5.0, 20.0)
    assert pressed.report()["from_before_s"] == 20.0
    pressed.hear("condition", decoded("std_msgs/msg/Bool", {"data": True}), 5.1, 8.25)
    pressed.hear("condition", decoded("std_msgs/msg/Bool", {"data": True}), 5.2)  # comes too late to meet it
    assert (pressed.step(5.2), pressed.report()["from_before_s"]) == (None, 8.25)


def test_it_awaits_what_it_hears_before_it_moves() -> None:
    controller = until()
    assert controller.awaits() == "no message came from /scan and no message came from /odom"


def test_a_message_without_an_answer_is_counted_and_told() -> None:
    world = World(until("range_at(170) < 1"), wall_m=20)
    world.run(1)
    report = world.until.report()
    assert (report["met"], report["undecided"]) == (False, report["looked_at"])
    assert "range_at(170)" in str(report["why_undecided"])


def test_values_of_texts_and_of_what_is_no_number_can_be_sent() -> None:
    asking = Asking(known_to(CODEC.definitions), ODOMETRY, "pose.pose.position.x > 1 or child_frame_id == 'x'")
    asking.ask(decoded(ODOMETRY, {"pose": {"pose": {"position": {"x": "nan"}}}, "child_frame_id": "a" * 999}))
    values = asking.report()["values"]
    assert isinstance(values, dict)
    assert (values["pose.pose.position.x"], len(values["child_frame_id"])) == ("nan", 200)


@pytest.mark.parametrize(
    "options",
    [
        {"velocity": {}},
        {"velocity": STAND},
        {"velocity": {"linear.x": math.nan}},
        {"has_odometry": False, "max_distance_m": 1},
    ],
)
def test_what_would_move_nothing_or_know_no_limit_is_refused(options: dict[str, Any]) -> None:
    with pytest.raises(ValueError, match=r"needed|needs"):
        until(**options)


def test_it_says_when_the_first_of_its_topics_is_late() -> None:
    controller = until()
    for number in range(10):
        controller.hear("odometry", decoded(ODOMETRY, {}), 100 + number * 0.04)
        controller.hear("condition", decoded(SCAN, scan([5])), 100 + number * 0.1)
    at = 100 + 9 * 0.04  # the odometry is first
    assert controller.late_in_s(at) == pytest.approx(0.04 + LATE_S)
    assert controller.late_in_s(at + 0.04 + LATE_S + 0.001) == pytest.approx(100.9 + 0.1 + LATE_S - at - 0.101)
    assert controller.late_in_s(200) == math.inf
