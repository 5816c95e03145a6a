"""Drives beside keep-out zones in simulated steps: judged as the bridge does it, observed by a judge of its own.

The robot is a unicycle that accelerates and brakes as its policy says. What it tells comes late and with noise, and a
stop comes late, too. The observer sees the true poses, and knows nothing of the bridge's geometry.
"""

from __future__ import annotations

import math
import random
from collections import deque
from dataclasses import dataclass
from typing import Any

import numpy as np

from ros2_mcp_common.policy.feedback import PoseRule, SpeedRule, Watchdog
from ros2_mcp_common.policy.field_values import Unfit
from ros2_mcp_common.policy.keep_out import KeepOut, Pose, path_of, problem_of_goal
from ros2_mcp_common.policy.polygons import what_is_wrong

STEP_S = 0.02
TOLD_LATE_S, STOPPED_LATE_S = 0.04, 0.08
"""Together with a step: the reaction time of the watchdog (`REACTION_S`)."""
NOISE_M, NOISE_RAD = 0.005, 0.005
POSE_EVERY, SPEED_EVERY = 3, 2
BRAKE, BRAKE_TURN = 1.0, 2.0
OUTLINES = (
    {"radius_m": 0.15},
    {"radius_m": 0.3},
    {"footprint": ((0.3, 0.2), (0.3, -0.2), (-0.4, -0.2), (-0.4, 0.2))},
    {"footprint": ((0.5, 0.0), (0.0, 0.15), (-0.1, 0.0), (0.0, -0.15))},
)


@dataclass
class Drive:
    """What became of one goal or path: `entries` are the steps in which the outline was in a zone."""

    refused: bool = False
    ended: bool = False
    latched: bool = False
    reached: bool = False
    entries: int = 0


def random_keep_out(rng: random.Random) -> KeepOut:
    """One to three polygons around the middle, convex or not."""
    zones: dict[str, Any] = {}
    for number in range(rng.randint(1, 3)):
        x, y = rng.uniform(-1.5, 1.5), rng.uniform(-1.5, 1.5)
        turns = sorted(rng.uniform(0, 2 * math.pi) for _ in range(rng.randint(3, 8)))
        far = [rng.uniform(0.1, 1.0) for _ in turns]
        zone = tuple((x + r * math.cos(turn), y + r * math.sin(turn)) for turn, r in zip(turns, far, strict=True))
        if not what_is_wrong(zone):
            zones[str(number)] = zone
    zones = zones or {"0": ((0.0, 0.0), (1.0, 0.0), (0.0, 1.0))}
    return KeepOut("simulated", "map", zones, margin_m=0.2, **rng.choice(OUTLINES))  # pyright: ignore[reportArgumentType]


def drive(rng: random.Random, *, is_judged: bool = True) -> Drive:
    """A goal, a path, a goal that is not judged, or velocities, of which the last two lead straight at a zone.

    It begins at a random place beside the zones.

    Without `is_judged` nothing is refused and nothing ended, which shows what the observer sees.
    """
    keep_out = random_keep_out(rng)
    while (start := Pose(rng.uniform(-2.5, 2.5), rng.uniform(-2.5, 2.5), rng.uniform(-3.1, 3.1))) and (
        not keep_out.needed_m < keep_out.nearest(start).distance_m < 0.6
    ):
        pass
    kind, result = rng.choice(("goal", "path", "hostile", "velocity")), Drive()
    corners = [rng.choice(list(keep_out.zones.values()))[0]]
    if kind in ("goal", "path"):
        corners = [(rng.uniform(-2, 2), rng.uniform(-2, 2)) for _ in range(1 if kind == "goal" else rng.randint(1, 3))]
    poses = [Pose(x, y, rng.uniform(-3.1, 3.1) if (x, y) == corners[-1] else 0.0) for x, y in corners]
    if kind in ("goal", "path") and is_judged:
        result.refused = is_refused(keep_out, start, poses)
    if result.refused:
        return result
    simulation = _Simulation(rng, keep_out, start, poses, result)
    simulation.by_goal = kind != "velocity"
    poses_seen = simulation.run(rng.uniform(2.0, 4.0), is_watched=is_judged)
    result.entries = int(entered(keep_out, np.array(poses_seen)).sum())
    return result


