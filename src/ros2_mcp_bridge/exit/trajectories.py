"""Joint trajectories: a motion that goes on by itself, and is ended by a hold where the joints are measured to be.

A joint trajectory controller follows the newest trajectory on its topic. One point with the positions of now, to be
reached at once, is what it does itself where a goal is cancelled (ros2_controllers, `set_hold_position`). An empty
trajectory stops nothing: it is refused there.
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
# Between two looks, 0.25 s apart: a joint that has moved by less stands. Above encoders' noise. Chosen.
STANDS = 0.002
# Names of joints are told to the stopper in one line; 50 joints of 40 characters. Chosen.
MOST_CHARS = 2000


class Trajectory(Outgoing):
    """A trajectory that was judged. It begins when it arrives: its stamp is zero, as whoever stamps it may be late."""

    def __init__(self, topic: TrajectoryTopic, message: Any) -> None:
        self._topic = topic
        self.value = message
        self.moves = bool(message.points)

    def data(self) -> bytes:
        """Its bytes; refused where no fail-safe is in force."""
        self._topic.check_driven()
        if self.moves:
            self._topic.about_to_follow(self.value)
        return self._topic.stamped(self.value)

    def has_left(self) -> None:
        """The joints may move from now on."""
        self._topic.commands += 1
        self._topic.is_moving = self._topic.is_moving or self.moves


class TrajectoryTopic(VelocityTopic):
    """A topic that a joint trajectory controller listens to; `send_zero` sends the hold of all `joints` that were
    commanded since they stood. It moves until a hold has arrived, or until the time of the trajectory is over and the
    joints stand.
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
        interfaces.load(POINT)  # now, and not when it has to be quick

    @property
    def needs_zero(self) -> bool:
        """Whether a fail-safe has anything to end: what stands may be moved by others."""
        return self.moves

    def command(self, data: bytes) -> Trajectory:
        """A trajectory of the server or of another node, judged; raises `OperationError` of kind `bad_request`."""
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
        """Steps until it is known where the joints are, which is needed to hold them; at most 3.5 s."""
        deadline = time.monotonic() + MEASURED_S
        while self._joint_states.missing(self._awaited) and time.monotonic() < deadline:
            self._joint_states.follow()
            yield 10 * POLL_S

    def wait_stopper(self) -> Steps[Guarded]:
        """As of a velocity; and in words if nobody could hold the joints."""
        guarded = yield from super().wait_stopper()
        missing = self._joint_states.missing(self._awaited)
        problem = f"no joint state has the position of {', '.join(missing)}, so no hold can be sent" if missing else ""
        return Guarded(guarded.waited_s, problem or guarded.problem)

    def about_to_follow(self, message: Any) -> None:
        """A trajectory leaves next: the stopper has to know its joints before it does."""
        before = self.joints if self.moves else ()
        joints = tuple(dict.fromkeys((*before, *message.joint_names)))
        last = message.points[-1].time_from_start
        self._until, self._seen = time.monotonic() + last.sec + last.nanosec * 1e-9, ()
        has_changed, self.joints = joints != self.joints, joints if len("".join(joints)) <= MOST_CHARS else ()
        self.about_to_move()
        if has_changed:
            self.tell()

    def stamped(self, message: Any) -> bytes:
        """The CDR of a trajectory that begins when it arrives."""
        message.header.stamp.sec = message.header.stamp.nanosec = 0
        return rcl.serialize(message)

    def look_for_rest(self) -> None:
        """It moves no more if its hold has arrived, or its time is over and the joints stand."""
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
        """Who would get a hold now, and whether there is one: as soon as there is, it is sent."""
        return not self._joint_states.missing(self.joints), *super().audience()

    def outcome(self) -> StoppedTopic:
        """How many got the hold, and why there is none."""
        told = super().outcome()
        return {**told, "acked": False, "problem": self._problem} if self._problem else told

    def stop_message(self) -> Any:
        """The hold; raises `ValueError` where it is not known where the joints are."""
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
    """A topic that moves the robot, of whichever kind its type is."""
    if type_name in HOLD_TYPES:
        return TrajectoryTopic(name, type_name, interface, joint_states=joint_states, **more)
    return VelocityTopic(name, type_name, interface, **more)
