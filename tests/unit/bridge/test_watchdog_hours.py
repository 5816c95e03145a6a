"""Hours of the simulated robot under the watchdog in seconds: 8 in full, 2 minutes here, and not one false stop.

Physics, plans and noise are those of the simulated robot (`ros2_mcp_demo`); the watchdog's rounds are the bridge's own.
Time goes in steps of 0.02 s. Messages come late, some never; both processes stand still now and then.
"""

from __future__ import annotations

import math
import os
import random
from collections import Counter
from collections.abc import Callable, Iterator
from typing import Any

import pytest

pytest.importorskip("rclpy", reason="needs the ROS 2 wheels, or a sourced ROS 2")

from ros2_mcp_bridge.motion.watching import rounds
from ros2_mcp_common.policy.checks import Zone
from ros2_mcp_common.policy.feedback import PoseRule, SpeedRule, Watchdog
from ros2_mcp_demo.base import wrapped
from ros2_mcp_demo.drive import Drive, Goal, Surroundings
from ros2_mcp_demo.simulation import MAP_RESOLUTION, Simulation
from support.agent import FULL

SIMULATED_S = float(os.environ.get("ROS2_MCP_SIMULATED_S", "28800" if FULL else "120"))
STEP_S = 0.02
LINEAR, ANGULAR = 0.4, 1.2
"""What the robot's navigation drives at most."""
TURNING = 0.5
"""What the policy allows of `ANGULAR`: a goal turns faster, and is not held to it."""
TIMEOUT_S = 0.5
"""The driver's: it stops when commands stay away."""
SPEED = SpeedRule("/odom", "nav_msgs/msg/Odometry", "twist.twist", 1.0, 1.2, 0.5,
                  {"linear": 0.03, "angular": 0.05}, {"linear": LINEAR, "angular": TURNING})  # fmt: skip
ROOM = Zone("map", ((-2.3, -3.3), (6.3, -3.3), (6.3, 3.3), (-2.3, 3.3)))
POSE = PoseRule("/pose", "", "pose.pose", 1.0, 1.0, "map", ROOM)


class Wire:
    """What is sent arrives later, or never: a share of it is lost, and all of it while the wire is down."""

    def __init__(self, rng: random.Random, lost: float) -> None:
        self._rng, self._lost = rng, lost
        self._under_way: list[tuple[float, Any]] = []
        self.down_until = 0.0

    def send(self, message: Any, now: float) -> None:
        if now >= self.down_until and self._rng.random() > self._lost:
            late_s = self._rng.uniform(0.001, 0.03) if self._rng.random() > 0.01 else self._rng.uniform(0.05, 0.25)
            self._under_way.append((now + late_s, message))

    def arrived(self, now: float) -> list[Any]:
        come = [message for at, message in self._under_way if at <= now]
        self._under_way = [one for one in self._under_way if one[0] > now]
        return come


class Robot:
    """The simulated robot, its driver and its navigation, as its nodes have them."""

    def __init__(self, rng: random.Random) -> None:
        self.rng, self.simulation = rng, Simulation(seed=rng.randrange(2**31))
        self.commands, self.odometry, self.places = Wire(rng, 0.01), Wire(rng, 0.01), Wire(rng, 0.01)
        self.surroundings = Surroundings(*self.simulation.map, MAP_RESOLUTION)
        self.drive: Drive | None = None
        self._commanded, self._commanded_at = (0.0, 0.0), -math.inf
        self._step = 0

    @property
    def now(self) -> float:
        return self._step * STEP_S

    def cancel(self) -> None:
        """End the drive to a goal, if there is one."""
        if self.drive:
            self.drive, self._commanded = None, (0.0, 0.0)

    def step(self) -> None:
        self._step += 1
        now, base = self.now, self.simulation.base
        if commands := self.commands.arrived(now):
            self._commanded, self._commanded_at, self.drive = commands[-1], now, None  # by hand takes over
        if self.drive and self._step % 5 == 0:
            self._commanded = self.drive.step(base.pose, now, base.blocked, LINEAR, ANGULAR)
            self._commanded_at = now
            self.drive = None if self.drive.outcome else self.drive
        self.simulation.commanded = self._commanded if now - self._commanded_at <= TIMEOUT_S else (0.0, 0.0)
        self.simulation.battery.charge = 1.0
        self.simulation.step(STEP_S)
        if self._step % 2 == 0:
            noise = self.rng.gauss(0.0, 0.004), self.rng.gauss(0.0, 0.008)
            odd = self.rng.gauss(0.0, 1.0) if self.rng.random() < 0.001 else 0.0  # one message that is wide of it
            self.odometry.send((base.linear + noise[0] + odd, base.angular + noise[1]), now)
        if self._step % 5 == 0:
            self.places.send(self.simulation.localize(), now)


