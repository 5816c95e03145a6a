"""Simulated physics for controllers of motion, without ROS: a base that slips and answers late, obstacles that move.

Deterministic for a seed. Everything is in m, s and rad; messages have the fields of ROS's own.
"""

from __future__ import annotations

import math
import random
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, field
from types import SimpleNamespace
from typing import Any

from ros2_mcp_bridge.motion.drive import Drive

STEP_S = 0.01
"""As often as the runner looks (`motion.LOOK_S`)."""
RADIUS_M = 0.2
WHEELS_M = 0.32


@dataclass
class Disc:
    """A round obstacle, which moves in a straight line until it meets the robot or a wall."""

    x: float
    y: float
    radius: float
    vx: float = 0.0
    vy: float = 0.0

    def step(self, base: Base) -> None:
        """On, but not into a robot that stands."""
        x, y = self.x + self.vx * STEP_S, self.y + self.vy * STEP_S
        if math.hypot(x - base.x, y - base.y) - self.radius - RADIUS_M > 0.005:
            self.x, self.y = x, y

    def hits(self, base: Base) -> bool:
        """Whether a robot that moves is in it."""
        is_moving = abs(base.linear) > 0.001 or abs(base.angular) > 0.01
        return is_moving and math.hypot(self.x - base.x, self.y - base.y) <= self.radius + RADIUS_M


@dataclass(kw_only=True)
class Base:
    """A round robot that drives with two wheels.

    `delay_s` passes before a command is followed, `slip` is the share of each motion that does not happen without its
    odometry seeing it, `deadband` the speed of a wheel's rim below which it does not turn; odometry has
    noise of `noise_m` and `noise_rad`.
    """

    seed: int = 0
    delay_s: float = 0.1
    slip: float = 0.0
    turn_slip: float = 0.0
    deadband: float = 0.0
    noise_m: float = 0.0
    noise_rad: float = 0.0
    acceleration: float = 1.0
    braking: float = 1.0
    turning: float = 3.0
    x: float = 0.0
    y: float = 0.0
    yaw: float = 0.0
    odometry: tuple[float, float, float] = (0.0, 0.0, 0.0)
    linear: float = 0.0
    angular: float = 0.0
    _commands: deque[tuple[float, float, float]] = field(default_factory=deque[tuple[float, float, float]])
    _followed: tuple[float, float] = (0.0, 0.0)

    def __post_init__(self) -> None:
        self.random = random.Random(self.seed)

    def command(self, now: float, linear: float, angular: float) -> None:
        self._commands.append((now + self.delay_s, linear, angular))

    def step(self, now: float) -> None:
        while self._commands and self._commands[0][0] <= now:
            self._followed = self._commands.popleft()[1:]
        linear, angular = self._followed
        if abs(linear) + abs(angular) * WHEELS_M / 2 < self.deadband:  # no wheel overcomes its friction
            linear = angular = 0.0
        slows = abs(linear) < abs(self.linear) or linear * self.linear < 0
        self.linear = _towards(self.linear, linear, (self.braking if slows else self.acceleration) * STEP_S)
        self.angular = _towards(self.angular, angular, self.turning * STEP_S)
        # The wheels' slow slip is seen by odometry as a motion that did not happen; fast noise averages out.
        self.x, self.y, self.yaw = _moved(
            (self.x, self.y, self.yaw), self.linear * (1 - self.slip), self.angular * (1 - self.turn_slip)
        )
        self.odometry = _moved(self.odometry, self.linear, self.angular)

    def odometry_message(self) -> Any:
        x, y, yaw = self.odometry
        noisy = [self.random.gauss(0.0, self.noise_m), self.random.gauss(0.0, self.noise_m)]
        yaw += self.random.gauss(0.0, self.noise_rad)
        return pose_message(x + noisy[0], y + noisy[1], yaw)


def pose_message(x: float, y: float, yaw: float) -> Any:
    orientation = SimpleNamespace(x=0.0, y=0.0, z=math.sin(yaw / 2), w=math.cos(yaw / 2))
    return SimpleNamespace(
        pose=SimpleNamespace(pose=SimpleNamespace(position=SimpleNamespace(x=x, y=y, z=0.0), orientation=orientation))
    )


def _moved(pose: tuple[float, float, float], linear: float, angular: float) -> tuple[float, float, float]:
    x, y, yaw = pose
    middle = yaw + angular * STEP_S / 2
    return x + linear * STEP_S * math.cos(middle), y + linear * STEP_S * math.sin(middle), yaw + angular * STEP_S


def _towards(value: float, target: float, step: float) -> float:
    return value + max(-step, min(step, target - value))


def scan_message(
    base: Base, discs: Sequence[Disc], *, beams: int, noise_m: float, walls: float = math.inf, fov: float = 2 * math.pi
) -> Any:
    """A scan from the middle of the base; `walls` is half the width of a square room around the origin."""
    ranges: list[float] = []
    for beam in range(beams):
        angle = base.yaw - fov / 2 + beam * fov / beams
        cosine, sine = math.cos(angle), math.sin(angle)
        nearest = min(
            (walls * math.copysign(1.0, part) - at) / part if part else math.inf
            for part, at in ((cosine, base.x), (sine, base.y))
        )
        for disc in discs:
            x, y = disc.x - base.x, disc.y - base.y
            along = x * cosine + y * sine
            half = disc.radius**2 - (x * x + y * y - along * along)
            if half > 0 and along > 0:
                nearest = min(nearest, along - math.sqrt(half))
        ranges.append(nearest + base.random.gauss(0.0, noise_m) if nearest < 5.0 else math.inf)
    step = fov / beams
    return SimpleNamespace(
        angle_min=-fov / 2, angle_max=fov / 2, angle_increment=step, ranges=ranges, range_min=0.05, range_max=5.0
    )


