"""The curve between the points of a trajectory: what it does at most, what is refused, and what stamps become."""

from __future__ import annotations

import math
from typing import Any

import pytest

from ros2_mcp_common.policy import stamps
from ros2_mcp_common.policy.checks import Checks, Pace
from ros2_mcp_common.policy.checks import problem as problem_of
from ros2_mcp_common.policy.curves import State, extremes, roots, segment
from ros2_mcp_common.policy.rules import Limit, Rules, RuleSet
from ros2_mcp_common.policy.trajectory_limits import (
    CurveLimits,
    JointBounds,
    Joints,
    extremes_of,
    positions_at,
    problem,
    read,
)

SLOW = CurveLimits(speed=0.3, position=(-3.0, 3.0))
STAND = Joints({"a": State(0.0), "b": State(0.0)})


def trajectory(*points: tuple[float, float, float | None, float | None], names: tuple[str, ...] = ("a",)) -> Any:
    """Points of one joint, or of several that do the same: time, position, speed, acceleration."""
    return {
        "header": {"stamp": {"sec": 0, "nanosec": 0}},
        "joint_names": list(names),
        "points": [
            {
                "positions": [at] * len(names),
                "velocities": [] if speed is None else [speed] * len(names),
                "accelerations": [] if bent is None else [bent] * len(names),
                "time_from_start": {"sec": int(time), "nanosec": round(time % 1 * 1e9)},
            }
            for time, at, speed, bent in points
        ],
    }


def judged(value: Any, limits: CurveLimits = SLOW, joints: Joints = STAND) -> str:
    return problem(value, limits, lambda _: joints)


def test_the_extremes_of_a_curve_are_those_of_its_turning_points() -> None:
    cubic = segment(State(0.0, 0.5), State(0.0, 0.5), 6.0)  # there and back, from 0 to 0
    low, high = extremes(cubic.position)
    assert (low, high) == pytest.approx((-0.5 * 6 / math.sqrt(108), 0.5 * 6 / math.sqrt(108)), rel=1e-9)
    quintic = segment(State(0.0, 0.0, 0.5), State(0.0, 0.0, 0.5), 12.0)
    assert extremes(quintic.position)[1] == pytest.approx(0.5 * 144 / 32, rel=1e-9)  # 2.25 rad away from 0
    # (s - 0.2)(s - 0.5)(s - 0.9)(s - 3)
    assert roots([0.27, -2.28, 5.53, -4.6, 1.0]) == pytest.approx([0.2, 0.5, 0.9])


@pytest.mark.parametrize(
    ("points", "said"),
    [
        ([(4, 0.8, 0, None)], ""),
        ([(4, 0.81, 0, None)], "a would run at 0.3038 per second, at most 0.3 is allowed, on its way to points[0]"),
        ([(4, 1.2, None, None)], ""),
        ([(2, 0, 0, None), (8, 1.1, 0.3, None)], ""),
        ([(2, 0, 0.3, None), (8, 0, 0.3, None)], ""),
        ([(2, 0, 0, 0), (14, 0, 0, 0.6)], "a would run at"),
        ([(4, 0.8, 0, None), (30, 3.01, 0, None)], "a would be at 3.01, -3 to 3 is allowed, on its way to points[1]"),
        ([(0, 0.5, 0, None)], "to be reached at once, and 'a' is 0.5 away"),
        ([(0, 0.005, 0, None), (2, 0.1, 0, None)], ""),
        ([(2, 0, None, 0.1)], "accelerations but no velocities"),
        ([(4, 0.1, 0, None), (4, 0.2, 0, None)], "points[1].time_from_start is not later"),
        ([(-1, 0, 0, None)], "points[0].time_from_start"),
        ([(4, math.nan, 0, None)], "not finite"),
        ([(4, 0.1, 1e308, 1e308)], "a would"),
        ([], "there are no points"),
    ],
)
def test_the_whole_curve_keeps_to_its_limits(points: list[Any], said: str) -> None:
    found = judged(trajectory(*points))
    assert said in found if said else not found


def test_a_joint_that_is_named_twice_or_not_measured_or_not_allowed_is_refused() -> None:
    slow = (4, 0.1, 0, None)
    assert "named twice" in judged(trajectory(slow, names=("a", "a")))
    assert "not known where the joint 'c' is" in judged(trajectory(slow, names=("c",)))
    only_b = CurveLimits(joints={"b": JointBounds(speed=0.3)})
    assert "'a' may not be moved, only b" in judged(trajectory(slow), only_b)
    assert "bounds its speed" in judged(trajectory(slow), CurveLimits())
    uneven = trajectory(slow, names=("a", "b"))
    uneven["points"][0]["positions"] = [0.1]
    assert "1 numbers for 2 joints" in judged(uneven)


