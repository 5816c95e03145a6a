"""Keep-out zones: whether the robot's outline enters a zone at a pose, on a path, or before the robot can stop.

Needs no ROS. Server and bridge judge goals, paths and motions by the same functions. Every judgement is conservative:
between two poses the outline counts as clear only if the distance that its points travel proves it.
"""

from __future__ import annotations

import bisect
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import accumulate, pairwise
from typing import Any, NamedTuple

from ros2_mcp_common.geometry import yaw_rad
from ros2_mcp_common.policy.field_values import Unfit, fields_of, frame_id_of, get, is_list, number_at
from ros2_mcp_common.policy.polygons import FARTHEST_M, Polygon, between, distance, is_inside, moved
from ros2_mcp_common.wire.limits import MAX_JUDGED_ELEMENTS

# A motion is divided until no point of the outline travels farther than this between two judged poses. What is then
# still not proven to be clear counts as an entry, so a path may be refused for 5 mm too little.
RESOLUTION_M = 0.005
# Outlines that touch a zone count as inside it, also if a policy asks for no margin.
TOUCHING_M = 0.001
# Goals and paths keep the whole margin. What drives the robot is ended so that it comes to a stand at this share of it:
# the rest is for a pose that is not exact.
WATCHED_SHARE = 0.5
# A robot that is nearer than this share was not stopped in time: nothing may drive it but an operator.
LATCHED_SHARE = 0.25
# A robot nearer than the watched share may leave: it may come this much nearer, which covers the noise of its pose.
LEAVES_M = 0.01
# From when a robot begins to move until it is told to stop: the watchdog's reaction, and the period of what it hears.
STARTS_S = 0.2
# The most poses judged for one value or one look, so that the bridge is not held up: 0.1 to 0.3 s. A path of 25 m that
# runs along the margin of a zone all the time needs so many; one that keeps 0.1 m more needs 250.
MOST_POSES = 5_000
# The most zones of a policy, for the same reason.
MOST_ZONES = 50

GOALS = (
    "nav2_msgs/action/NavigateToPose",
    "nav2_msgs/action/NavigateThroughPoses",
    "nav2_msgs/action/FollowWaypoints",
    "nav2_msgs/action/FollowGPSWaypoints",
    "nav2_msgs/action/FollowPath",
    "nav2_msgs/action/DockRobot",
    "opennav_docking_msgs/action/DockRobot",
)
"""The goals that send a robot to places. Those of FollowGPSWaypoints are in no frame of a zone, so they are refused."""
STANDING_GOALS = (
    "nav2_msgs/action/ComputePathToPose",
    "nav2_msgs/action/ComputePathThroughPoses",
    "nav2_msgs/action/ComputeRoute",
    "nav2_msgs/action/SmoothPath",
    "nav2_msgs/action/Wait",
    "control_msgs/action/*",
    "moveit_msgs/action/*",
)
"""The goals that do not move a robot's base."""
STRAIGHT_GOALS: Mapping[str, int] = {"nav2_msgs/action/DriveOnHeading": 1, "nav2_msgs/action/BackUp": -1}
"""The goals that drive straight by `target.x` m: ahead (1) or back (-1), whatever its sign."""
GOAL_TOPICS = ("/**/goal_pose", "/**/move_base_simple/goal")
POSE_STAMPED = "geometry_msgs/msg/PoseStamped"
"""A message of this type on one of these topics is a goal for Nav2."""
_FIELDS = ("pose", "poses", "path", "gps_poses", "dock_pose")
"""The fields of these goals that hold the places."""


class Pose(NamedTuple):
    """A pose in the plane: metres and radians."""

    x: float
    y: float
    yaw: float


class Near(NamedTuple):
    """The zone that is nearest to the outline, and the distance between both in m (0: they overlap)."""

    zone: str
    distance_m: float


