"""The measured joint states of the robot, taken from the middleware only when they are needed."""

from __future__ import annotations

import json
import math
import threading
import time
from collections.abc import Callable, Collection, Mapping, Sequence
from typing import TYPE_CHECKING, Any

from ros2_mcp_bridge.request import OperationError, Request, Steps
from ros2_mcp_bridge.ros import interfaces, qos, rcl
from ros2_mcp_common.policy.curves import State
from ros2_mcp_common.policy.trajectory_limits import JointBounds, Joints
from ros2_mcp_common.wire.protocol import JointsReply

if TYPE_CHECKING:
    from rclpy.node import Node

JOINT_STATE = "sensor_msgs/msg/JointState"
# The age at which a position is stale. Joint states come at 10 to 1,000 Hz. A joint may be far from an older position,
# and a hold there would move it back.
STALE_S = 0.5
# The most topics with joint states: arm, gripper, wheels. No robot with more is known to us.
MOST_TOPICS = 8
# The longest wait for the lock: a thread that hangs while it takes messages must not block the other, which then uses
# what was taken before.
TAKE_S = 0.05
NS_PER_S = 1_000_000_000
# The longest wait for a first message with the joints of a trajectory, once per topic, before it is sent: a publisher
# that missed our announcement is discovered with the next one, 3 s later (decision 13).
MEASURED_S = 3.5
# The polling period of that wait: joint states come at 10 to 1,000 Hz.
LOOK_S = 0.02


class JointStates:
    """The newest position of each joint, from all topics with joint states.

    A subscription from which nothing is taken costs only the middleware's own work: its queue has one place.

    Joint states that this bridge publishes itself are no measurement. The middleware does not report who sent a
    sample (rclpy gives no publisher), so the bridge records the joints in them: until those samples are stale, the
    positions of these joints are unknown. `relied_on` returns the joints that would have to be held now; no joint
    states of these may be published.
    """

    def __init__(self, node: Node, relied_on: Callable[[], Collection[str]] = tuple) -> None:
        self.relied_on = relied_on
        self._published_at: dict[str, float] = {}
        self._node = node
        self._interface: Any = None
        self._subscriptions: dict[str, rcl.RawSubscription] = {}
        self._positions: dict[str, tuple[float, float]] = {}
        self._speeds: dict[str, float] = {}
        self.described: Mapping[str, JointBounds] = {}
        self._lock = threading.Lock()
        self._looked_at = -math.inf

    def follow(self) -> None:
        """Subscribe to the topics with joint states that exist by now. ROS thread only."""
        if self._interface is None:
            self._interface = interfaces.load(JOINT_STATE)
        profile = qos.profile({"reliability": "best_effort"}, max_depth=1)
        for name, types in self._node.get_topic_names_and_types():
            if JOINT_STATE in types and name not in self._subscriptions and len(self._subscriptions) < MOST_TOPICS:
                self._subscriptions[name] = rcl.subscription(self._node, self._interface, name, profile)

    def missing(self, joints: Sequence[str]) -> list[str]:
        """Return the joints without a recent measurement. Thread-safe."""
        self._look()
        oldest = time.monotonic() - STALE_S
        return [
            joint
            for joint in joints
            if self._positions.get(joint, (0.0, -math.inf))[1] < oldest
            or self._published_at.get(joint, -math.inf) >= oldest
        ]

    def positions(self, joints: Sequence[str]) -> list[float]:
        """Return the current positions of these joints, in rad or m. Thread-safe.

        Raises:
            ValueError: in words, if a position is not known.
        """
        if missing := self.missing(joints):
            own = " but those that this server publishes itself" if self._published_at.keys() & missing else ""
            raise ValueError(f"no joint state of the last {STALE_S:g} s{own} has the position of {', '.join(missing)}")
        return [self._positions[joint][0] for joint in joints]

    def publishes(self, message: Any) -> None:
        """Record that this bridge is about to publish a JointState. ROS thread only.

        Raises:
            OperationError: of kind `refused`, while one of its joints moves by a trajectory of this bridge: the hold
                that ends this motion would jump to the position in the message.
        """
        joints = dict.fromkeys(map(str, message.name))
        if moving := [joint for joint in joints if joint in self.relied_on()]:
            raise OperationError(
                "refused",
                f"{', '.join(moving)} moves by a trajectory of this server: its joint states must come from the robot.",
                "End that motion first (ros2_stop).",
            )
        now = time.monotonic()
        fresh = {joint: at for joint, at in self._published_at.items() if at >= now - STALE_S}
        self._published_at = {**fresh, **dict.fromkeys(joints, now)}

    def known(self, joints: Sequence[str]) -> Joints:
        """Return the current states of these joints, and their limits in the robot's description. Thread-safe.

        Raises:
            ValueError: in words, if a position is not known.
        """
        positions = self.positions(joints)
        measured = {name: State(at, self._speeds.get(name)) for name, at in zip(joints, positions, strict=True)}
        return Joints(measured, self.described)

    def wait(self, request: Request) -> Steps[JointsReply]:
        """Steps that return the current joint states, after waiting up to `within_s` for them. Used
        before the first trajectory.

        The body, if there is one, has the limits from the robot's description, by joint, as JSON of `JointBounds`.
        Joints without a measurement are omitted.

        Raises:
            OperationError: of kind `bad_request`, if these limits cannot be read.
        """
        if request.body:
            try:
                described = json.loads(request.body)
                self.described = {str(name): JointBounds(**each) for name, each in described.items()}
            except (ValueError, TypeError, AttributeError) as error:
                raise OperationError("bad_request", f"These limits of joints cannot be read: {error!r}") from error
        joints, deadline = request.texts("joints"), time.monotonic() + request.number("within_s", MEASURED_S)
        self.follow()
        while (missing := self.missing(joints)) and time.monotonic() < deadline:
            self.follow()
            yield LOOK_S
        measured = self.known([name for name in joints if name not in missing]).measured
        return {"joints": {name: (state.position, state.speed) for name, state in measured.items()}}

    def clear(self) -> None:
        """Destroy the subscriptions."""
        for subscription in self._subscriptions.values():
            subscription.destroy_when_not_in_use()
        self._subscriptions.clear()

    def _look(self) -> None:
        """Take the messages that have come.

        Two clocks bound their age: the time of the last look, and the middleware's stamp, which is wrong if the
        machine's time was set meanwhile.
        """
        if not self._lock.acquire(timeout=TAKE_S):
            return
        try:
            now, before, self._looked_at = time.monotonic(), self._looked_at, time.monotonic()
            for subscription in list(self._subscriptions.values()):
                taken = subscription.take_message(self._interface, True)
                if taken:
                    stamp_ns: int = taken[1].get("received_timestamp") or time.time_ns()
                    self._take_in(taken[0], max(before, now - max(0.0, (time.time_ns() - stamp_ns) / NS_PER_S)))
        finally:
            self._lock.release()

    def _take_in(self, data: bytes, at: float) -> None:
        try:
            message = rcl.deserialize(data, self._interface)
        except Exception:  # noqa: BLE001 - any node can publish a broken message: it is ignored
            return
        speeds = dict(zip(message.name, message.velocity, strict=False))
        for name, position in zip(message.name, message.position, strict=False):
            if math.isfinite(position):
                self._positions[name] = position, at
                self._speeds.pop(name, None)
                if math.isfinite(speed := speeds.get(name, math.nan)):
                    self._speeds[name] = speed
