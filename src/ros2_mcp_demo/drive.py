"""One drive to a goal: plan, follow, look out, plan anew, give up. No ROS."""

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
    """The map and what was seen lately besides it."""

    def __init__(self, cells, origin, resolution):
        self._cells, self._origin, self._resolution = cells, origin, resolution
        self._known = inflated(cells != 0, KNOWN_WITHIN / resolution)
        self._seen = {}

    def see(self, points, now):
        """Remember points (n, 2) that the map does not explain, for `MEMORY_S`."""
        columns, rows = np.floor((points - self._origin) / self._resolution).astype(int).T
        on_map = (rows >= 0) & (rows < self._known.shape[0]) & (columns >= 0) & (columns < self._known.shape[1])
        points, rows, columns = points[on_map], rows[on_map], columns[on_map]
        for x, y in points[~self._known[rows, columns]]:
            self._seen[(math.floor(x / RESOLUTION), math.floor(y / RESOLUTION))] = (x, y, now)
        self._seen = {cell: seen for cell, seen in self._seen.items() if now - seen[2] < MEMORY_S}

    def costmap(self):
        """Where the robot may be, as far as is known now."""
        points = [(x, y) for x, y, _ in self._seen.values()]
        return Costmap.from_occupancy(self._cells, self._origin, self._resolution, points)


@dataclass(frozen=True)
class Goal:
    """A place in the map (m), a heading (rad) or None for any, and how near is near enough (m)."""

    x: float
    y: float
    yaw: float | None = None
    tolerance: float = 0.15


class Drive:
    """Call `step` until `outcome` is set: (reached, reason in words). `path` is the present plan."""

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
        """The velocities (m/s, rad/s) to drive with from here; `blocked`: the base was commanded to drive, but stands
        against something. Only what stops it on its way forward counts: at the beginning it may have been somebody
        else's command, and when it backs off there may be a wall behind it.
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
        """How often it backed off, or had no way where it had one before."""
        return self._bumps + self._lost

    def remaining(self, pose: Pose):
        """The way still to go in m; the straight line while there is no plan."""
        if self._pursuit is None:
            return math.dist((pose.x, pose.y), (self.goal.x, self.goal.y))
        return self._pursuit.remaining(pose)

    def _has_arrived(self, pose):
        """Well within the tolerance; once there, it stays arrived unless it is pushed out of the tolerance."""
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
        # What is nearer than 0.4 m, eight points of the way, cannot be avoided any more.
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
        """After a bump go back a little and look for another way; give up after `MOST_BUMPS`."""
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