class Entry(NamedTuple):
    """Where the outline comes too near to a zone: the pose of the robot, the zone, the distance in m."""

    zone: str
    pose: Pose
    distance_m: float

    def __str__(self) -> str:
        return self.told("would be")

    def told(self, verb: str) -> str:
        """Return in words where the outline is, or would be."""
        away = "in" if self.distance_m <= TOUCHING_M else f"{self.distance_m:.2f} m from"
        where = f"at ({self.pose.x:.2f}, {self.pose.y:.2f})"
        return f"the robot's outline {verb} {away} the keep-out zone {self.zone} {where}"


@dataclass(frozen=True)
class KeepOut:
    """The zones that the robot's outline may not enter, in metres of the frame `frame_id`.

    The outline is `footprint`, a polygon in the frame of the robot's base, or without one a circle of `radius_m` around
    the base. It has to keep `margin_m` from every zone. `plan` is the topic of the path that is being followed.
    """

    rule: str
    frame_id: str
    zones: Mapping[str, Polygon]
    margin_m: float
    radius_m: float = 0.0
    footprint: Polygon = ()
    plan: str = ""

    @cached_property
    def reach_m(self) -> float:
        """The largest distance of the outline from the base, in m."""
        return max((math.hypot(*corner) for corner in self.footprint), default=self.radius_m)

    @property
    def swing_m(self) -> float:
        """How far the outline swings out as the robot turns, in m: a circle does not."""
        return self.reach_m if self.footprint else 0.0

    @property
    def needed_m(self) -> float:
        """The distance that the outline has to keep."""
        return max(self.margin_m, TOUCHING_M)

    @property
    def watched_m(self) -> float:
        """The distance from a zone at which the robot comes to a stand when the watchdog ends what drives it; if it is
        nearer, it may only be driven away.
        """
        return self.needed_m * WATCHED_SHARE

    @property
    def latched_m(self) -> float:
        """The distance below which only an operator may drive the robot."""
        return self.needed_m * LATCHED_SHARE

    def least_margin_m(self, brake_mps2: float, brake_radps2: float) -> float:
        """Return the least margin for a robot that accelerates and brakes at these rates: half of it is how far its
        outline moves before it is stopped.
        """
        return (brake_mps2 + brake_radps2 * self.swing_m) * STARTS_S**2 / WATCHED_SHARE

    def nearest(self, pose: Pose, enough_m: float = math.inf) -> Near:
        """Return the zone nearest to the outline of a robot at this pose, and how near it is.

        A distance of more than `enough_m` may be told too small, which is quicker.
        """
        found = Near("", math.inf)
        corners: Polygon | None = None
        for name, polygon in self.zones.items():
            away_m = 0.0 if is_inside(pose.x, pose.y, polygon) else distance(pose.x, pose.y, polygon)
            if away_m - self.reach_m >= found.distance_m:
                continue
            if away_m - self.reach_m >= enough_m:
                away_m -= self.reach_m
            elif self.footprint:
                corners = corners or moved(self.footprint, *pose)
                away_m = 0.0 if not away_m else between(corners, polygon)
            else:
                away_m = max(0.0, away_m - self.radius_m)
            if away_m < found.distance_m or not found.zone:
                found = Near(name, away_m)
        return found

    def entry(self, way: Way, needed_m: float | None = None) -> Entry | None:
        """Return a place on the way where the outline comes nearer to a zone than `needed_m` (default: the margin).

        Raises:
            Unfit: if so much of the way is near to zones that judging it takes too long.
        """
        needed_m = self.needed_m if needed_m is None else needed_m
        pending, judged = [(0.0, 1.0)], 0
        while pending:
            start, end = pending.pop()
            pose = way.at((start + end) / 2)
            slack_m = way.travel_m * (end - start) / 2
            near = self.nearest(pose, needed_m + slack_m)
            judged += 1
            if near.distance_m - slack_m >= needed_m:
                continue
            if near.distance_m < needed_m or slack_m <= RESOLUTION_M:
                return Entry(near.zone, pose, near.distance_m)
            if judged >= MOST_POSES:
                raise Unfit(f"the path is too long beside the zone {near.zone} to be judged")
            pending += [((start + end) / 2, end), (start, (start + end) / 2)]
        return None

    def entered_from(self, here: Near, way: Way, needed_m: float | None = None) -> Entry | None:
        """Return where the outline comes nearer than `needed_m` on a way, for a robot that is as near as `here` now.

        One that is nearer already may only leave.
        """
        needed_m = self.needed_m if needed_m is None else needed_m
        if here.distance_m - way.travel_m >= needed_m:
            return None
        return self.entry(way, min(needed_m, here.distance_m - LEAVES_M))


