"""The dynamics of the quadcopter: thrust with inertia, wind, drag, the ground, and its battery. Pure numbers, no ROS.

Metres, seconds and radians; x east, y north, z up from the start position.
"""

# pyright: basic
from __future__ import annotations

import math

import numpy as np

GRAVITY = 9.81

MAX_TILT_ACCELERATION, MAX_THRUST_ACCELERATION = 4.5, 6.0
"""Largest horizontal acceleration by tilting, and largest vertical one above or below hovering, in m/s²."""
TILT_TIME_S = 0.15
"""Time constant of the acceleration: the body has to tilt first."""
DRAG_PER_S = 0.25
"""Acceleration by the air per relative velocity, in 1/s."""
YAW_TIME_S = 0.2
GUST_TIME_S = 2.0

_HOVER_CURRENT_A, _IDLE_CURRENT_A = 14.0, 0.4
_CAPACITY_AH, _CELLS, _RESISTANCE_OHM = 5.2, 4, 0.02
_EMPTY_V, _FULL_V = 3.3, 4.2


class Wind:
    """A steady wind with gusts: `mean` is (x, y) in m/s, `gusts` the standard deviation of the gusts in m/s."""

    def __init__(self, rng, mean=(1.5, 0.8), gusts=0.5):
        self._rng = rng
        self._gust = np.zeros(3)
        self.mean = mean
        self.gusts = gusts

    def step(self, dt):
        """Return the velocity (3,) of the air in m/s during the next `dt` s."""
        keep = math.exp(-dt / GUST_TIME_S)
        self._gust = keep * self._gust + math.sqrt(1 - keep * keep) * self.gusts * self._rng.standard_normal(3)
        return np.array([*self.mean, 0.0]) + self._gust * (1.0, 1.0, 0.3)


class Battery:
    """Four lithium cells: `charge` is the remaining share, `current` the present discharge current in A."""

    def __init__(self, charge=0.95):
        self.charge = charge
        self.current = _IDLE_CURRENT_A

    def step(self, motors_run, thrust, dt):
        """Discharge for `dt` s; `thrust` is relative to hovering."""
        self.current = _IDLE_CURRENT_A + (_HOVER_CURRENT_A * thrust**1.5 if motors_run else 0.0)
        self.charge = max(0.0, self.charge - self.current * dt / 3600 / _CAPACITY_AH)

    @property
    def voltage(self):
        """The terminal voltage under the present load, in V."""
        return _CELLS * (_EMPTY_V + (_FULL_V - _EMPTY_V) * self.charge) - _RESISTANCE_OHM * self.current


class Airframe:
    """The true state: `position` and `velocity` (3,), `yaw`, and `motors_run`, the only effect of arming on the
    dynamics.

    `thrust` (3,) is the motors' acceleration beyond hovering, `fell_at` the speed of the last touch-down in m/s.
    """

    def __init__(self, rng, wind=None):
        self.wind = wind or Wind(rng)
        self.battery = Battery()
        self.position, self.velocity = np.zeros(3), np.zeros(3)
        self.thrust = np.zeros(3)
        self.yaw, self.yaw_rate = math.pi / 2, 0.0
        self.motors_run = False
        self.fell_at = 0.0

    @property
    def is_on_ground(self):
        """Whether the drone is on the ground."""
        return self.position[2] <= 0.0

    def step(self, wanted, yaw_rate, dt):
        """Advance by `dt` s with a wanted acceleration (3,) beyond hovering, in m/s², and a yaw rate in rad/s."""
        air = self.wind.step(dt)
        wanted = np.array(wanted) if self.motors_run else np.array([0.0, 0.0, -GRAVITY])
        along_ground = math.hypot(wanted[0], wanted[1])
        wanted[:2] *= min(1.0, MAX_TILT_ACCELERATION / max(along_ground, 1e-9))
        lowest = -GRAVITY if not self.motors_run else -MAX_THRUST_ACCELERATION
        wanted[2] = min(max(wanted[2], lowest), MAX_THRUST_ACCELERATION)
        self.thrust += (wanted - self.thrust) * min(1.0, dt / TILT_TIME_S)
        self.battery.step(self.motors_run, max(0.0, 1.0 + self.thrust[2] / GRAVITY), dt)
        if self.is_on_ground and self.thrust[2] <= 0.05:
            self.thrust[:2], self.velocity, self.yaw_rate = 0.0, np.zeros(3), 0.0
            return
        self.yaw_rate += (yaw_rate - self.yaw_rate) * min(1.0, dt / YAW_TIME_S)
        self.yaw = math.remainder(self.yaw + self.yaw_rate * dt, 2 * math.pi)
        self.velocity = self.velocity + (self.thrust + DRAG_PER_S * (air - self.velocity)) * dt
        self.position = self.position + self.velocity * dt
        if self.position[2] <= 0.0:
            self.fell_at = max(0.0, float(-self.velocity[2]))
            self.position[2], self.velocity = 0.0, np.zeros(3)

    @property
    def tilt(self):
        """Roll and pitch in rad that give the present acceleration at the present yaw."""
        forward = self.thrust[0] * math.cos(self.yaw) + self.thrust[1] * math.sin(self.yaw)
        left = -self.thrust[0] * math.sin(self.yaw) + self.thrust[1] * math.cos(self.yaw)
        upward = max(GRAVITY + self.thrust[2], 1.0)
        return math.atan2(-left, upward), math.atan2(forward, upward)
