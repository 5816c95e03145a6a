"""A three-cell lithium battery: charge, current and voltage. No ROS."""

# pyright: basic
from __future__ import annotations

import numpy as np

CAPACITY_AH = 5.0
CELLS = 3
IDLE_CURRENT = 0.5
DRIVE_CURRENT = 3.0  # A more for each m/s of a wheel's rim
CHARGE_CURRENT = 2.0
INTERNAL_RESISTANCE = 0.08

_CURVE_CHARGE = (0.0, 0.05, 0.1, 0.2, 0.4, 0.6, 0.8, 0.9, 1.0)
_CURVE_VOLTAGE = (3.0, 3.3, 3.45, 3.55, 3.65, 3.78, 3.95, 4.05, 4.2)  # of one cell, unloaded


class Battery:
    """A battery: `charge` is the remaining share (0 to 1), `current` the present discharge current in A, negative while
    it charges."""

    def __init__(self, charge=0.87):
        self.charge = charge
        self.current = IDLE_CURRENT
        self.drain_rate = 1.0
        self.is_charging = False

    def step(self, speed, dt):
        """Discharge or charge for `dt` s; `speed` is the sum of both wheels' rim speeds in m/s."""
        self.current = -CHARGE_CURRENT if self.is_charging else IDLE_CURRENT + DRIVE_CURRENT * speed
        rate = 1.0 if self.is_charging else self.drain_rate
        self.charge = min(1.0, max(0.0, self.charge - rate * self.current * dt / 3600 / CAPACITY_AH))

    @property
    def voltage(self):
        """The terminal voltage under the present load, in V."""
        unloaded = CELLS * float(np.interp(self.charge, _CURVE_CHARGE, _CURVE_VOLTAGE))
        return unloaded - INTERNAL_RESISTANCE * self.current
