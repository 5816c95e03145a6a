"""Drives to a goal: plans, follows the path, watches for obstacles, plans again, gives up. No ROS."""

# pyright: basic
from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from .base import Pose, wrapped
from .planner import RESOLUTION, Costmap, Pursuit, inflated, plan

PATIENCE_S = 5.0
LOOK_EVERY_S = 0.4
MEMORY_S = 10.0
BACK_OFF_S, BACK_OFF_SPEED = 1.0, 0.12
MOST_BUMPS = 3
YAW_TOLERANCE = 0.06
KNOWN_WITHIN = 0.15


class Surroundings:
    """The map and the obstacles seen recently."""

    def __init__(self, cells, origin, resolution):
        self._cells, self._origin, self._resolution = cells, origin, resolution
        self._known = inflated(cells != 0, KNOWN_WITHIN / resolution)
        self._seen = {}

    def see(self, points, now):
        """Store the points (n, 2) in m that are not on the map, for `MEMORY_S`."""
        columns, rows = np.floor((points - self._origin) / self._resolution).astype(int).T
        on_map = (rows >= 0) & (rows < self._known.shape[0]) & (columns >= 0) & (columns < self._known.shape[1])
        points, rows, columns = points[on_map], rows[on_map], columns[on_map]
        for x, y in points[~self._known[rows, columns]]:
            self._seen[(math.floor(x / RESOLUTION), math.floor(y / RESOLUTION))] = (x, y, now)
        self._seen = {cell: seen for cell, seen in self._seen.items() if now - seen[2] < MEMORY_S}

    def costmap(self):
        """Return the costmap of the map and the stored points."""
        points = [(x, y) for x, y, _ in self._seen.values()]
        return Costmap.from_occupancy(self._cells, self._origin, self._resolution, points)


@dataclass(frozen=True)
class Goal:
    """A position in the map (m), a heading (rad; None for any), and the tolerance of the position (m)."""

    x: float
    y: float
    yaw: float | None = None
    tolerance: float = 0.15


class Drive:
    """A drive: call `step` until `outcome` is set, to (is it reached, reason in words). `path` is the current plan."""

    def __init__(self, goal, surroundings, now):
        self.goal = goal
        self.outcome = None
        self.state = "planning"
        self.replans = -1
        self.path = []
        self._surroundings = surroundings
        self._pursuit = None
        self._arrived = False
        self._next_look = now
        self._mark, self._marked_at = Pose(math.inf), now  # no place yet
        self._back_off_until, self._bumps, self._lost = 0.0, 0, 0
        self._forward = False

    def step(self, pose: Pose, now, blocked, fastest, turning):
        """Return the next velocities (m/s, rad/s).

        `blocked`: the base is commanded to drive, but stands against an obstacle. It counts only while this drive moves
        forward: at the beginning it may result from another node's command, and when backing off from a wall behind.
        """
        linear, angular = self._velocity(pose, now, blocked and self._forward, fastest, turning)
        self._forward = linear > 0.0
        return linear, angular

    def _velocity(self, pose, now, blocked, fastest, turning):
        arrived = self._has_arrived(pose)
        if not arrived and now >= self._next_look:
            self._next_look = now + LOOK_EVERY_S
            self._look(pose)
        self._watch_progress(pose, now)
        if arrived:
            return self._turn_to_heading(pose, turning)
        if blocked or now < self._back_off_until:
            return self._back_off(now, blocked)
        if self.outcome or self._pursuit is None:
            return 0.0, 0.0
        linear, angular = self._pursuit.velocity(pose, fastest, turning)
        self.state = "driving" if linear > 0 else "turning"
        return linear, angular

    @property
    def recoveries(self):
        """The number of times the robot backed off, or lost its path."""
        return self._bumps + self._lost

    def remaining(self, pose: Pose):
        """Return the remaining length of the path in m; without a plan, the straight distance."""
        if self._pursuit is None:
            return math.dist((pose.x, pose.y), (self.goal.x, self.goal.y))
        return self._pursuit.remaining(pose)

    def _has_arrived(self, pose):
        """Whether the robot is well within the tolerance; once arrived, it stays so until it leaves the tolerance."""
        reach = self.goal.tolerance * (1.0 if self._arrived else 0.8)
        self._arrived = math.dist((pose.x, pose.y), (self.goal.x, self.goal.y)) <= reach
        return self._arrived

    def _turn_to_heading(self, pose, turning):
        error = 0.0 if self.goal.yaw is None else wrapped(self.goal.yaw - pose.yaw)
        if abs(error) <= YAW_TOLERANCE:
            self.outcome = (True, "arrived")
            return 0.0, 0.0
        self.state = "turning"
        return 0.0, math.copysign(min(turning, 0.1 + 1.5 * abs(error)), error)

    def _look(self, pose):
        costmap = self._surroundings.costmap()
        # Obstacles nearer than 0.4 m, eight points of the path, cannot be avoided any more.
        if self._pursuit is not None and all(costmap.is_free(x, y) for x, y in self._pursuit.ahead()[8:]):
            return
        path = plan(costmap, (pose.x, pose.y), (self.goal.x, self.goal.y))
        self.replans += 1
        if path is None:
            self._lost += self.state != "replanning"
            self.state, self._pursuit, self.path = "replanning", None, []
        else:
            self.path, self._pursuit = path, Pursuit(path)

    def _back_off(self, now, blocked):
        """Back off a little after a collision and replan; give up after `MOST_BUMPS`."""
        if blocked and now >= self._back_off_until:
            self._bumps += 1
            self._back_off_until = self._next_look = now + BACK_OFF_S
            self.state, self._pursuit = "replanning", None
            if self._bumps > MOST_BUMPS:
                self.outcome = (False, f"the base was blocked {self._bumps} times")
        return -BACK_OFF_SPEED, 0.0

    def _watch_progress(self, pose, now):
        """Give up when the base has stood still for `PATIENCE_S`."""
        mark = self._mark
        has_turned = abs(wrapped(pose.yaw - mark.yaw)) > 0.05
        if has_turned or math.dist((mark.x, mark.y), (pose.x, pose.y)) > 0.03:
            self._mark, self._marked_at = pose, now
        elif now - self._marked_at > PATIENCE_S:
            cause = "the base does not move" if self._pursuit else "no free way to the goal"
            self.outcome = (False, f"gave up after {PATIENCE_S:g} s: {cause}")
