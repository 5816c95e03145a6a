"""Keep-out zones against an independent judge: outlines and zones sampled densely, with numpy."""

from __future__ import annotations

import math
import random
from typing import Any

import numpy as np
import pytest

from ros2_mcp_common.policy.field_values import Unfit
from ros2_mcp_common.policy.keep_out import KeepOut, Pose, along, arc, path_of, problem_of_goal, standing
from ros2_mcp_common.policy.polygons import what_is_wrong

STAIRS = ((3.0, 1.0), (4.0, 1.0), (4.0, 2.0))
POOL = ((-3.0, -3.0), (-2.0, -3.0), (-2.0, -2.0), (-2.5, -2.6), (-3.0, -2.0))  # concave
BASE = ((0.3, 0.2), (0.3, -0.2), (-0.4, -0.2), (-0.4, 0.2))
ROUND = KeepOut("p", "map", {"stairs": STAIRS, "pool": POOL}, margin_m=0.1, radius_m=0.25)
LONG = KeepOut("p", "map", {"stairs": STAIRS, "pool": POOL}, margin_m=0.1, footprint=BASE)


def sampled_edges(polygon: np.ndarray, step_m: float) -> np.ndarray:
    """Points along the edges of polygons (…, corners, 2), so many that none is farther than `step_m` from the next."""
    after = np.roll(polygon, -1, axis=-2)
    many = max(2, int(np.linalg.norm(after - polygon, axis=-1).max() / step_m) + 1)
    shares = np.linspace(0, 1, many, endpoint=False)[:, None]
    points = polygon[..., :, None, :] + shares * (after - polygon)[..., :, None, :]
    return points.reshape(*polygon.shape[:-2], -1, 2)


def winds_around(points: np.ndarray, polygon: np.ndarray) -> np.ndarray:
    """Whether the polygon's corners, seen from a point, go round it: another test than counted crossings."""
    to = polygon - points[..., None, :]
    angles = np.arctan2(to[..., 1], to[..., 0])
    turns = np.diff(np.concatenate([angles, angles[..., :1]], axis=-1), axis=-1)
    return np.abs(((turns + math.pi) % (2 * math.pi) - math.pi).sum(axis=-1)) > math.pi


def outline_at(keep_out: KeepOut, pose: Pose) -> np.ndarray:
    turn = np.linspace(0, 2 * math.pi, 90, endpoint=False)
    round_base = keep_out.radius_m * np.stack([np.cos(turn), np.sin(turn)], axis=-1)
    base = np.array(keep_out.footprint) if keep_out.footprint else round_base
    cos, sin = math.cos(pose.yaw), math.sin(pose.yaw)
    return base @ np.array([[cos, sin], [-sin, cos]]) + [pose.x, pose.y]


def sampled_distance(keep_out: KeepOut, pose: Pose, step_m: float = 0.02) -> float:
    """The distance of the nearest zone, from above by at most `step_m`; 0 where outline and zone overlap."""
    outline, nearest = outline_at(keep_out, pose), math.inf
    for corners in keep_out.zones.values():
        zone = np.array(corners)
        ours, theirs = sampled_edges(outline, step_m), sampled_edges(zone, step_m)
        if winds_around(ours, zone).any() or winds_around(theirs, outline).any():
            return 0.0
        nearest = min(nearest, float(np.linalg.norm(ours[:, None] - theirs[None], axis=-1).min()))
    return nearest


def random_zone(rng: random.Random) -> tuple[tuple[float, float], ...]:
    """A polygon with three to nine corners around a centre, convex or not, that does not cross itself."""
    x, y, many = rng.uniform(-2, 2), rng.uniform(-2, 2), rng.randint(3, 9)
    turns = sorted(rng.uniform(0, 2 * math.pi) for _ in range(many))
    far = [rng.uniform(0.2, 1.5) for _ in turns]
    return tuple((x + r * math.cos(turn), y + r * math.sin(turn)) for turn, r in zip(turns, far, strict=True))


def random_pose(rng: random.Random) -> Pose:
    return Pose(rng.uniform(-4, 4), rng.uniform(-4, 4), rng.uniform(-4, 4))


def random_keep_out(rng: random.Random) -> KeepOut:
    zones: dict[str, Any] = {}
    while len(zones) < 3:
        if not what_is_wrong(zone := random_zone(rng)):
            zones[str(len(zones))] = zone
    size: Any = {"footprint": BASE} if rng.random() < 0.5 else {"radius_m": rng.uniform(0.1, 0.5)}
    return KeepOut("p", "map", zones, margin_m=0.1, **size)


