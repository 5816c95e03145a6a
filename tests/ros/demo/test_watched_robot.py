"""The simulated robot drives under a policy whose watchdog hears its odometry and its place, and is never stopped for
nothing: for 20 minutes (ROS2_MCP_WATCHED_S), in full. An observer tells whether the robot itself was silent.
"""

from __future__ import annotations

import math
import os
import random
import time
from itertools import pairwise
from pathlib import Path

import pytest

pytest.importorskip("rclpy", reason="needs the ROS 2 wheels, or a sourced ROS 2")

from ros2_mcp_common.latch import FILE, Latch, LatchState
from support.agent import Refusal, until
from support.demo_robot import robot_environment, running_robot
from support.driver import Driver
from support.observer import Observer, observing
from support.velocities import TWIST

WATCHED_S = float(os.environ.get("ROS2_MCP_WATCHED_S", "1200"))
SILENT_S = 0.45
"""The watchdog waits for 0.5 s, by when it heard; the times of the observer are those of sending."""
POLICY = """
policy: 1
name: watched
robot: watched
allow:
  - {publish: /cmd_vel, type: geometry_msgs/msg/Twist, rate_hz: 50, for_s: 10}
  - {goal: /navigate_to, type: ros2_mcp_demo_interfaces/action/NavigateTo}
limits:
  base:
    types: geometry_msgs/msg/Twist
    norm: {linear: 0.4, angular: 0.5}
    ramp: {linear: {up: 1.0}}
    hold_s: 0.5
zones:
  room: {frame: map, polygon: [[-2.3, -3.3], [6.3, -3.3], [6.3, 3.3], [-2.3, 3.3]]}
feedback: {topic: /odom}
pose: {topic: /pose, zone: room}
"""
"""The zone is the room with its walls: the robot itself cannot leave it. To a goal the robot turns faster (1.2 rad/s)
than the limit on velocities lets the agent."""


class Driving:
    """One thing after another that a policy allows; `count` says how often each was done."""

    def __init__(self, server: Driver, observer: Observer, latch: Latch) -> None:
        self.server, self.observer, self.latch, self.rng = server, observer, latch, random.Random(12)
        self.count: dict[str, int] = {}
        self.silences: list[str] = []

    def go_on(self) -> None:
        """Do one of them, and see that nothing but a stop that was asked for has latched."""
        what = self.rng.choice((self.repeat, self.repeat, self.once, self.burst, self.goal, self.stop, self.rest))
        what()
        self.count[what.__name__] = self.count.get(what.__name__, 0) + 1
        state = self.latch.look()
        if state.is_set and "has sent nothing" in state.reason and (gap_s := self.longest_gap_s()) > SILENT_S:
            self.silences.append(f"{state.reason}; its longest gap was {gap_s:.2f} s")  # rightly: no false stop
            self.reset(state)
        state = self.latch.look()
        assert not state.is_set, f"after {self.count}: {state.by}: {state.reason}"
        self.observer.forget()

    def longest_gap_s(self) -> float:
        """Between two messages of odometry, as they were sent, since the last thing was begun."""
        sent = [one["sent"] for one in self.observer.messages(topic="/odom")]
        return max(((after - before) / 1e9 for before, after in pairwise(sent)), default=math.inf)

    def reset(self, state: LatchState) -> None:
        """As the operator does."""
        self.latch.reset(by="operator", seen=state.count)
        until(lambda: not self.server.do("ros2_status")["latched"])

    def repeat(self) -> None:
        timed = {"frequency": self.rng.choice((2, 10, 20, 50)), "duration": self.rng.uniform(0.1, 4.0)}
        self._publish(**timed)

    def once(self) -> None:
        self._publish()

    def burst(self) -> None:
        for _ in range(self.rng.randrange(2, 10)):
            self.once()
            time.sleep(self.rng.uniform(0.0, 0.7))

    def goal(self) -> None:
        """A place that is near, or no way leads to; cancelled, or driven to its end."""
        place = {"x": self.rng.uniform(-1.5, 5.5), "y": self.rng.uniform(-2.5, 2.5)}
        try:
            sent = self.server.do("ros2_send_action_goal", action_name="/navigate_to", goal_fields=place)
        except Refusal as refused:  # the robot rejects some; what is latched is judged after it
            assert "reject" in str(refused).lower() or self.latch.look().is_set, refused
            return
        time.sleep(self.rng.uniform(0.0, 8.0))
        named = {"action_name": "/navigate_to", "goal_id_hex": sent["goal_id"]}
        self.server.outcome(self.server.tool("ros2_cancel_action_goal", **named))

    def stop(self) -> None:
        """In the middle of a motion; an operator resets it."""
        moving = self.server.tool("ros2_topic_publish", **self._velocity(), frequency=20, duration=5)
        time.sleep(self.rng.uniform(0.0, 1.0))
        self.server.stop()
        self.server.outcome(moving)
        time.sleep(1.2)  # what still moves a second after its zero is reported, and would be here
        state = self.latch.look()
        if state.by == "ros2_stop":
            self.reset(state)

    def rest(self) -> None:
        time.sleep(self.rng.uniform(0.0, 1.5))

    def _publish(self, **timed: float) -> None:
        """One that is refused because the latch was set is judged after it."""
        self.server.outcome(self.server.tool("ros2_topic_publish", **self._velocity(), **timed))

    def _velocity(self) -> dict:
        data = {"linear": {"x": self.rng.uniform(-0.4, 0.4)}, "angular": {"z": self.rng.uniform(-0.5, 0.5)}}
        return {"topic_name": "/cmd_vel", "message_type": TWIST, "data": data}


@pytest.mark.full
@pytest.mark.timeout(WATCHED_S + 120)
def test_it_is_never_stopped_for_nothing(prefixes: list[Path], domain_id: int, tmp_path: Path) -> None:
    policy = tmp_path / "policy.yaml"
    policy.write_text(POLICY, encoding="utf-8")
    policy.chmod(0o600)
    tmp_path.chmod(0o700)
    environment = robot_environment(prefixes, ROS_DOMAIN_ID=str(domain_id), XDG_STATE_HOME=str(tmp_path / "state"))
    latch = Latch(tmp_path / "state" / "ros2-mcp" / "watched" / FILE)
    with running_robot(prefixes, domain_id, "--seed", "3"), observing(environment) as observer:
        observer.join(by="odometry", topic="/odom", kind="nav_msgs/msg/Odometry")
        server = Driver(environment, "--tools", "all", "--policy", str(policy))
        try:
            server.knows("/cmd_vel", 1)
            until(lambda: "/navigate_to" in str(server.do("ros2_list_actions")))
            driving, end = Driving(server, observer, latch), time.monotonic() + WATCHED_S
            while time.monotonic() < end:
                driving.go_on()
            print(f"{WATCHED_S:g} s: {driving.count}, no false stop; the robot itself was silent: {driving.silences}")
            assert server.do("ros2_status")["bridge_restarts"] == []
        finally:
            server.end()
