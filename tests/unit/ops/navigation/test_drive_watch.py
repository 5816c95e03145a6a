"""What a navigation that is under way shows, told from times that are made here."""

from __future__ import annotations

import pytest

from ros2_mcp.ops.navigation.checks.collision_monitor import Near, near_in
from ros2_mcp.ops.navigation.drive_watch import DriveWatch
from ros2_mcp.ops.navigation.follow_drive import take_tree


def driving(
    seconds: float, watch: DriveWatch, *, command: float = 0.3, speed: float = 0.0, wheels: float | None = None
) -> float:
    """Ten times a second for so long: commands for the controller's topic and the base's, and odometry."""
    for step in range(round(seconds * 10)):
        now = step / 10
        watch.commanded("/cmd_vel_nav", command, 0.0, now)
        watch.commanded("/cmd_vel", command if wheels is None else wheels, 0.0, now)
        watch.moved("/odom", speed, 0.0, (speed * now, 0.0), now)
    return seconds


def test_a_robot_that_drives_shows_nothing() -> None:
    watch = DriveWatch(began_at=0.0)
    now = driving(6, watch, speed=0.3)
    assert watch.sees(now) == ""
    assert watch.stuck_s(now) < 2.0


def test_a_robot_that_is_commanded_and_stands_is_told_within_three_seconds() -> None:
    watch = DriveWatch(began_at=0.0)
    now = driving(3, watch)
    told = watch.sees(now)
    assert told.startswith("COMMANDED AND NOT MOVING") and "0.30 m/s on /cmd_vel" in told and "/odom" in told
    assert watch.stuck_s(now) > 2.5


def test_the_link_between_which_commands_end_is_named() -> None:
    watch = DriveWatch(began_at=0.0)
    watch.chain(["/cmd_vel_nav", "/cmd_vel"])
    now = driving(4, watch, wheels=0.0)
    assert "The commands end between /cmd_vel_nav and /cmd_vel." in watch.sees(now)


def test_a_robot_to_which_nothing_is_sent_is_told_so() -> None:
    watch = DriveWatch(began_at=0.0)
    now = driving(6, watch, command=0.0)
    assert "no velocity was sent" in watch.sees(now)


def test_a_collision_monitor_that_holds_is_named_with_its_polygon_and_before_all_else() -> None:
    watch = DriveWatch(began_at=0.0)
    now = driving(4, watch)
    watch.monitor(1, "PolygonStop", 1.0)
    assert watch.sees(now) == "The collision monitor holds the robot, for 3 s: polygon PolygonStop."
    watch.monitor(1, "invalid source", 2.0)
    assert "a source of it is silent" in watch.sees(now) and "polygon" not in watch.sees(now)
    watch.monitor(0, "", now)
    assert "collision monitor" not in watch.sees(now)


@pytest.mark.parametrize("changes", [[("IDLE", "SUCCESS")], [("IDLE", "RUNNING"), ("RUNNING", "SUCCESS")]])
def test_a_clearing_counts_once_whether_it_was_answered_at_once_or_later(changes: list[tuple[str, str]]) -> None:
    watch = DriveWatch(began_at=0.0)
    for before, after in [*changes, ("SUCCESS", "IDLE")]:
        change = {"node_name": "ClearLocalCostmap-Context", "previous_status": before, "current_status": after}
        take_tree(watch, {"event_log": [change]})
    assert watch.recoveries == "clear local costmap"


def test_the_nearest_point_in_the_polygon_is_told_with_its_bearing_and_forgotten_with_another_polygon() -> None:
    watch = DriveWatch(began_at=0.0)
    now = driving(4, watch)
    watch.monitor(1, "PolygonStop", 1.0)
    (near,) = near_in(
        {"PolygonStop.points": "[[0.4, 0.3], [0.4, -0.3], [-0.3, 0.0]]"}, "PolygonStop", [(0.3, 0.1), (1, 1)]
    )
    watch.near("PolygonStop", near)
    assert "polygon PolygonStop, with something at 0.32 m, bearing 18°" in watch.sees(now)
    watch.monitor(2, "Slow", now)
    watch.near("PolygonStop", near)
    assert watch.sees(now).endswith("polygon Slow.")


