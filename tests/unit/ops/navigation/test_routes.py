"""Routes and pauses: headings, results in the first line, how far a paused robot was moved."""

from __future__ import annotations

import math
from dataclasses import replace

import pytest

from ros2_mcp.model.errors import BadValue, NotFound
from ros2_mcp.ops.navigation.hold import Hold, Shift
from ros2_mcp.ops.navigation.home import FirstStood, targets_in
from ros2_mcp.ops.navigation.route import Routed, RoutePlace, _with_waits
from ros2_mcp.ops.navigation.route_plan import RoutePlan, headed, key_of
from ros2_mcp.ops.navigation.targets import Target
from ros2_mcp.ops.navigation.whereabouts import Whereabouts
from ros2_mcp.ops.stop.judge import Observation
from ros2_mcp.robot import Robot

SQUARE = [Target("", "map", x, y, None) for x, y in ((1.0, 0.0), (1.0, 1.0), (0.0, 1.0))]


def degrees(targets: list[Target]) -> list[float | None]:
    return [None if one.yaw_rad is None else round(math.degrees(one.yaw_rad)) for one in targets]


def test_a_place_with_any_heading_is_reached_as_seen_from_the_one_before() -> None:
    assert degrees(headed(SQUARE, (0.0, 0.0), "map", 1)) == [0, 90, 180]
    assert degrees(headed(SQUARE, None, "map", 1)) == [None, 90, 180]
    given = [SQUARE[0], replace(SQUARE[1], yaw_rad=0.0), Target("", "base_link", 1.0, 0.0, None), SQUARE[2]]
    assert degrees(headed(given, (0.0, 0.0), "map", 1)) == [0, 0, None, None]


def test_all_loops_have_the_same_goals() -> None:
    assert degrees(headed(SQUARE, (5.0, 5.0), "map", 2)) == [-45, 90, 180]


async def test_a_repeated_call_is_recognised_by_its_list_and_plan(robot: Robot) -> None:
    who, plan = robot.session().principal, RoutePlan(2, (1.0,), True)
    assert key_of(who, "/go", SQUARE, plan) == key_of(who, "/go", list(SQUARE), replace(plan))
    assert key_of(who, "/go", SQUARE, plan) != key_of(who, "/go", SQUARE, replace(plan, loops=3))


def test_a_place_may_have_a_wait_of_its_own() -> None:
    assert _with_waits([{"place": "a", "wait_s": 5}, {"x": 1, "y": 2}], 2.0) == (
        [{"place": "a"}, {"x": 1, "y": 2}],
        [5.0, 2.0],
    )
    for wrong in ("5", -1, math.inf, True, None, 1e6):
        with pytest.raises(BadValue):
            _with_waits([{"place": "a", "wait_s": wrong}], 0.0)


PLACE = RoutePlace(
    place="door", x_m=1.0, y_m=2.0, yaw_deg=None, frame="map", state="reached", reached=1, missed=0, duration_s=1.0
)
MISSED = replace(PLACE, place="", state="missed", reached=0, missed=1, cause="The goal is occupied.", helps="Clear it.")
ROUTED = Routed(outcome="done", action_name="/go", job_id="n", duration_s=9.0, loop=1, loops=1, places=[PLACE, MISSED])


def test_results_of_all_places_stand_in_the_first_line() -> None:
    first, helps = ROUTED.summary()
    assert first == (
        "done after 9.0 s: 1 of 2 places reached, 1 MISSED: "
        "1 «door» reached; 2 (1.00, 2.00) MISSED (The goal is occupied)."
    )
    assert helps == "What would help: Clear it."
    assert not ROUTED.has_failed and replace(ROUTED, places=[MISSED]).has_failed
    under_way = replace(PLACE, state="under way", reached=0, remaining_m=1.25)
    going = replace(ROUTED, outcome="under way", loops=2, places=[PLACE, under_way])
    assert (
        "loop 1 of 2: 1 of 4 places reached: 1 «door» reached 1×; 2 «door» under way, 1.2 m to go."
        in going.summary()[0]
    )


def test_of_a_long_list_the_first_line_names_what_is_not_just_reached() -> None:
    long = replace(ROUTED, places=[*[PLACE] * 40, MISSED, replace(PLACE, state="under way", reached=0)])
    assert long.summary()[0].count("«door»") == 1 and "41 (1.00, 2.00) MISSED" in long.summary()[0]


STANDS = Observation(verdict="observed still", sentence="Observed still: /odom.", has_base=True)
AT = Whereabouts("map", "base_link", 1.0, 2.0, 0.0, 0.1)


@pytest.mark.parametrize(
    ("shift", "is_moved", "words"),
    [
        (Shift(map_m=0.04, turned_deg=2.0, odometry_m=0.0), False, "It was not moved meanwhile (0.04 m and 2°"),
        (Shift(map_m=1.5, turned_deg=-30.0, odometry_m=1.5), True, "IT WAS MOVED meanwhile: it is 1.50 m and 30° from"),
        (Shift(map_m=1.5, turned_deg=0.0, odometry_m=0.0), True, "it was carried, or localised anew"),
        (Shift(map_m=0.0, turned_deg=40.0, odometry_m=0.0), True, "0.00 m and 40°"),
        (Shift(map_m=None, turned_deg=None, odometry_m=None), False, "not known"),
    ],
)
def test_a_robot_that_was_moved_while_it_paused_is_told(shift: Shift, is_moved: bool, words: str) -> None:
    assert shift.is_moved is is_moved and words in shift.sentence


def test_a_pause_says_whether_the_robot_was_seen_to_stand() -> None:
    hold = Hold(since=0.0, where=AT, odometry=AT, seen=STANDS)
    assert hold.sentence.startswith("The robot stands at (1.00, 2.00) in map.")
    moving = Observation(verdict="not observed", sentence="NOT observed still: /odom.", is_moving=True)
    assert "STILL MOVES" in replace(hold, seen=moving).sentence


async def test_where_no_place_is_named_home_the_error_says_how_to_name_one(robot: Robot) -> None:
    robot.kept.get(FirstStood, FirstStood).note(AT)
    robot.kept.get(FirstStood, FirstStood).note(replace(AT, x_m=9.0))
    with pytest.raises(NotFound) as refused:
        targets_in(robot, [{"place": "Home"}])
    assert 'ros2_place_set(name="home")' in refused.value.hint and "(1.00, 2.00) in map" in refused.value.hint
    with pytest.raises(NotFound) as other:
        targets_in(robot, {"place": "door"})
    assert "named home" not in str(other.value.hint) and "ros2_place_set(name=" not in other.value.hint
