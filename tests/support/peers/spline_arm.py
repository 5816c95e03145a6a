"""An arm of two joints behind a joint trajectory controller that does what that of ros2_controllers does: one JSON list
per line in, one JSON value per line out.

Between two points a line, a cubic or a quintic, by what both carry; the first segment from where the joints are; the
stamp of a trajectory is its start, also in the past; all publishers are transient_local, as those of ros2_control are
under Fast DDS. The joints are where they are commanded to be, as with mock hardware. It keeps what they have done.
"""

from __future__ import annotations

import json
import sys
import threading
import time
from itertools import pairwise
from typing import Any

import rclpy
from control_msgs.action import FollowJointTrajectory
from rclpy.action import ActionServer, CancelResponse
from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.duration import Duration
from rclpy.executors import MultiThreadedExecutor
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.qos import QoSDurabilityPolicy, QoSProfile
from rclpy.signals import SignalHandlerOptions
from rclpy.time import Time
from sensor_msgs.msg import JointState
from std_msgs.msg import String
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

JOINTS = ("joint_1", "joint_2")
STEP_S = 0.01
STATES_EVERY = 2
"""Steps: 50 Hz."""
DESCRIPTION = """<robot name="two">
<link name="base_link"/><link name="upper"/><link name="lower"/><link name="tool"/>
<joint name="joint_1" type="revolute"><parent link="base_link"/><child link="upper"/><axis xyz="0 0 1"/>
<limit lower="-3.14" upper="3.14" velocity="1.0" effort="10"/></joint>
<joint name="joint_2" type="revolute"><parent link="upper"/><child link="lower"/><axis xyz="0 0 1"/>
<origin xyz="0.5 0 0"/><limit lower="-1.57" upper="1.57" velocity="1.0" effort="10"/></joint>
<joint name="tip" type="fixed"><parent link="lower"/><child link="tool"/><origin xyz="0.4 0 0"/></joint>
</robot>"""


def interpolated(start: list[Any], end: list[Any], span: float, since: float) -> float:
    """The position, by Hermite's conditions solved one after the other; what is not carried is None."""
    (p, v, a), (q, w, b) = start, end
    if v is None or w is None:
        return p + (q - p) * since / span
    if a is None or b is None:
        bent = (3 * (q - p) - (2 * v + w) * span) / span**2
        return p + since * (v + since * (bent + since * (2 * (p - q) + (v + w) * span) / span**3))
    third = (20 * (q - p) - (8 * w + 12 * v) * span - (3 * a - b) * span**2) / (2 * span**3)
    fourth = (30 * (p - q) + (14 * w + 16 * v) * span + (3 * a - 2 * b) * span**2) / (2 * span**4)
    fifth = (12 * (q - p) - 6 * (w + v) * span - (a - b) * span**2) / (2 * span**5)
    return p + since * (v + since * (a / 2 + since * (third + since * (fourth + since * fifth))))