def test_the_description_holds_unless_it_is_left_out_and_the_stricter_one_counts() -> None:
    joints = Joints(STAND.measured, {"a": JointBounds(-1.57, 1.57, 0.2)})
    far, fast = trajectory((30, 2.0, 0, None)), trajectory((5, 0.9, 0, None))
    assert "-1.57 to 1.57 is allowed" in judged(far, SLOW, joints)
    assert "at most 0.2 is allowed" in judged(fast, SLOW, joints)
    without = CurveLimits(speed=0.3, position=(-3.0, 3.0), described=False)
    assert not judged(far, without, joints) and not judged(fast, without, joints)


def test_a_joint_beyond_its_range_may_come_back_and_go_no_farther() -> None:
    out = Joints({"a": State(3.1)})
    assert not judged(trajectory((8, 2.0, 0, None)), SLOW, out)
    assert not judged(trajectory((8, 3.05, 0, None), (16, 2.9, 0, None)), SLOW, out)
    assert "points[0]" in judged(trajectory((8, 3.11, 0, None)), SLOW, out)
    assert "points[2]" in judged(trajectory((0, 3.1, 0, None), (8, 2.9, 0, None), (16, 3.05, 0, None)), SLOW, out)
    moving = Joints({"a": State(3.1, 0.2)})
    assert "would be at" in judged(trajectory((8, 2.5, 0, None)), SLOW, moving)


def test_a_joint_that_turns_without_end_is_judged_both_ways_round() -> None:
    joints = Joints({"a": State(3.0)}, {"a": JointBounds(speed=1.0, wraps=True)})
    assert "would run" in judged(trajectory((4, -3.0, 0, None)), SLOW, joints)
    assert not judged(trajectory((40, -3.0, 0, None)), CurveLimits(speed=0.3), joints)


def test_speed_that_jumps_at_a_point_is_no_bounded_acceleration() -> None:
    lines = trajectory((4, 0.4, None, None), (8, 0.0, None, None))
    gentle = CurveLimits(speed=0.3, acceleration=0.5)
    assert "changes its speed at once by 0.1, at most 0 is allowed" in judged(lines, gentle)
    assert not judged(lines, CurveLimits(speed=0.3, acceleration=0.5, step=0.2))
    assert "0.2, at most 0.15" in judged(lines, CurveLimits(speed=0.3, acceleration=0.5, step=0.15))
    stands = Joints({"a": State(0.0, 0.001)})  # by an encoder's noise
    assert not judged(trajectory((4, 0.4, 0, None), (8, 0.0, 0, None)), gentle, stands)
    assert not judged(trajectory((0, 0.0, 0, None), (8, 0.4, 0, None)), gentle, stands)
    moves = Joints({"a": State(0.0, 0.05)})
    assert "at once by 0.05" in judged(trajectory((0, 0.0, 0, None), (8, 0.1, 0, None)), gentle, moves)
    assert "would accelerate by 0.9375" in judged(trajectory((0.8, 0.1, 0, None)), gentle)


def test_what_is_told_of_a_trajectory_is_what_it_does() -> None:
    path = read(trajectory((4, 0.8, 0, None), (10, -0.4, 0, None)))
    found = extremes_of(path, STAND)["a"]
    assert (found.low, found.high, found.speed) == pytest.approx((-0.4, 0.8, 0.3))
    assert positions_at(path, STAND, 2.0)["a"] == pytest.approx(0.4)
    assert positions_at(path, STAND, 99.0)["a"] == pytest.approx(-0.4)


def test_pace_holds_between_the_points_too() -> None:
    pace = Checks(pace={"points": Pace(0.3, 1.0)})
    assert not problem_of(pace, trajectory((2, 0, None, None), (4, 0.6, None, None)), {})
    assert "faster than 0.3" in problem_of(pace, trajectory((2, 0, 0, None), (4, 0.45, 0, None)), {})


def test_a_point_without_positions_has_no_pace() -> None:
    pace, blind = Checks(pace={"points": Pace(0.3, 1.0)}), trajectory((2, 0, None, None))
    blind["points"][0]["positions"] = []
    assert "points[0] has no positions" in problem_of(pace, blind, {})


def planned(way: float, speed: float = 0.29, bent: float = 0.5) -> Any:
    """A time-optimal plan from 0, sampled each 0.1 s with velocities and accelerations, as MoveIt sends it."""
    rise, total = speed / bent, way / speed + speed / bent
    found: list[tuple[float, float, float, float]] = []
    for step in range(math.ceil(total / 0.1) + 1):
        now = min(0.1 * step, total)
        if now < rise:
            found.append((now, bent * now**2 / 2, bent * now, bent))
        elif now < total - rise:
            found.append((now, speed * (now - rise / 2), speed, 0.0))
        else:
            left = total - now
            found.append((now, way - bent * left**2 / 2, bent * left, -bent))
    return trajectory(*found)


@pytest.mark.parametrize("noise", [0.0, 0.003, -0.003])
def test_a_planner_s_trajectory_passes_the_profile_for_arms(noise: float) -> None:
    profile = CurveLimits(speed=0.3, acceleration=1.0, step=0.3, position=(-3.2, 3.2))
    known = Joints({"a": State(noise, noise)}, {"a": JointBounds(-0.0, 1.2, 3.0)})
    for way in (0.3, 0.7123, 1.2):
        assert not judged(planned(way), profile, known)
    assert "would run at" in judged(planned(1.2, speed=0.31), profile, known)


