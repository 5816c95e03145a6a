"""The drone and its wind without ROS. The same seed gives the same wind."""

# pyright: basic
from __future__ import annotations

import numpy as np

from .airframe import Airframe
from .autopilot import Autopilot

GPS_ERROR_M = 0.02
"""Standard deviation of the measured position: that of a receiver with corrections, so that flights can be judged."""


class DroneSimulation:
    """The drone without ROS: `now` is the simulated time in s; `speedup` is the simulated seconds per real second
    (SIM_SPEEDUP of ArduPilot).
    """

    def __init__(self, seed=7):
        air, self._sensors = (np.random.default_rng(child) for child in np.random.SeedSequence(seed).spawn(2))
        self.frame = Airframe(air)
        self.autopilot = Autopilot(self.frame)
        self.speedup = 1
        self.now = 0.0
        self._steps = 0

    def step(self, dt):
        """Advance the simulation by `speedup` steps of `dt` s."""
        for _ in range(self.speedup):
            self._steps += 1
            self.now = self._steps * dt
            self.autopilot.step(dt)

    def heartbeat(self):
        """Return the drone's state in one line."""
        pilot, charge = self.autopilot, self.frame.battery.charge * 100
        armed = "armed" if pilot.armed else "disarmed"
        return (
            f"alive {self.now:.0f} s, mode {pilot.mode}, {armed}, {pilot.altitude:.1f} m high, battery {charge:.0f} %"
        )

    def localize(self):
        """Return the measured position: x, y, z in m."""
        return self.frame.position + GPS_ERROR_M * self._sensors.standard_normal(3)