def test_a_polygon_that_is_not_free_explains_why_it_stands_until_the_monitor_itself_publishes() -> None:
    watch = DriveWatch(began_at=0.0)
    assert not watch.is_monitor_unknown(driving(4, watch, speed=0.3))
    now = driving(4, watch)
    assert watch.is_monitor_unknown(now)
    watch.occupied("PolygonStop", Near(0.32, 18.0), now)
    assert "polygon PolygonStop, with something at 0.32 m, bearing 18°" in watch.sees(now)
    assert "collision monitor" not in watch.sees(driving(5, watch, speed=0.3))
    now = driving(6, watch)
    watch.monitor(0, "", now)
    watch.occupied("PolygonStop", Near(0.32, 18.0), now)
    assert not watch.is_monitor_unknown(now)
    assert watch.sees(now).startswith("COMMANDED AND NOT MOVING")


def at_rate(hz: float, watch: DriveWatch, command: float = 0.3, begin: float = 0.0) -> float:
    """For six seconds commands at a rate, looked at five times a second, and odometry that moves."""
    for step in range(31):
        now = begin + step / 5
        watch.commanded("/cmd_vel_nav", command, 0.0, now)
        watch.counted("/cmd_vel_nav", int(hz * (now - begin)), now)
        watch.moved("/odom", 0.3, 0.0, (0.3 * now, 0.0), now)
    return begin + 6.0


def test_a_rate_is_missed_where_it_was_measured_and_not_where_recoveries_or_zeros_come() -> None:
    watch = DriveWatch(began_at=0.0)
    watch.rate("/cmd_vel_nav", 20.0)
    assert "misses its rate: 5.0 of 20 Hz on /cmd_vel_nav" in watch.sees(at_rate(5.0, watch))
    assert watch.sees(at_rate(14.0, watch, begin=10.0)) == ""
    watch.behaviour("spin", is_running=True, now=20.0)
    assert "rate" not in watch.sees(at_rate(5.0, watch, begin=20.0))
    watch.behaviour("spin", is_running=False, now=27.0)
    assert "rate" not in watch.sees(at_rate(5.0, watch, command=0.0, begin=30.0))
    unset = DriveWatch(began_at=0.0)
    assert unset.sees(at_rate(2.0, unset)) == ""


def test_recoveries_are_named_while_they_run_and_counted() -> None:
    watch = DriveWatch(began_at=0.0)
    now = driving(4, watch)
    watch.behaviour("spin", is_running=True, now=3.0)
    assert watch.sees(now) == "Nav2 recovers: spin, for 1 s."
    watch.behaviour("spin", is_running=False, now=4.0)
    watch.behaviour("spin", is_running=True, now=5.0)
    watch.behaviour("clear local costmap", is_running=True, now=5.0)
    assert watch.recoveries == "spin ×2, clear local costmap"


def test_a_way_that_became_longer_at_once_is_told_for_a_while() -> None:
    watch = DriveWatch(began_at=0.0)
    watch.remaining(1.0, 1.0)
    watch.remaining(4.0, 1.5)  # the first path, after an estimate
    now = driving(4, watch, speed=0.3)
    assert "longer" not in watch.sees(now)
    watch.remaining(4.0, now)
    watch.remaining(6.5, now + 1)
    assert "2.5 m longer" in watch.sees(now + 2)
    assert watch.sees(now + 30) == ""


def test_recoveries_back_and_forth_are_no_progress_and_half_a_metre_is() -> None:
    watch = DriveWatch(began_at=0.0)
    for step in range(200):
        watch.moved("/odom", 0.1, 0.0, (0.3 * (step % 2), 0.0), step / 10)
    assert watch.stuck_s(20.0) > 19.0
    watch.moved("/odom", 0.1, 0.0, (0.8, 0.0), 20.0)
    assert watch.stuck_s(20.0) == 0.0