def test_the_distance_from_the_nearest_zone_is_that_of_sampled_outlines() -> None:
    rng = random.Random(41)
    overlaps = 0
    for _ in range(100):
        keep_out, pose = random_keep_out(rng), random_pose(rng)
        told, sampled = keep_out.nearest(pose).distance_m, sampled_distance(keep_out, pose)
        overlaps += told == 0.0
        assert told <= sampled + 0.002, "never farther than it is"
        assert sampled - told < 0.03
    assert 3 < overlaps < 90


def test_a_way_that_counts_as_clear_is_clear_wherever_it_is_sampled() -> None:
    rng = random.Random(7)
    clear = 0
    for number in range(60):
        keep_out, start = random_keep_out(rng), random_pose(rng)
        if number % 2:
            way = along([start, random_pose(rng), random_pose(rng)], keep_out.swing_m)
        else:
            heading, length_m, turn_rad = start.yaw + rng.choice((0, math.pi)), rng.uniform(0, 2), rng.uniform(-4, 4)
            way = arc(start, heading, length_m, turn_rad, keep_out.swing_m)
        entered = keep_out.entry(way)
        least_m = min(keep_out.nearest(way.at(share)).distance_m for share in np.linspace(0, 1, 51))
        if entered is None:
            clear += 1
            assert least_m >= keep_out.needed_m
            assert sampled_distance(keep_out, way.at(rng.random())) >= keep_out.needed_m - 0.002
        else:
            assert least_m < keep_out.needed_m + way.travel_m / 50 + 0.011, "refused for 1 cm at most"
            assert entered.zone in keep_out.zones
    assert 6 < clear < 54


@pytest.mark.parametrize(
    ("wrong", "why"),
    [
        ([(0, 0), (1, 0)], "three points"),
        ([(0, 0), (1, 0), (2, 0)], "overlap"),
        ([(0, 0), (2, 2), (2, 0), (0, 2)], "cross"),
        ([(0, 0), (1, 0), (1, 0), (0, 1)], "twice"),
        ([(0, 0), (4, 0), (4, 4), (2, 0), (0, 4)], "cross"),
        ([(0, 0), (math.nan, 0), (1, 1)], "not finite"),
        ([(0, 0), (1e9, 0), (1, 1)], "1,000 km"),
        ([(math.cos(n / 101 * 6.283), math.sin(n / 101 * 6.283)) for n in range(101)], "100 points"),
        ([(0, 0), (1, 0), (0.2, 0), (0, 1)], "overlap"),
    ],
)
def test_what_is_no_polygon_is_told(wrong: list[tuple[float, float]], why: str) -> None:
    assert why in what_is_wrong(wrong)


@pytest.mark.parametrize("right", [STAIRS, POOL, BASE, tuple(reversed(POOL))])
def test_polygons_of_either_direction_and_with_dents_are_right(right: tuple[tuple[float, float], ...]) -> None:
    assert not what_is_wrong(right)


def stamped(x: float, y: float, yaw: float = 0.0, frame_id: str = "map") -> dict[str, Any]:
    turn = {"x": 0.0, "y": 0.0, "z": math.sin(yaw / 2), "w": math.cos(yaw / 2)}
    return {
        "header": {"stamp": {"sec": 0, "nanosec": 0}, "frame_id": frame_id},
        "pose": {"position": {"x": x, "y": y, "z": 0.0}, "orientation": turn},
    }


def judged(keep_out: KeepOut, goal: dict[str, Any]) -> str:
    try:
        return problem_of_goal(keep_out, goal)
    except Unfit as unfit:
        return str(unfit)


def test_the_whole_outline_counts_not_the_goal_alone() -> None:
    assert not judged(ROUND, {"pose": stamped(3.5, 0.64), "behavior_tree": ""})
    assert "0.09 m from the keep-out zone stairs at (3.50, 0.66)" in judged(ROUND, {"pose": stamped(3.5, 0.66)})
    assert "in the keep-out zone stairs" in judged(ROUND, {"pose": stamped(3.8, 1.2)})
    assert not judged(LONG, {"pose": stamped(3.5, 0.69, 0.0)}), "beside it, parallel"
    assert "stairs" in judged(LONG, {"pose": stamped(3.5, 0.69, math.pi / 2)}), "turned towards it"
    assert not judged(LONG, {"pose": stamped(3.5, 0.59, math.pi / 2)})
    assert "stairs" in judged(LONG, {"pose": stamped(3.5, 0.59, -math.pi / 2)}), "its rear is longer"


