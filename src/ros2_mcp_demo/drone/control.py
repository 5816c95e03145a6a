"""Flight control: computes the acceleration towards a wanted position or velocity. Pure numbers, no ROS."""

# pyright: basic
from __future__ import annotations

import math

import numpy as np

SPEED, CLIMB, DESCENT = 5.0, 2.5, 1.5
"""Maximum speeds in missions: horizontal, up and down, in m/s; ArduCopter's defaults."""
ACCELERATION, CLIMB_ACCELERATION = 2.5, 1.5
"""Accelerations for planning, in m/s²; the rest of what the airframe can do is reserved for wind."""
BRAKING = 4.0
NEAR = 1.0
"""In 1/s: within ACCELERATION / NEAR² of the target, the speed is this times the distance."""
TRACKING, LEARNING = 3.0, 0.8
"""Proportional gain (1/s) and integral gain (1/s²) of the velocity error; the integral learns the wind."""
MOST_LEARNT = 2.5
TURNING = math.radians(90.0)


class Control:
    """Call `to_place` or `to_velocity` in each step; `speed` is the maximum speed that a mission has set (m/s)."""

    def __init__(self):
        self.speed = SPEED
        self._learnt = np.zeros(3)
        self._wanted = np.zeros(3)

    def reset(self, velocity=(0.0, 0.0, 0.0)):
        """Start from a velocity (3,) in m/s: at the beginning of a flight or of another kind of motion."""
        self._wanted = np.array(velocity, dtype=float)

    def forget_wind(self):
        """Clear the learnt wind, at the beginning of a flight."""
        self._learnt = np.zeros(3)

    def to_place(self, frame, place, dt, descent=DESCENT):
        """Return the acceleration (3,) towards a position (3,)."""
        offset = np.asarray(place) - frame.position
        distance = math.hypot(offset[0], offset[1])
        along = offset[:2] / max(distance, 1e-9) * _approach(distance, self.speed, ACCELERATION)
        climbing = _approach(abs(offset[2]), CLIMB if offset[2] > 0 else descent, CLIMB_ACCELERATION)
        return self.to_velocity(frame, np.array([*along, math.copysign(climbing, offset[2])]), dt)

    def to_velocity(self, frame, velocity, dt, acceleration=ACCELERATION):
        """Return the acceleration (3,) towards a velocity (3,); the set point changes by at most `acceleration` in
        m/s²."""
        change = np.asarray(velocity) - self._wanted
        along = math.hypot(change[0], change[1])
        change[:2] *= min(1.0, acceleration * dt / max(along, 1e-9))
        most = max(acceleration, CLIMB_ACCELERATION) * dt
        change[2] = max(-most, min(most, change[2]))
        feed_forward, self._wanted = change / dt, self._wanted + change
        error = self._wanted - frame.velocity
        self._learnt = np.clip(self._learnt + LEARNING * error * dt, -MOST_LEARNT, MOST_LEARNT)
        return 0.6 * feed_forward + TRACKING * error + self._learnt

    def turning(self, frame, heading):
        """Return the yaw rate (rad/s) towards a heading (rad)."""
        error = math.remainder(heading - frame.yaw, 2 * math.pi)
        return max(-TURNING, min(TURNING, 2.0 * error))


def _approach(distance, speed, acceleration):
    """Return the speed at a distance from the target that lets the drone stop there."""
    linear_within = acceleration / NEAR**2
    if distance <= linear_within:
        return min(speed, NEAR * distance)
    return min(speed, math.sqrt(2 * acceleration * (distance - linear_within / 2)))