def surroundings(rng: random.Random) -> list[Disc]:
    """Some obstacles that stand or move at up to 0.3 m/s, half of them about towards the robot; none is there yet."""
    discs: list[Disc] = []
    number = rng.choice([1, 3, 6])
    while len(discs) < number:
        x, y, radius = rng.uniform(-3, 3), rng.uniform(-3, 3), rng.uniform(0.05, 0.4)
        if math.hypot(x, y) - radius - RADIUS_M < 0.3:
            continue
        speed = rng.choice([0.0, rng.uniform(0, 0.3)])
        heading = rng.choice([rng.uniform(-math.pi, math.pi), math.atan2(-y, -x) + rng.uniform(-0.6, 0.6)])
        discs.append(Disc(x, y, radius, speed * math.cos(heading), speed * math.sin(heading)))
    return discs


@dataclass(kw_only=True)
class Run:
    """A drive against the simulated physics; `stopped_s` is when the last command that was no zero left."""

    asked: dict[str, Any]
    base: Base
    discs: list[Disc] = field(default_factory=list[Disc])
    walls: float = math.inf
    odometry_hz: float = 25.0
    scan_hz: float = 10.0
    beams: int = 120
    scan_noise_m: float = 0.01
    command_hz: float = 20.0
    odometry_until_s: float = math.inf
    scan_until_s: float = math.inf
    pauses_s: Sequence[tuple[float, float]] = ()
    scan_fov: float = 2 * math.pi
    collisions: int = 0
    nearest_m: float = math.inf
    seconds: float = 0.0
    moved_at_s: float = -1.0
    stood_s: float = 0.0
    heard_at_s: dict[str, float] = field(default_factory=dict[str, float])
    track: dict[str, list[tuple[float, float, float]]] = field(default_factory=lambda: {"truth": [], "odometry": []})

    def go(self, most_s: float = 120.0) -> Drive:
        drive = Drive(self.asked)
        due = {"odometry": 0.0, "scan": 0.0, "command": 0.0}
        moves, began = False, False
        for number in range(int(most_s / STEP_S)):
            now = self.seconds = number * STEP_S
            self._step_world(now)
            is_paused = any(begin <= now < end for begin, end in self.pauses_s)
            if now >= due["odometry"] and now < self.odometry_until_s and not is_paused:
                due["odometry"] = max(due["odometry"], now - STEP_S) + 1 / self.odometry_hz
                self.heard_at_s["odometry"] = now
                drive.hear("odometry", self.base.odometry_message(), now)
            if self.asked.get("sensors") and now >= due["scan"] and now < self.scan_until_s:
                due["scan"] += 1 / self.scan_hz
                scan = scan_message(
                    self.base,
                    self.discs,
                    beams=self.beams,
                    noise_m=self.scan_noise_m,
                    walls=self.walls,
                    fov=self.scan_fov,
                )
                self.heard_at_s["scan"] = now
                drive.hear("sensor 0", scan, now)
            if not began and drive.awaits():
                continue
            began = True
            velocity = drive.step(now)
            if velocity is None:
                self.base.command(now, 0.0, 0.0)
                return drive
            is_zero = not any(velocity.values())
            if now >= due["command"] or moves == is_zero:
                due["command"] = max(due["command"], now) + 1 / self.command_hz
                moves = not is_zero
                self.stood_s += 1 / self.command_hz if is_zero and not drive.is_settling else 0.0
                if moves:
                    self.moved_at_s = now
                self.base.command(now, velocity.get("linear.x", 0.0), velocity.get("angular.z", 0.0))
        raise AssertionError(f"it has not ended: {drive.report()}")

    def rest(self) -> None:
        """Half a second more, in which it comes to stand and what moves goes on."""
        for number in range(50):
            self._step_world(self.seconds + number * STEP_S)

    @property
    def odometry_error_m(self) -> float:
        """What odometry itself erred in this run."""
        truth, counted = self.track["truth"][-1], self.track["odometry"][-1]
        return math.hypot(truth[0] - counted[0], truth[1] - counted[1])

    def _step_world(self, now: float) -> None:
        self.base.step(now)
        base = self.base
        self.track["truth"].append((base.x, base.y, base.yaw))
        self.track["odometry"].append(base.odometry)
        for disc in self.discs:
            gap = math.hypot(disc.x - base.x, disc.y - base.y) - disc.radius - RADIUS_M
            self.nearest_m = min(self.nearest_m, gap)
            self.collisions += disc.hits(base)
            disc.step(base)
        if max(abs(base.x), abs(base.y)) > self.walls - RADIUS_M:
            self.collisions += 1


def asked(**given: Any) -> dict[str, Any]:
    """What the server asks of `Drive`, with defaults."""
    return {
        "kind": "drive",
        "speed": 0.3,
        "time_limit_s": 100.0,
        "odometry": {"topic": "/odom", "type": "nav_msgs/msg/Odometry"},
        **given,
    }


def guarded(guard_m: float, **given: Any) -> dict[str, Any]:
    """The same with a scan in the middle of a round robot."""
    mount = {"translation": [0.0, 0.0, 0.0], "rotation": [0.0, 0.0, 0.0, 1.0]}
    return asked(
        sensors=[{"topic": "/scan", "type": "sensor_msgs/msg/LaserScan", "mount": mount}],
        guard_m=guard_m,
        body={"front": RADIUS_M, "rear": RADIUS_M, "side": RADIUS_M, "radius": RADIUS_M},
        **given,
    )
