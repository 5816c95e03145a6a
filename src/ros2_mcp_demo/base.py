"""The differential-drive base: acceleration limits, wheels, slip, collisions, dead reckoning. No ROS."""

# pyright: basic
from __future__ import annotations

import math
from dataclasses import dataclass

RADIUS = 0.2
WHEEL_RADIUS = 0.05
WHEEL_SEPARATION = 0.32
LINEAR_ACCELERATION = 1.0
LINEAR_BRAKING = 2.0
ANGULAR_ACCELERATION = 4.0
TICKS_PER_TURN = 4096
SLIP_STDDEV = 0.01
SLIP_TIME_S = 1.0


@dataclass
class Pose:
    """A position in m, and a heading in rad within ±π."""

    x: float = 0.0
    y: float = 0.0
    yaw: float = 0.0

    def moved(self, distance, turn):
        """Return the pose after an arc of length `distance` (m) that turns by `turn` (rad)."""
        middle = self.yaw + turn / 2
        x, y = self.x + distance * math.cos(middle), self.y + distance * math.sin(middle)
        return Pose(x, y, wrapped(self.yaw + turn))


class Wheel:
    """A driven wheel: its encoder counts whole ticks, and its slip on the ground varies slowly."""

    def __init__(self, rng):
        self._rng = rng
        self._slip = 0.0
        self._residue = 0.0
        self.angle = 0.0
        self.velocity = 0.0

    def roll(self, speed, dt):
        """Roll with the rim at `speed` (m/s); return the distance on the ground and by the encoder, both in m."""
        keep = math.exp(-dt / SLIP_TIME_S)
        self._slip = keep * self._slip + math.sqrt(1 - keep * keep) * SLIP_STDDEV * self._rng.standard_normal()
        self.velocity = speed / WHEEL_RADIUS
        ticks = self.velocity * dt / (2 * math.pi) * TICKS_PER_TURN + self._residue
        self._residue = ticks - round(ticks)
        counted = round(ticks) * 2 * math.pi / TICKS_PER_TURN
        self.angle += counted
        return speed * dt * (1.0 - self._slip), counted * WHEEL_RADIUS


class Base:
    """The moving base. `pose` is its true pose, `odometry` the pose by its encoders.

    `linear` (m/s) and `angular` (rad/s) are its velocities; `blocked`: it is commanded to move, but stands against an
    obstacle. Faults: its odometry counts `counts` of each metre and `turns` of each turn; with `are_exchanged` wheels
    it turns against its commands, which its encoders do not see.
    """

    counts, turns = 1.0, 1.0
    are_exchanged = False

    def __init__(self, world, rng, pose=None):
        self._world = world
        self.left, self.right = Wheel(rng), Wheel(rng)
        self.pose = pose or Pose()
        self.odometry = Pose()
        self.linear = self.angular = 0.0
        self.acceleration = 0.0
        self.blocked = False
        self.travelled = 0.0

    def step(self, linear, angular, dt):
        """Drive for `dt` s towards these velocities (m/s, rad/s), as far as inertia and walls allow."""
        if self.are_exchanged:
            angular = -angular
        before = self.linear
        braking = abs(linear) < abs(self.linear) or linear * self.linear < 0
        self.linear = approach(self.linear, linear, (LINEAR_BRAKING if braking else LINEAR_ACCELERATION) * dt)
        self.angular = approach(self.angular, angular, ANGULAR_ACCELERATION * dt)
        if self.linear != 0.0 and self._is_blocked_at(self.pose.moved(self.linear * dt, self.angular * dt)):
            self.linear = 0.0
        # Blocked: one centimetre further in the direction of the command would be a collision.
        self.blocked = abs(linear) > 0.01 and self._is_blocked_at(self.pose.moved(math.copysign(0.01, linear), 0.0))
        self.acceleration = (self.linear - before) / dt
        half_turn_speed = self.angular * WHEEL_SEPARATION / 2
        left, counted_left = self.left.roll(self.linear - half_turn_speed, dt)
        right, counted_right = self.right.roll(self.linear + half_turn_speed, dt)
        self.pose = self.pose.moved((left + right) / 2, (right - left) / WHEEL_SEPARATION)
        turned = (counted_right - counted_left) / WHEEL_SEPARATION
        if self.are_exchanged:
            turned = -turned
        counted = (counted_left + counted_right) / 2
        self.odometry = self.odometry.moved(self.counts * counted, self.turns * turned)
        self.travelled += abs(left + right) / 2

    def _is_blocked_at(self, pose):
        """Whether the base would collide at a pose; moving away from an obstacle is always allowed."""
        clearance = self._world.clearance(pose.x, pose.y)
        return clearance < RADIUS and clearance <= self._world.clearance(self.pose.x, self.pose.y)


def approach(value, target, step):
    """Return `value` moved towards `target` by at most `step`."""
    return value + max(-step, min(step, target - value))


def wrapped(angle):
    """Return an angle (rad) normalised to ±π."""
    return math.remainder(angle, 2 * math.pi)
