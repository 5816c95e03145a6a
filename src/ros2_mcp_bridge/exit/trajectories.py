"""Joint trajectories: a motion that continues by itself, and is ended by a hold at the measured joint positions.

A joint trajectory controller follows the newest trajectory on its topic. The hold is one point with the current
positions, to be reached at once: the controller does the same when a goal is canceled (ros2_controllers,
`set_hold_position`). An empty trajectory would stop nothing: the controller rejects it.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Sequence
from typing import Any

from ros2_mcp_bridge.exit.lifeline import Guarded, Lifeline
from ros2_mcp_bridge.exit.velocities import POLL_S, Outgoing, VelocityTopic, decoded
from ros2_mcp_bridge.request import OperationError, Steps
from ros2_mcp_bridge.ros import interfaces, rcl
from ros2_mcp_bridge.ros.clock import RobotClock
from ros2_mcp_bridge.ros.joint_states import MEASURED_S, JointStates
from ros2_mcp_common.policy.velocity import HOLD_TYPES
from ros2_mcp_common.wire.protocol import StoppedTopic

POINT = "trajectory_msgs/msg/JointTrajectoryPoint"
# A joint is at rest if it moved by less (rad or m) between two looks, 0.25 s apart. This is above the noise of
# encoders.
STANDS = 0.002
# The longest names of joints, in characters together, that fit into the line to the stopper: 50 joints of 40
# characters.
MOST_CHARS = 2000


class Trajectory(Outgoing):
    """A trajectory that was judged. Its stamp is zero, so it begins when it arrives: the sender's clock may be late."""

    def __init__(self, topic: TrajectoryTopic, message: Any) -> None:
        self._topic = topic
        self.value = message
        self.moves = bool(message.points)

    def data(self) -> bytes:
        """Return the serialized trajectory.

        Raise `OperationError` of kind `bad_request` if no fail-safe is in force.
        """
        self._topic.check_driven()
        if self.moves:
            self._topic.about_to_follow(self.value)
        return self._topic.stamped(self.value)

    def has_left(self) -> None:
        """Record that the joints may move from now on."""
        self._topic.commands += 1
        self._topic.is_moving = self._topic.is_moving or self.moves


class TrajectoryTopic(VelocityTopic):
    """A topic of a joint trajectory controller; `send_zero` sends the hold of all `joints`
    commanded since they last rested.

    `moves` is True until a hold has arrived, or until the time of the trajectory is over and the joints are at rest.
    """

    def __init__(
        self,
        name: str,
        type_name: str,
        interface: Any,
        *,
        joint_states: JointStates,
        clock: RobotClock,
        changed: Callable[[str, str], None],
        lifeline: Lifeline | None = None,
    ) -> None:
        super().__init__(name, type_name, interface, clock=clock, changed=changed, lifeline=lifeline)
        self._joint_states = joint_states
        self._awaited: tuple[str, ...] = ()
        self._until = -math.inf
        self._seen: Sequence[float] = ()
        self._problem = ""
        joint_states.follow()
        interfaces.load(POINT)  # in advance: a hold must not wait for it

    @property
    def needs_zero(self) -> bool:
        """Whether a fail-safe has to send a hold.

        Joints at rest need none: another node may be about to move them.
        """
        return self.moves

    def command(self, data: bytes) -> Trajectory:
        """Decode and judge a trajectory of the server or of another node.

        Raises:
            OperationError: of kind `bad_request`, if it cannot be sent.
        """
        self.check_driven()
        message = decoded(data, self._interface, self.type)
        for index, point in enumerate(message.points):
            numbers = (*point.positions, *point.velocities, *point.accelerations, *point.effort)
            if not all(map(math.isfinite, numbers)):
                problem = f"points[{index}] has a number that is not finite: a motion needs finite numbers."
                raise OperationError("bad_request", problem)
        message.header.stamp.sec = message.header.stamp.nanosec = 0
        self._awaited = tuple(message.joint_names)
        return Trajectory(self, message)

    def wait_clock(self) -> Steps[None]:
        """Steps that wait until the positions of the joints are known, for the hold; at most 3.5 s."""
        deadline = time.monotonic() + MEASURED_S
        while self._joint_states.missing(self._awaited) and time.monotonic() < deadline:
            self._joint_states.follow()
            yield 10 * POLL_S

    def wait_stopper(self) -> Steps[Guarded]:
        """As for a velocity topic; the returned problem also names joints that could not be held."""
        guarded = yield from super().wait_stopper()
        missing = self._joint_states.missing(self._awaited)
        problem = f"no joint state has the position of {', '.join(missing)}, so no hold can be sent" if missing else ""
        return Guarded(guarded.waited_s, problem or guarded.problem)

    def about_to_follow(self, message: Any) -> None:
        """Record the joints of a trajectory that leaves next, and notify the stoppers before it does."""
        before = self.joints if self.moves else ()
        joints = tuple(dict.fromkeys((*before, *message.joint_names)))
        last = message.points[-1].time_from_start
        self._until, self._seen = time.monotonic() + last.sec + last.nanosec * 1e-9, ()
        has_changed, self.joints = joints != self.joints, joints if len("".join(joints)) <= MOST_CHARS else ()
        self.about_to_move()
        if has_changed:
            self.tell()

    def stamped(self, message: Any) -> bytes:
        """Return the trajectory as CDR with a zero stamp, so that it begins when it arrives."""
        message.header.stamp.sec = message.header.stamp.nanosec = 0
        return rcl.serialize(message)

    def look_for_rest(self) -> None:
        """Set `moves` to False if the hold has arrived, or if the time of the trajectory is over
        and the joints are at rest.
        """
        super().look_for_rest()
        if not self.moves:
            return
        if self._joint_states.missing(self.joints):
            self._joint_states.follow()
            return
        positions = self._joint_states.positions(self.joints)
        moved = max((abs(now - before) for now, before in zip(positions, self._seen, strict=False)), default=math.inf)
        self._seen = positions
        if time.monotonic() > self._until and moved < STANDS:
            self.moves = self.is_moving = False
            self.tell()

    def audience(self) -> tuple[object, ...]:
        """Return a value that changes when the hold has to be sent again: with the matches, or when
        the positions become known.
        """
        return not self._joint_states.missing(self.joints), *super().audience()

    def outcome(self) -> StoppedTopic:
        """Return how many subscribers received the hold, or the reason why no hold could be sent."""
        told = super().outcome()
        return {**told, "acked": False, "problem": self._problem} if self._problem else told

    def stop_message(self) -> Any:
        """Return the hold: one point at the measured positions. Raise `ValueError` if the positions are not known."""
        self._problem = ""
        try:
            if not self.joints:
                raise ValueError("it is not known which they are")
            positions = self._joint_states.positions(self.joints)
        except ValueError as error:
            self._problem = f"The joints of {self.name} could not be held: {error}."
            raise
        hold: Any = self._interface()
        hold.joint_names = list(self.joints)
        point: Any = interfaces.load(POINT)()
        point.positions = positions
        hold.points = [point]
        return hold


def topic_of(name: str, type_name: str, interface: Any, *, joint_states: JointStates, **more: Any) -> VelocityTopic:
    """Return a `TrajectoryTopic` or a `VelocityTopic`, depending on the type."""
    if type_name in HOLD_TYPES:
        return TrajectoryTopic(name, type_name, interface, joint_states=joint_states, **more)
    return VelocityTopic(name, type_name, interface, **more)