def test_a_controller_without_accelerations_takes_a_cubic_to_the_first_point() -> None:
    # As a quintic from rest it needs 0.577 rad/s², as the cubic that the controller takes 0.6.
    gentle = CurveLimits(speed=1.0, acceleration=0.59, step=1.0)
    stands = Joints({"a": State(0.0, 0.0)}, {"a": JointBounds(-2.0, 2.0)})
    assert "accelerate by 0.6" in judged(trajectory((1, 0.1, 0, 0)), gentle, stands)
    assert not judged(trajectory((0, 0.0, 0, 0), (1, 0.1, 0, 0)), gentle, stands)


def test_whole_turns_count_without_the_limits_of_the_description_and_where_it_does_not_tell() -> None:
    limits = CurveLimits(speed=1.0, position=(-1.5, 7.0), described=False)
    comes = trajectory((30, 0.0, 0, None))
    moves = State(6.0, -0.9)  # on from 6.0, it comes to rest at 0; a turn lower, it first runs out to -3
    assert "would be at" in judged(comes, limits, Joints({"a": moves}, {"a": JointBounds(wraps=True)}))
    assert "would be at" in judged(comes, limits, Joints({"a": moves}))
    assert not judged(comes, limits, Joints({"a": moves}, {"a": JointBounds()}))


def test_a_first_point_at_once_is_where_the_joint_is_itself_and_not_a_turn_away() -> None:
    known = Joints({"a": State(7.0, 0.0)}, {"a": JointBounds(wraps=True)})
    limits = CurveLimits(speed=1.0)
    assert "at once, and 'a' is 6.28 away" in judged(trajectory((0, 7.0 - 2 * math.pi, 0, None)), limits, known)
    assert not judged(trajectory((0, 7.0, 0, None)), limits, known)
    moves = Joints({"a": State(7.0, 0.5)}, known.described)
    assert "0.05 away" in judged(trajectory((0, 7.0, 0, None)), limits, moves)


def test_a_joint_that_stands_at_its_limit_is_not_refused_for_the_noise_of_its_encoder() -> None:
    limits, at_end = CurveLimits(speed=0.3), Joints({"a": State(-0.0004)}, {"a": JointBounds(0.0, 1.0)})
    assert not judged(trajectory((4, -0.0006, 0, None)), limits, at_end)
    assert not judged(trajectory((0, -0.0006, 0, None), (4, 0.5, 0, None)), limits, at_end)
    assert "would be at" in judged(trajectory((4, -0.0011, 0, None)), limits, at_end)
    assert "would be at" in judged(
        trajectory((0, 0.0, 0, None), (4, 0.5, 0, None), (8, -0.0006, 0, None)), limits, at_end
    )


def test_the_limits_of_a_curve_go_down_to_the_bridge_unchanged() -> None:
    curve = CurveLimits(0.3, 0.5, 0.1, (-1.0, 1.0), {"a": JointBounds(-0.5, 0.5, 0.2, 0.1)}, described=False)
    limit = Limit("arm", ("p/action/A",), checks=Checks(curve={"trajectory": curve}))
    rules = Rules("0", (RuleSet("p", limits=(limit,), allows_all=True),))
    back = Rules.from_json(rules.as_json())
    assert back == rules
    ruling = back.ruling("goal", "/arm", "p/action/A")
    value = {"trajectory": trajectory((4, 0.8, 0, None))}
    assert ruling.curves == ["trajectory"] and ruling.needs_value
    assert "a would be at 0.8, -0.5 to 0.5" in ruling.judge(value, lambda _: STAND).problem
    assert "not known where the joints are" in ruling.judge(value).problem


NOW = 1_800_000_000 * stamps.NS_PER_S


@pytest.mark.parametrize(
    ("away_s", "said"),
    [(None, ""), (0.0, ""), (0.99, ""), (-0.99, ""), (-1.01, "1.0 s ago"), (3.0, "3.0 s ahead"), (-1e9, "s ago")],
)
def test_a_stamp_that_acts_is_zero_or_of_now(away_s: float | None, said: str) -> None:
    other = trajectory((4, 0.1, 0, None))
    value = {"goal": {"trajectory": trajectory((4, 0.1, 0, None))}, "others": [{"trajectory": other}]}
    stamp = other["header"]["stamp"]
    at = 0 if away_s is None else NOW + round(away_s * 1e9)
    stamp["sec"], stamp["nanosec"] = divmod(at, stamps.NS_PER_S)
    found = stamps.problem(value, NOW)
    assert said in found and bool(said) == bool(found)
    if found:
        assert found.startswith("others[0].trajectory.header.stamp is ")
    assert stamps.zero(value) == bool(at)
    assert stamp == {"sec": 0, "nanosec": 0}
