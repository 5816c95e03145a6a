"""The arm without ROS: joints with inertia that follow the set points of their controllers, and the trajectories.

Trajectories are followed as by ros2_control's joint_trajectory_controller: linear interpolation between points with
only positions, a cubic spline with velocities; the arm moves to the first point from its current position. The same
seed gives the same run.
"""

# pyright: basic
from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from .description import ARM, GRIPPER, HOME, JOINTS, Joint

STIFFNESS = 12.0  # 1/s: how fast a joint closes the gap to what is wanted
ENCODER_STEP = 1e-4  # rad, m


@dataclass
class Moving:
    """One joint with its position and velocity; a `stuck` joint does not move."""

    joint: Joint
    position: float
    velocity: float = 0.0
    stuck: bool = False

    def step(self, wanted, rate, dt):
        """Follow the set point `wanted`, which moves at `rate`, as far as inertia and limits allow."""
        limit, joint = self.joint.velocity, self.joint
        target = max(-limit, min(limit, rate + STIFFNESS * (wanted - self.position)))
        change = max(-joint.acceleration * dt, min(joint.acceleration * dt, target - self.velocity))
        # The joint must be able to stop at the set point: faster than this it would brake too late and overshoot.
        most = abs(rate) + math.sqrt(2 * joint.acceleration * abs(wanted - self.position))
        self.velocity = 0.0 if self.stuck else max(-most, min(most, self.velocity + change))
        moved = self.position + self.velocity * dt
        self.position = max(joint.lower, min(joint.upper, moved))
        if self.position != moved:
            self.velocity = 0.0


class Trajectory:
    """A trajectory from `start` through `points`: for each the time in s from the start, and positions and velocities
    (or None) by joint."""

    def __init__(self, start, names, points):
        self.names = list(names)
        self.duration = points[-1][0]
        self._points = [(0.0, list(start), [0.0] * len(self.names) if points[0][2] else None), *points]
        if points[0][0] <= 0.0:
            self._points = list(points)

    def at(self, elapsed):
        """Return the set points at a time in s: positions and velocities, in the order of the names."""
        points = self._points
        if elapsed >= points[-1][0] or len(points) == 1:
            return points[-1][1], [0.0] * len(self.names)
        after = next(index for index, point in enumerate(points) if point[0] > elapsed)
        if after == 0:
            return points[0][1], [0.0] * len(self.names)
        (begin, start, from_rates), (end, goal, to_rates) = points[after - 1], points[after]
        span, share = end - begin, (elapsed - begin) / (end - begin)
        if from_rates is None or to_rates is None:
            rates = [(last - first) / span for first, last in zip(start, goal)]  # noqa: B905 (3.8)
            return [first + share * (last - first) for first, last in zip(start, goal)], rates  # noqa: B905 (3.8)
        found = [
            _cubic(first, last, slope * span, other * span, share)
            for first, last, slope, other in zip(start, goal, from_rates, to_rates)  # noqa: B905 (3.8)
        ]
        return [position for position, _ in found], [rate / span for _, rate in found]


def _cubic(start, goal, slope, end_slope, share):
    """Return the position and its derivative with respect to `share` (0 to 1) on a cubic with these end values and
    slopes."""
    gap = goal - start
    square, cube = 3 * gap - 2 * slope - end_slope, slope + end_slope - 2 * gap
    position = start + share * (slope + share * (square + share * cube))
    return position, slope + share * (2 * square + 3 * share * cube)


class Controller:
    """A joint trajectory controller: follows one trajectory at a time, and holds its position without one."""

    def __init__(self, arm, names):
        self.names = tuple(names)
        self._arm = arm
        self._held = [arm.joints[name].position for name in names]
        self.trajectory: Trajectory | None = None
        self.began = 0.0

    def follow(self, names, points):
        """Begin a trajectory now; joints that it does not name keep their set points."""
        wanted = dict(zip(self.names, self.wanted()[0]))  # noqa: B905 (3.8)
        others = [name for name in self.names if name not in names]
        more = [wanted[name] for name in others]
        full = [(at, [*given, *more], rates and [*rates, *([0.0] * len(others))]) for at, given, rates in points]
        self.trajectory = Trajectory([wanted[name] for name in (*names, *others)], [*names, *others], full)
        self.began = self._arm.now

    def hold(self):
        """Hold the joints at their present positions."""
        self._held, self.trajectory = [self._arm.joints[name].position for name in self.names], None

    def wanted(self):
        """Return the set points now: positions and velocities, in the order of `names`."""
        if self.trajectory is None:
            return self._held, [0.0] * len(self._held)
        positions, rates = self.trajectory.at(self._arm.now - self.began)
        by_name = dict(zip(self.trajectory.names, zip(positions, rates)))  # noqa: B905 (3.8)
        return [by_name[name][0] for name in self.names], [by_name[name][1] for name in self.names]

    def is_over(self):
        """Whether the trajectory's time is over, or there is no trajectory."""
        return self.trajectory is None or self._arm.now - self.began >= self.trajectory.duration

    def errors(self):
        """Return set point minus true position, by joint."""
        wanted, _ = self.wanted()
        return {name: want - self._arm.joints[name].position for name, want in zip(self.names, wanted)}  # noqa: B905 (3.8)


class Simulation:
    """The arm with its two controllers. `now` is the simulated time in s."""

    def __init__(self, seed=7):
        self._rng = np.random.default_rng(seed)
        self.joints = {joint.name: Moving(joint, HOME.get(joint.name, 0.0)) for joint in JOINTS}
        self.now = 0.0
        self.controllers = {"arm": Controller(self, ARM), "gripper": Controller(self, GRIPPER)}

    def step(self, dt):
        """Advance the simulation by `dt` s."""
        self.now += dt
        for controller in self.controllers.values():
            for name, wanted, rate in zip(controller.names, *controller.wanted()):  # noqa: B905 (3.8)
                self.joints[name].step(wanted, rate, dt)

    def measured(self):
        """Return the joints' names, measured positions (with noise of half an encoder step) and velocities."""
        noise = self._rng.uniform(-0.5, 0.5, len(self.joints)) * ENCODER_STEP
        positions = [joint.position + float(error) for joint, error in zip(self.joints.values(), noise)]  # noqa: B905 (3.8)
        return list(self.joints), positions, [joint.velocity for joint in self.joints.values()]

    def is_moving(self):
        """Whether any joint moves."""
        return any(abs(joint.velocity) > 1e-3 for joint in self.joints.values())

    def heartbeat(self):
        """Return the robot's state in one line."""
        return f"alive {self.now:.0f} s, {'moving' if self.is_moving() else 'standing'}"