def is_refused(keep_out: KeepOut, start: Pose, poses: list[Pose]) -> bool:
    """As server and bridge judge a goal, and the path that a planner would give for it."""
    try:
        if problem_of_goal(keep_out, {"poses": [_stamped(pose) for pose in poses]}):
            return True
        return keep_out.entry(path_of([start._replace(yaw=0.0), *poses], keep_out.swing_m, start)) is not None
    except Unfit:
        return True


class _Simulation:
    """A robot that follows corners, a bit beside the straight lines between them, under the watchdog."""

    def __init__(self, rng: random.Random, keep_out: KeepOut, start: Pose, poses: list[Pose], result: Drive) -> None:
        self.rng, self.keep_out, self.poses, self.result = rng, keep_out, list(poses), result
        speed = SpeedRule("/odom", "t", "twist", 1.0, 1.2, 0.5, still={"linear": 0.03, "angular": 0.05})
        pose = PoseRule("/pose", "t", "pose", 1.0, BRAKE, "map", brake_radps2=BRAKE_TURN, keep_out=[keep_out])
        self.watchdog = Watchdog(speed, pose)
        self.pose, self.v, self.w = start, 0.0, 0.0
        self.fastest, self.turning = rng.uniform(0.1, 1.0), rng.uniform(0.5, 1.5)
        self.pull = rng.uniform(-0.3, 0.3)  # a controller that is drawn to one side
        self.late: deque[tuple[float, Any]] = deque()
        self.stop_at, self.again_at = math.inf, 100.2  # it has heard the robot by then
        self.has_begun, self.is_watched, self.by_goal = False, True, True

    def run(self, seconds: float, *, is_watched: bool) -> list[Pose]:
        """Drive, and return the true poses."""
        seen, now, self.is_watched = [self.pose], 100.0, is_watched
        until = now + seconds
        for number in range(int(seconds / STEP_S)):
            now += STEP_S
            self._tell(number, now)
            is_driven = now < self.stop_at and now >= self.again_at and self._may_start(now)
            self._move(now, is_driven=is_driven)
            self.watchdog.told(is_driven or abs(self.v) > 0.01, now, by_goal=self.by_goal)
            if is_watched and self.watchdog.look(now):
                self.result.ended = True
                self.result.latched = self.result.latched or self.watchdog.latches
                self.stop_at = min(self.stop_at, now + STOPPED_LATE_S)
            if self.result.latched and now > self.stop_at and not self.v:
                break
            if now > self.stop_at and not self.v and not self.w and not self.result.latched and now < until - 0.5:
                self.stop_at, self.again_at, self.has_begun = (
                    math.inf,
                    now + 0.1,
                    False,
                )  # it is sent again, as a stubborn client does
            seen.append(self.pose)
            if not self.poses:
                self.result.reached = True
                break
        return seen

    def _may_start(self, now: float) -> bool:
        """Whether the bridge lets a goal, or one that is sent again, leave: asked once before each motion."""
        if not self.has_begun and self.is_watched and self.by_goal and self.watchdog.problem_of_start(now):
            self.stop_at = self.again_at = math.inf
            return False
        self.has_begun = True
        return True

    def _tell(self, number: int, now: float) -> None:
        noise = self.rng.gauss
        if number % SPEED_EVERY == 0:
            self.late.append((now, _twist(self.v + noise(0, 0.005), self.w + noise(0, 0.01))))
        if number % POSE_EVERY == 0:
            pose = self.pose
            told = Pose(pose.x + noise(0, NOISE_M), pose.y + noise(0, NOISE_M), pose.yaw + noise(0, NOISE_RAD))
            self.late.append((now, _stamped(told)))
        while self.late and self.late[0][0] <= now - TOLD_LATE_S:
            _, message = self.late.popleft()
            if "twist" in message:
                self.watchdog.heard_speed(message, now)
            else:
                self.watchdog.heard_pose(message, "map", now)

    def _move(self, now: float, *, is_driven: bool) -> None:
        v, w = self._wanted() if is_driven else (0.0, 0.0)
        if not self.by_goal and self.is_watched and (v or w) and self.watchdog.problem_of_velocity((v, 0.0, w), now):
            v, w = 0.0, 0.0  # the bridge holds it back
            self.result.ended = True
        self.v += min(BRAKE * STEP_S, max(-BRAKE * STEP_S, v - self.v))
        self.w += min(BRAKE_TURN * STEP_S, max(-BRAKE_TURN * STEP_S, w - self.w))
        x, y, yaw = self.pose
        half = yaw + self.w * STEP_S / 2
        self.pose = Pose(
            x + self.v * STEP_S * math.cos(half), y + self.v * STEP_S * math.sin(half), yaw + self.w * STEP_S
        )

    def _wanted(self) -> tuple[float, float]:
        goal = self.poses[0]
        away_m = math.hypot(goal.x - self.pose.x, goal.y - self.pose.y)
        if away_m < 0.1:
            del self.poses[0]
            return 0.0, 0.0
        off = math.remainder(
            math.atan2(goal.y - self.pose.y, goal.x - self.pose.x) + self.pull - self.pose.yaw, 2 * math.pi
        )
        turn = min(self.turning, max(-self.turning, 2.5 * off))
        return (self.fastest if abs(off) < 0.6 else 0.0), turn