class Agent:
    """Drives by every way there is, stops in the middle of it, rests; `is_driven` is what the bridge would say."""

    def __init__(self, robot: Robot) -> None:
        self.robot, self.rng, self.done = robot, robot.rng, Counter[str]()
        self.is_driven = self.by_goal = False
        self._life = self._lives()

    def step(self) -> None:
        next(self._life)

    def _lives(self) -> Iterator[None]:
        ways: list[Callable[[], Iterator[None]]] = [self.repeat, self.repeat, self.burst, self.goal, self.rest]
        while True:
            way = self.rng.choice(ways)
            yield from way()
            self.done[way.__name__] += 1

    def repeat(self) -> Iterator[None]:
        """One velocity again and again until its time is over, or a stop ends it."""
        velocity, every_s = self._velocity(), 1 / self.rng.choice((3, 10, 20, 50))
        yield from self._drive(velocity, every_s, self.rng.choice((0.06, 0.3, 1.0, 3.0, 8.0)) * self.rng.random())

    def burst(self) -> Iterator[None]:
        """Single commands, each held for 0.5 s where none follows."""
        for _ in range(self.rng.randrange(1, 8)):
            yield from self._drive(self._velocity(), 9.0, 0.5 * self.rng.random())
            yield from self._wait(0.5 * self.rng.random())

    def goal(self) -> Iterator[None]:
        """Cancelled, or driven to its end; the bridge hears of the end a little later."""
        robot, place = self.robot, Goal(self.rng.uniform(-1.5, 5.5), self.rng.uniform(-2.5, 2.5))
        robot.drive = Drive(place, robot.surroundings, robot.now)
        self.is_driven = self.by_goal = True
        patience_s = self.rng.uniform(0.5, 15.0)
        end = robot.now + patience_s
        while robot.drive and robot.now < end:
            yield
        robot.cancel()
        yield from self._wait(self.rng.uniform(0.01, 0.3))
        self.is_driven = self.by_goal = False

    def rest(self) -> Iterator[None]:
        yield from self._wait(self.rng.uniform(0.0, 4.0))

    def _drive(self, velocity: tuple[float, float], every_s: float, for_s: float) -> Iterator[None]:
        end, due = self.robot.now + for_s, self.robot.now
        self.is_driven = True
        while True:
            if self.robot.now >= due:
                due += every_s
                self.robot.commands.send(velocity, self.robot.now)
            yield
            if self.robot.now >= end:
                break
        for _ in range(2):  # as the bridge sends zeros; one that is not acknowledged comes again, or the driver stops
            self.robot.commands.send((0.0, 0.0), self.robot.now)
        self.is_driven = False

    def _wait(self, seconds: float) -> Iterator[None]:
        end = self.robot.now + seconds
        while self.robot.now < end:
            yield

    def _velocity(self) -> tuple[float, float]:
        return self.rng.uniform(-LINEAR, LINEAR), self.rng.uniform(-TURNING, TURNING)


def as_twist(linear: float, angular: float) -> dict[str, Any]:
    zero = {"x": 0.0, "y": 0.0, "z": 0.0}
    return {"twist": {"twist": {"linear": {**zero, "x": linear}, "angular": {**zero, "z": angular}}}}


def as_pose(x: float, y: float, yaw: float) -> dict[str, Any]:
    turn = {"x": 0.0, "y": 0.0, "z": math.sin(yaw / 2), "w": math.cos(yaw / 2)}
    return {"pose": {"pose": {"position": {"x": x, "y": y, "z": 0.0}, "orientation": turn}}}


class Watched:
    """A robot, its agent and the bridge's watchdog, until `found` says why it was stopped."""

    def __init__(self, seed: int) -> None:
        self.rng = random.Random(seed)
        self.robot = Robot(self.rng)
        self.agent = Agent(self.robot)
        self.watchdog = Watchdog(SPEED, POSE)
        self.found: list[str] = []
        self._rounds = rounds(
            self.watchdog,
            self._hear,
            lambda: self.agent.is_driven,
            self.found.append,
            lambda: self.robot.now,
            lambda: self.agent.by_goal,
        )
        self._due = 0.0

    def step(self) -> None:
        robot, rng = self.robot, self.rng
        robot.step()
        self.agent.step()
        if robot.now >= self._due:
            self._due = robot.now + next(self._rounds)
        chance = rng.random()
        if chance < STEP_S / 120:  # every two minutes the robot is not heard for a while
            robot.odometry.down_until = robot.places.down_until = robot.now + rng.uniform(0.05, 0.3)
        elif chance < STEP_S / 60:  # or the bridge stands still, and hears everything at once
            self._due = robot.now + rng.uniform(0.05, 0.7)

    def _hear(self) -> None:
        now = self.robot.now
        for speed in self.robot.odometry.arrived(now):
            self.watchdog.heard_speed(as_twist(*speed), now)
        for pose in self.robot.places.arrived(now):
            self.watchdog.heard_pose(as_pose(pose.x, pose.y, wrapped(pose.yaw)), "map", now)


@pytest.mark.timeout(1200 if FULL else 60)
def test_no_robot_is_stopped_for_nothing_in_hours() -> None:
    watched = Watched(seed=12)
    for _ in range(round(SIMULATED_S / STEP_S)):
        watched.step()
        assert not watched.found, f"after {watched.robot.now:.2f} s, {watched.agent.done}: {watched.found}"
    travelled = watched.robot.simulation.base.travelled
    print(f"{SIMULATED_S / 3600:.2f} h: {dict(watched.agent.done)}, {travelled:.0f} m driven, no false stop")
    assert travelled > SIMULATED_S * 0.02, "it did drive"