@pytest.mark.parametrize(
    "goal",
    [
        {"pose": stamped(0, 0, frame_id="odom")},
        {"pose": stamped(0, 0, frame_id="/map")},
        {"pose": stamped(0, 0, frame_id="")},
        {"pose": stamped(math.nan, 0)},
        {"pose": stamped(0, math.inf)},
        {"pose": stamped(1e300, 0)},
        {"poses": [stamped(0, 0), stamped(3.5, 1.2)]},
        {"poses": {"header": {"frame_id": "map"}, "goals": [stamped(0, 0), stamped(3.5, 1.2)]}},
        {"poses": [stamped(0, 0)] * 20_001},
        {"poses": "map"},
        {"gps_poses": [{"position": {"latitude": 1.0, "longitude": 2.0, "altitude": 0.0}}]},
        {"path": {"header": {"frame_id": "map"}, "poses": [stamped(2, 0.9), stamped(5, 2.2)]}},
        {"path": {"header": {"frame_id": "map"}, "poses": [stamped(0, 0), stamped(0, 0, frame_id="odom")]}},
        {"use_dock_id": False, "dock_id": "", "dock_pose": stamped(3.8, 1.3)},
        {"target": 3},
    ],
)
def test_goals_that_lead_into_a_zone_or_cannot_be_judged_are_refused(goal: dict[str, Any]) -> None:
    assert judged(ROUND, goal)


@pytest.mark.parametrize(
    "goal",
    [
        {"pose": stamped(0, 0)},
        stamped(0, 0),
        {"poses": [stamped(0, 0), stamped(1, 1)]},
        {"path": {"header": {"frame_id": "map"}, "poses": [stamped(0, 0), stamped(2, 2), stamped(4, 2.4)]}},
        {"path": {"header": {"frame_id": "map"}, "poses": []}},
        {"use_dock_id": True, "dock_id": "home", "dock_pose": stamped(3.8, 1.3)},
    ],
)
def test_goals_past_the_zones_are_allowed(goal: dict[str, Any]) -> None:
    assert not judged(ROUND, goal)


def test_a_path_through_the_corner_of_a_zone_is_refused_however_far_apart_its_poses_are() -> None:
    corner = [Pose(2.5, 0.5, 0.0), Pose(4.5, 1.5, 0.0)]
    assert ROUND.entry(path_of(corner, ROUND.swing_m))
    assert ROUND.entry(path_of([Pose(-9, -2.5, 0), Pose(9, -2.5, 0)], 0.0)), "through the whole of a zone"
    assert ROUND.entry(path_of([Pose(-9, -3.4, 0), Pose(9, -3.4, 0)], 0.0)) is None


def test_a_turn_on_the_spot_beside_a_zone_sweeps_what_sticks_out() -> None:
    beside = Pose(3.5, 0.69, 0.0)
    assert LONG.entry(standing(beside)) is None
    assert LONG.entry(along([beside, Pose(3.5, 0.69, math.pi)], LONG.swing_m)), "its rear swings through the zone"
    through = path_of([Pose(3.5, 0.69, 0.0), Pose(3.5, -2.0, 0.0)], LONG.swing_m, start=beside)
    assert LONG.entry(through), "so does the first turn of a path that leads away at a right angle"


def test_zones_that_touch_leave_no_gap_between_them() -> None:
    both = {"left": ((-1.0, 0.0), (0.0, 0.0), (0.0, 1.0), (-1.0, 1.0)), "right": ((0.0, 0.0), (1.0, 0.0), (1.0, 1.0))}
    thin = KeepOut("p", "map", both, margin_m=0.0, radius_m=0.01)
    assert thin.entry(along([Pose(0.0, -1.0, 0.0), Pose(0.0, 2.0, 0.0)], 0.0))


def test_a_path_so_long_beside_a_zone_that_judging_it_takes_too_long_is_refused() -> None:
    wall = KeepOut("p", "map", {"wall": ((0, 0), (2000, 0), (2000, 1), (0, 1))}, margin_m=0.1, radius_m=0.25)
    with pytest.raises(Unfit, match="too long beside the zone wall"):
        wall.entry(along([Pose(0, -0.356, 0), Pose(2000, -0.356, 0)], 0.0))
    assert wall.entry(along([Pose(0, -0.6, 0), Pose(400, -0.6, 0)], 0.0)) is None