class Arm:
    """Its public methods are the commands."""

    def __init__(self, node: Node) -> None:
        self._node = node
        self._lock = threading.Lock()
        self._places, self._speeds = [0.0] * len(JOINTS), [0.0] * len(JOINTS)
        self._points: list[tuple[float, list[list[Any]]]] = []
        self._seen: list[dict[str, float]] = []
        self._goals = 0
        self._wanted_on: dict[str, Any] = {}
        latched = QoSProfile(depth=1, durability=QoSDurabilityPolicy.TRANSIENT_LOCAL)
        self._states = node.create_publisher(JointState, "/joint_states", latched)
        self._description = node.create_publisher(String, "/robot_description", latched)
        self._description.publish(String(data=DESCRIPTION))
        node.create_subscription(JointTrajectory, "~/joint_trajectory", self._follow, 1)
        self._action = ActionServer(
            node,
            FollowJointTrajectory,
            "~/follow_joint_trajectory",
            self._execute,
            cancel_callback=lambda _: CancelResponse.ACCEPT,
            callback_group=ReentrantCallbackGroup(),
        )
        self.begin()
        threading.Thread(target=self._live, daemon=True).start()

    def begin(self, places: list[float] = [0.0, 0.0]) -> None:  # noqa: B006 - from JSON
        """The joints stand there, and what they did is forgotten."""
        with self._lock:
            self._places, self._speeds, self._points = list(places), [0.0] * len(JOINTS), []
            self._seen = [{"low": at, "high": at, "speed": 0.0} for at in places]
            self._goals = 0

    def seen(self) -> dict[str, Any]:
        """What each joint has done: least and largest position, and top speed; how many trajectories came, and whether
        one is still followed.
        """
        with self._lock:
            moves = bool(self._points) and time.time() < self._points[-1][0]
            joints = {name: dict(found) for name, found in zip(JOINTS, self._seen, strict=True)}
            return {"joints": joints, "goals": self._goals, "moves": moves}

    def want(self, topic: str, seconds: float, to: float, away_s: float) -> None:
        """Publish, as another node would, a trajectory of one point for the first joint, stamped so far from now."""
        if topic not in self._wanted_on:
            self._wanted_on[topic] = self._node.create_publisher(JointTrajectory, topic, 10)
        start, span = Time(nanoseconds=time.time_ns() + int(away_s * 1e9)), Duration(seconds=seconds)
        point = JointTrajectoryPoint(positions=[to, 0.0], velocities=[0.0, 0.0], time_from_start=span.to_msg())
        message = JointTrajectory(joint_names=list(JOINTS), points=[point])
        message.header.stamp = start.to_msg()
        self._wanted_on[topic].publish(message)

    def _follow(self, trajectory: JointTrajectory) -> float:
        """Begins a trajectory; returns when it ends (s of Unix time)."""
        now = time.time()
        stamp = trajectory.header.stamp.sec + trajectory.header.stamp.nanosec / 1e9
        start = stamp or now
        order = [list(trajectory.joint_names).index(name) for name in JOINTS]
        columns = [
            (start + point.time_from_start.sec + point.time_from_start.nanosec / 1e9, self._states_of(point, order))
            for point in trajectory.points
        ]
        with self._lock:
            first = trajectory.points[0]
            # Its states are positions and velocities, as of most arms: without accelerations the first way is a cubic.
            before = [
                [place, speed if len(first.velocities) else None, None]
                for place, speed in zip(self._places, self._speeds, strict=True)
            ]
            self._points = [(now, before), *columns]
            self._goals += 1
        return columns[-1][0]

    @staticmethod
    def _states_of(point: Any, order: list[int]) -> list[list[Any]]:
        rows = (point.positions, point.velocities, point.accelerations)
        return [[row[place] if len(row) else None for row in rows] for place in order]

    def _execute(self, handle: Any) -> Any:
        ends = self._follow(handle.request.trajectory)
        while time.time() < ends and not handle.is_cancel_requested:
            time.sleep(STEP_S)
        if handle.is_cancel_requested:
            with self._lock:
                self._points = []
            handle.canceled()
        else:
            handle.succeed()
        return FollowJointTrajectory.Result()

    def _live(self) -> None:
        step, before = 0, time.time()
        while True:
            time.sleep(STEP_S)
            now, step = time.time(), step + 1
            with self._lock:
                for joint, place in enumerate(self._wanted(now)):
                    moved, seen = place - self._places[joint], self._seen[joint]
                    self._places[joint], self._speeds[joint] = place, moved / (now - before)
                    seen["low"], seen["high"] = min(seen["low"], place), max(seen["high"], place)
                    seen["speed"] = max(seen["speed"], abs(self._speeds[joint]))
                message = JointState(name=list(JOINTS), position=list(self._places), velocity=list(self._speeds))
            before = now
            if step % STATES_EVERY == 0:
                message.header.stamp = self._node.get_clock().now().to_msg()
                self._states.publish(message)

    def _wanted(self, now: float) -> list[float]:
        points = self._points
        if not points:
            return list(self._places)
        for (began, start), (ends, end) in pairwise(points):
            if now < ends:
                span = ends - began
                return [interpolated(*both, span, now - began) for both in zip(start, end, strict=True)]
        return [state[0] for state in points[-1][1]]


def main() -> None:
    rclpy.init(signal_handler_options=SignalHandlerOptions.NO)
    node = Node("arm_controller", parameter_overrides=[Parameter("joints", value=list(JOINTS))])
    node.declare_parameter("joints", list(JOINTS))
    executor = MultiThreadedExecutor(num_threads=4)
    executor.add_node(node)
    arm = Arm(node)
    threading.Thread(target=executor.spin, daemon=True).start()
    print('"ready"', flush=True)
    for line in sys.stdin:
        command, arguments = json.loads(line)
        print(json.dumps(getattr(arm, command)(**arguments)), flush=True)


if __name__ == "__main__":
    main()