class Way(NamedTuple):
    """A motion of the robot: `at` gives the pose for each share from 0 to 1 of it.

    No point of the outline travels farther than `travel_m` in all, nor farther than that share of it in any part.
    """

    at: Callable[[float], Pose]
    travel_m: float


def standing(pose: Pose) -> Way:
    """Return the way of a robot that stays at a pose."""

    def at(_share: float) -> Pose:
        return pose

    return Way(at, 0.0)


def along(poses: Sequence[Pose], reach_m: float) -> Way:
    """Return the way over these poses: straight from one pose to the next, while the heading turns the shorter way
    round.

    `reach_m` is how far the outline swings out as it turns.
    """
    costs = [_cost(one, other, reach_m) for one, other in pairwise(poses)]
    ends = list(accumulate(costs))
    total = ends[-1] if ends else 0.0
    if not total:
        return standing(poses[0])

    def at(share: float) -> Pose:
        reached = share * total
        place = min(bisect.bisect_left(ends, reached), len(ends) - 1)
        one, other = poses[place], poses[place + 1]
        part = 1.0 - (ends[place] - reached) / costs[place] if costs[place] else 1.0
        turn = math.remainder(other.yaw - one.yaw, 2 * math.pi)
        return Pose(one.x + part * (other.x - one.x), one.y + part * (other.y - one.y), one.yaw + part * turn)

    return Way(at, total)


def arc(start: Pose, heading: float, length_m: float, turn_rad: float, reach_m: float) -> Way:
    """Return the way of a robot that moves in a direction (rad, in the frame of the zones) while both turn evenly.

    `reach_m` is how far the outline swings out as it turns.
    """

    def at(share: float) -> Pose:
        turned, far = turn_rad * share, length_m * share
        # The chord of the arc; sin(x)/x, which is 1 for a straight line.
        half = turned / 2
        chord = far * (math.sin(half) / half if abs(half) > 1e-9 else 1.0)
        x, y = start.x + chord * math.cos(heading + half), start.y + chord * math.sin(heading + half)
        return Pose(x, y, start.yaw + turned)

    return Way(at, length_m + reach_m * abs(turn_rad))


def _cost(one: Pose, other: Pose, reach_m: float) -> float:
    turn = abs(math.remainder(other.yaw - one.yaw, 2 * math.pi))
    return math.hypot(other.x - one.x, other.y - one.y) + reach_m * turn


# ── values ─────────────────────────────────────────────────────────────────────────────────────────────────────────


def problem_of_goal(keep_out: KeepOut, goal: Any) -> str:
    """Return why a robot may not be sent to the places of a goal, of a type in `GOALS` or a PoseStamped; "" if it may.

    What cannot be judged is refused: another frame, numbers that are not finite, no field with a pose.

    Raises:
        Unfit: if the goal cannot be judged.
    """
    fields = fields_of(goal)
    if "use_dock_id" in fields and get(goal, "use_dock_id"):
        return ""  # only the docking server knows where that dock is
    name = next((name for name in _FIELDS if name in fields), "")
    if not name:
        raise Unfit("there is no pose that could be judged by the keep-out zones")
    frame_id, found = frame_id_of(goal), get(goal, name)
    frame_id = frame_id_of(found) or frame_id
    if name == "path":
        poses = [_pose(f"path.poses[{place}]", each, frame_id, keep_out) for place, each in enumerate(_list(found))]
        entered = keep_out.entry(path_of(poses, keep_out.swing_m)) if poses else None
        return f"path: {entered}" if entered else ""
    shown = [name] if name in ("pose", "dock_pose") else [f"{name}[{place}]" for place in range(len(_list(found)))]
    for here, each in zip(shown, [found] if name in ("pose", "dock_pose") else _list(found), strict=True):
        if entered := keep_out.entry(standing(_pose(here, each, frame_id, keep_out))):
            return f"{here}: {entered}"
    return ""


