"""The robot and its world without ROS: motion, measurements, modes. The same seed gives the same run."""

# pyright: basic
from __future__ import annotations

import math
from functools import cached_property

import numpy as np

from . import picture
from .base import RADIUS, Base, Pose, wrapped
from .battery import Battery
from .world import ROOM, Pillar, World

IDLE, MANUAL, AUTONOMOUS = "idle", "manual", "autonomous"
MODES = (IDLE, MANUAL, AUTONOMOUS)

BEAMS = 360
MAP_RESOLUTION = 0.05
RANGE_MIN, RANGE_MAX = 0.12, 5.0
DROPOUT = 0.002
CAMERA_FORWARD = 0.15
SPAWN_COLOR = (226, 120, 30)
MAX_SPAWN_RADIUS = 1.0

_BEAM_ANGLES = -math.pi + np.arange(BEAMS) * (2 * math.pi / BEAMS)


class Simulation:
    """The complete state of the robot and its world.

    `now` is the simulated time in s, `commanded` the commanded velocities (m/s, rad/s). `ranges` is the latest scan
    (see `scan`), or None while the scanner is off. `driver` is the node that drives autonomously, or did last.
    `localized_at` is when the robot was last localised (s).
    """

    def __init__(self, seed=7):
        streams = [np.random.default_rng(child) for child in np.random.SeedSequence(seed).spawn(5)]
        drive, self._lidar_rng, self._camera_rng, self._imu_rng, self._place_rng = streams
        self.world = World()
        self.base = Base(self.world, drive)
        self.battery = Battery()
        self.mode = MANUAL
        self.motors_enabled = True
        self.commanded = (0.0, 0.0)
        self.ranges = None
        self.now = 0.0
        self.gyro_bias = 0.002
        self.driver = None
        self.localized_at = -math.inf
        self._misplaced = (0.0, 0.0, 0.0)
        self._scanned_from = self.base.pose
        self._steps = 0

    def step(self, dt):
        """Advance the simulation by `dt` s."""
        self._steps += 1
        self.now = self._steps * dt
        self.base.step(*(self.commanded if self.why_not_driving() is None else (0.0, 0.0)), dt)
        rims = abs(self.base.left.velocity) + abs(self.base.right.velocity)
        self.battery.step(rims * 0.05, dt)

    def heartbeat(self):
        """Return the robot's state in one line."""
        return f"alive {self.now:.0f} s, mode {self.mode}, battery {self.battery.charge * 100:.0f} %"

    def why_not_driving(self):
        """Return why the motors have no power; None if they have."""
        if not self.motors_enabled:
            return "motors are disabled"
        if self.mode == IDLE:
            return "the mode is idle"
        return "the battery is empty" if self.battery.charge <= 0.0 else None

    def is_moving(self):
        """Whether the base moves."""
        return abs(self.base.linear) > 0.005 or abs(self.base.angular) > 0.01

    def scan(self, noise_stddev):
        """Return one laser scan: float32 ranges (BEAMS,) in m from -π on, infinite without a return."""
        pose = self._scanned_from = self.base.pose
        ranges = self.world.cast(pose.x, pose.y, pose.yaw + _BEAM_ANGLES)
        ranges = ranges + noise_stddev * self._lidar_rng.standard_normal(BEAMS)
        lost = (ranges > RANGE_MAX) | (self._lidar_rng.random(BEAMS) < DROPOUT)
        return np.where(lost, np.inf, np.maximum(ranges, RANGE_MIN)).astype(np.float32)

    def scan_points(self, ranges):
        """Return the end points of the latest scan's beams in the map, (n, 2) in m."""
        pose, hit = self._scanned_from, np.isfinite(ranges)
        angles, ranges = pose.yaw + _BEAM_ANGLES[hit], ranges[hit]
        return np.column_stack([pose.x + ranges * np.cos(angles), pose.y + ranges * np.sin(angles)])

    def photo(self, brightness):
        """Return the camera's picture, uint8 (rows, columns, 3) RGB."""
        return picture.render(self.world, self._camera_pose(), brightness, self._camera_rng)

    def depth_photo(self):
        """Return the depth picture, float32 (rows, columns) in m, infinite for the sky."""
        return picture.render_depth(self.world, self._camera_pose())

    def inertia(self):
        """Return the IMU's measurement: yaw (rad), yaw rate (rad/s), acceleration (x, y, z) in m/s²."""
        noise = self._imu_rng.standard_normal(5)
        base = self.base
        x, y, z = np.array([base.acceleration, base.linear * base.angular, 9.81]) + 0.03 * noise[2:]
        yaw, yaw_rate = wrapped(base.pose.yaw + 0.002 * noise[0]), base.angular + self.gyro_bias + 0.003 * noise[1]
        return yaw, yaw_rate, (float(x), float(y), float(z))

    def localize(self, stddev=0.008):
        """Localise the robot: return its true pose with an error of `stddev` m, and half as many radians."""
        self.localized_at = self.now
        self._misplaced = tuple(stddev * self._place_rng.standard_normal(3) * (1.0, 1.0, 0.5))
        return self.believed()

    def believed(self):
        """Return the estimated pose now, with the error of the last localisation."""
        (dx, dy, turn), pose = self._misplaced, self.base.pose
        return Pose(pose.x + dx, pose.y + dy, wrapped(pose.yaw + turn))

    def spawn(self, name, x, y, radius):
        """Place a pillar in the world; return None, or why that is not possible."""
        if not (math.isfinite(x) and math.isfinite(y) and math.isfinite(radius)):
            return "x, y and radius must be finite numbers"
        if not 0.0 < radius <= MAX_SPAWN_RADIUS:
            return f"radius must be greater than 0 and at most {MAX_SPAWN_RADIUS} m, not {radius:g} m"
        x_min, y_min, x_max, y_max = ROOM
        if not (x_min <= x <= x_max and y_min <= y <= y_max):
            return f"the world spans x {x_min:g} to {x_max:g} and y {y_min:g} to {y_max:g} m: ({x:g}, {y:g}) is outside"
        gap = math.dist((x, y), (self.base.pose.x, self.base.pose.y)) - radius - RADIUS
        if gap < 0.02:
            return "it would overlap the robot"
        self.world.place(Pillar(name, x, y, radius, 0.7, SPAWN_COLOR))
        return None

    @cached_property
    def map(self):
        """The robot's map, in cells of `MAP_RESOLUTION`, as `World.occupancy` returns it."""
        return self.world.occupancy(MAP_RESOLUTION)

    def _camera_pose(self):
        return self.base.pose.moved(CAMERA_FORWARD, 0.0)