def entered(keep_out: KeepOut, poses: np.ndarray) -> np.ndarray:
    """Return for each true pose whether a point of the outline is in a zone, or one of a zone's edge in the outline."""
    turn = np.linspace(0, 2 * math.pi, 48, endpoint=False)
    base = keep_out.radius_m * np.stack([np.cos(turn), np.sin(turn)], axis=-1)
    if keep_out.footprint:
        base = _points_on(np.array(keep_out.footprint), 12)
    cos, sin = np.cos(poses[:, 2]), np.sin(poses[:, 2])
    x = poses[:, :1] + np.outer(cos, base[:, 0]) - np.outer(sin, base[:, 1])
    y = poses[:, 1:2] + np.outer(sin, base[:, 0]) + np.outer(cos, base[:, 1])
    found = np.zeros(len(poses), dtype=bool)
    for corners in keep_out.zones.values():
        zone = np.array(corners)
        found |= _inside(x, y, zone).any(axis=1)
        at = _points_on(zone, 12)
        dx, dy = at[:, 0] - poses[:, :1], at[:, 1] - poses[:, 1:2]
        ahead, left = dx * cos[:, None] + dy * sin[:, None], dy * cos[:, None] - dx * sin[:, None]
        if keep_out.footprint:
            found |= _inside(ahead, left, np.array(keep_out.footprint)).any(axis=1)
        else:
            found |= (np.hypot(ahead, left) < keep_out.radius_m).any(axis=1)
    return found


def _points_on(polygon: np.ndarray, many: int) -> np.ndarray:
    shares = np.linspace(0, 1, many, endpoint=False)[:, None, None]
    return (polygon + shares * (np.roll(polygon, -1, axis=0) - polygon)).reshape(-1, 2)


def _inside(x: np.ndarray, y: np.ndarray, polygon: np.ndarray) -> np.ndarray:
    """Return whether points are in a polygon, by its winding number."""
    number = np.zeros(x.shape, dtype=int)
    for (x1, y1), (x2, y2) in zip(polygon, np.roll(polygon, -1, axis=0), strict=True):
        left = (x2 - x1) * (y - y1) - (x - x1) * (y2 - y1)
        number += ((y1 <= y) & (y2 > y) & (left > 0)).astype(int) - ((y1 > y) & (y2 <= y) & (left < 0)).astype(int)
    return number != 0


def _twist(v: float, w: float) -> dict[str, Any]:
    zero = {"x": 0.0, "y": 0.0, "z": 0.0}
    return {"twist": {"linear": {**zero, "x": v}, "angular": {**zero, "z": w}}}


def _stamped(pose: Pose) -> dict[str, Any]:
    turn = {"x": 0.0, "y": 0.0, "z": math.sin(pose.yaw / 2), "w": math.cos(pose.yaw / 2)}
    return {"header": {"frame_id": "map"}, "pose": {"position": {"x": pose.x, "y": pose.y}, "orientation": turn}}