def _list(value: Any) -> Sequence[Any]:
    """Return the poses of a list, of a Path, or of Nav2's Goals."""
    found = next((get(value, name) for name in ("poses", "goals") if name in fields_of(value)), value)
    if not is_list(found):
        raise Unfit("there is no list of poses that could be judged by the keep-out zones")
    if len(found) > MAX_JUDGED_ELEMENTS:
        raise Unfit(f"there are {len(found)} poses, more than the {MAX_JUDGED_ELEMENTS} that are judged")
    return found


def _pose(shown: str, value: Any, frame_id: str, keep_out: KeepOut) -> Pose:
    """Return a Pose or PoseStamped. Raise `Unfit` if it is in another frame, or has a number that is not finite."""
    frame_id = frame_id_of(value) or frame_id
    if frame_id != keep_out.frame_id:
        judged = f"the keep-out zones are in {keep_out.frame_id!a}, and nothing else can be judged"
        raise Unfit(f"{shown} is in the frame {frame_id[:40]!a}: {judged}")
    pose = get(value, "pose") if "pose" in fields_of(value) else value
    position, orientation = get(pose, "position"), get(pose, "orientation")
    x, y = (number_at(position, axis, f"{shown}.position.{axis}") for axis in ("x", "y"))
    yaw = yaw_rad(*(number_at(orientation, axis, f"{shown}.orientation.{axis}") for axis in ("x", "y", "z", "w")))
    if not (abs(x) < FARTHEST_M and abs(y) < FARTHEST_M and math.isfinite(yaw)):
        raise Unfit(f"{shown} is not a finite pose")
    return Pose(x, y, yaw)


def poses_of(keep_out: KeepOut, path: Any) -> Sequence[Pose]:
    """Return the poses of a nav_msgs/msg/Path. Raise `Unfit` if it is in another frame, or a number is not finite."""
    frame_id = frame_id_of(path)
    return [_pose(f"poses[{place}]", each, frame_id, keep_out) for place, each in enumerate(_list(path))]


def path_of(poses: Sequence[Pose], reach_m: float, start: Pose | None = None) -> Way:
    """Return the way of a robot that follows a planner's path of at least one pose, from where it stands if `start` is
    known. `reach_m` is how far its outline swings out as it turns.

    Many planners give every pose but the last one the same heading. Then the robot is assumed to face along the path,
    and to turn on the spot at corners.
    """
    places = [pose for place, pose in enumerate(poses) if not place or pose[:2] != poses[place - 1][:2]]
    if not places:
        return standing(poses[-1])
    has_headings = len({round(pose.yaw, 3) for pose in places[:-1]}) > 1
    turns: list[Pose] = [start] if start else []
    for one, other in pairwise(places):
        heading = math.atan2(other.y - one.y, other.x - one.x)
        turns += [one] if has_headings else [Pose(one.x, one.y, heading), Pose(other.x, other.y, heading)]
    return along([*turns, poses[-1]], reach_m)


def keep_out_of(value: Mapping[str, Any]) -> KeepOut:
    """Return keep-out zones from JSON. Raise `KeyError`, `TypeError` or `ValueError` if it has another structure."""
    zones = {name: _polygon(corners) for name, corners in value["zones"].items()}
    more: dict[str, Any] = {"zones": zones, "footprint": _polygon(value["footprint"])}
    return KeepOut(**{**value, **more})


def _polygon(corners: Any) -> Polygon:
    return tuple((float(x), float(y)) for x, y in corners)
