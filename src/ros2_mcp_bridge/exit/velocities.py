"""The exit for velocity commands: each is decoded, judged, stamped with the robot's current time, and ended by a zero.

The bytes of a server or another node are never passed on: every command is serialized again.
"""

from __future__ import annotations

import math
import sys
import time
from collections.abc import Callable, Generator
from contextlib import contextmanager
from typing import Any, Protocol

from ros2_mcp_bridge.exit.lifeline import Guarded, Lifeline
from ros2_mcp_bridge.loop import Seldom
from ros2_mcp_bridge.request import OperationError, Request, Steps
from ros2_mcp_bridge.ros import rcl
from ros2_mcp_bridge.ros.clock import FIRST_S, NS_PER_S, RobotClock
from ros2_mcp_common.policy.fields import floats_of
from ros2_mcp_common.policy.velocity import MOTION_TYPES, VELOCITY_TYPES
from ros2_mcp_common.wire.limits import MAX_FAILSAFES
from ros2_mcp_common.wire.protocol import FrameIdChanged, StoppedTopic

# The polling period while zeros wait for matches and acknowledgements. On one machine, either comes within
# milliseconds.
POLL_S = 0.005
# Delays after which a best-effort zero is repeated, because a subscriber discovers the publisher a little later than it
# is discovered. Mostly 0.1 s is enough. The next ones are for a loaded machine: with the first two alone, after 1 of
# 200 bridge deaths under load a subscriber got no zero. The last is for the middleware's next announcement (every 3 s).
# A stopper uses the same delays. For it, the second and third also serve the purpose of `UNSURE_AGAIN_S`; they are a
# little shorter, as it begins only after its bridge has ended.
AGAIN_AFTER_S = (0.1, 0.34, 0.4, 1.5, 3.5)
# The period at which arrived zeros are looked for. If a stopper does not know yet that a zero arrived, it sends one
# more.
REST_S = 0.25
# Delays after which a zero is repeated for subscribers that do not acknowledge. A single message may be lost, mostly
# while Fast DDS replaces a port of its shared memory, which takes up to 0.33 s. The second delay is after that, and
# within the 0.5 s in which a robot has to receive its zero.
UNSURE_AGAIN_S = (0.1, 0.4, 1.0)
# The polling period for these repetitions.
UNSURE_POLL_S = 0.03
# For how long a new bridge sends zeros to subscribers that it discovers. Discovery takes 4 s at most on a quiet
# network; on a bad one the zero still has to come.
DISCOVERED_S = 10.0


class Exit(Protocol):
    """A publisher, as a velocity topic uses it; `kind` is its reliability and durability."""

    kind: tuple[str, str]

    def publish_zero(self, data: bytes) -> None:
        """Publish this serialized zero, even if publishing was stopped."""
        ...

    def matched(self) -> int:
        """Return the number of matched subscribers."""
        ...

    def has_all_matched(self) -> bool:
        """Return whether every compatible subscriber discovered so far is matched."""
        ...

    def acknowledged(self) -> bool | None:
        """Return whether all subscribers have acknowledged everything, or None if a subscriber (best effort) never
        acknowledges.
        """
        ...

    def done(self) -> bool:
        """Return whether no acknowledgement is outstanding."""
        ...


class Outgoing:
    """One message, published once or repeatedly: `value` is the decoded message, or None if it was not decoded.

    `is_clamped` is True if the values were reduced to the limits of the policy, `moves` if the robot may go on moving
    after the message until a zero.
    """

    value: Any = None
    is_clamped = False
    moves = False

    def data(self) -> bytes:
        """Return the bytes to be sent now."""
        raise NotImplementedError

    def has_left(self) -> None:
        """Called after the message was published."""


class Raw(Outgoing):
    """A message of a type without limits, sent unchanged."""

    def __init__(self, data: bytes) -> None:
        self._data = data

    def data(self) -> bytes:
        """Return the bytes unchanged."""
        return self._data


class Decoded(Outgoing):
    """A message of a type with limits in the policy. It is serialized again, so that no extra bytes follow it."""

    def __init__(self, value: Any) -> None:
        self.value = value

    def data(self) -> bytes:
        """Return the serialized message with its current values."""
        return rcl.serialize(self.value)


class Command(Outgoing):
    """A velocity command that was judged. It is stamped each time it is sent."""

    def __init__(self, topic: VelocityTopic, message: Any) -> None:
        self._topic = topic
        self.value = message
        self.moves = any(floats_of(message.__class__)[1](message))

    def data(self) -> bytes:
        """Return the message, stamped now. Raise `OperationError` of kind `bad_request` if no fail-safe is in force."""
        self._topic.check_driven()
        if self.moves:
            self._topic.about_to_move()
        return self._topic.stamped(self.value)

    def has_left(self) -> None:
        """Record that the robot may move now, and the frame of this command: its zero will use the same frame."""
        self._topic.commanded(self.value.header.frame_id if self._topic.is_stamped else "", moves=self.moves)
        self._topic.is_moving = any(floats_of(self.value.__class__)[1](self.value))


def decoded(data: bytes, interface: Any, type_name: str) -> Any:
    """Return the message in these bytes, as every node of the robot would decode it.

    Raises:
        OperationError: of kind `bad_request`, if the bytes are no message of this type.
    """
    try:
        return rcl.deserialize(data, interface)
    except Exception as error:  # the middlewares raise errors of many kinds
        raise OperationError("bad_request", f"The message is no {type_name}: {error}") from error


def judged(data: bytes, interface: Any, type_name: str) -> Any:
    """Return the message in these bytes, with only finite numbers.

    Raises:
        OperationError: of kind `bad_request`, if the bytes are no message of this type or a number is not finite.
    """
    message = decoded(data, interface, type_name)
    names, read = floats_of(interface)
    for path, number in zip(names, read(message), strict=True):
        if not math.isfinite(number):
            raise OperationError("bad_request", f"{path} is {number}: a velocity command has to be finite.")
    return message


class VelocityTopic:
    """One topic that moves the robot: its publishers, the frame of its last command, and whether it is driven.

    It is driven while a request holds it: a fail-safe in force, a repeat, or a relay. `moves` is True from its first
    nonzero command until a zero is known to have arrived. `moved_at` is when the last nonzero command left (monotonic,
    s). `rested` is called after each zero. `joints` is used only by `TrajectoryTopic`; here it is empty.
    """

    def __init__(
        self,
        name: str,
        type_name: str,
        interface: Any,
        *,
        clock: RobotClock,
        changed: Callable[[str, str], None],
        lifeline: Lifeline | None = None,
    ) -> None:
        self.name = name
        self.type = type_name
        self.is_stamped = VELOCITY_TYPES.get(type_name, False)
        self.joints: tuple[str, ...] = ()
        self.frame_id = ""
        self.commands = 0
        self.is_moving = False
        self.moved_at = -math.inf
        self.moves = False
        self.holders: dict[Request, None] = {}
        self.publishers: dict[Exit, None] = {}
        self.rested: Callable[[], None] = lambda: None
        self._interface = interface
        self._clock = clock
        self._changed = changed
        self._lifeline = lifeline
        self._has_zero = False
        self._again_at: list[float] = []

    @property
    def needs_zero(self) -> bool:
        """Whether a fail-safe has to send a zero."""
        return True

    @property
    def is_driven(self) -> bool:
        """Whether a request holds this topic, and so ensures that its motion is ended."""
        return bool(self.holders)

    def check_driven(self) -> None:
        """Raise `OperationError` of kind `bad_request` if no fail-safe is in force."""
        if not self.holders:
            problem = f"{self.name} moves the robot, and no fail-safe is in force for it: nothing was sent."
            raise OperationError("bad_request", problem)

    def command(self, data: bytes) -> Outgoing:
        """Decode and judge a message of the server or of another node.

        Raises:
            OperationError: of kind `bad_request`, if it cannot be sent.
        """
        self.check_driven()
        return Command(self, judged(data, self._interface, self.type))

    def wait_clock(self) -> Steps[None]:
        """Steps that wait, if stamps need simulated time, until that time is known; at most 1 s."""
        deadline = time.monotonic() + FIRST_S
        while self.is_stamped and self._clock.is_awaited(self.name, self.matched) and time.monotonic() < deadline:
            yield POLL_S

    def stamped(self, message: Any) -> bytes:
        """Return the message as CDR, with the current time of the robot in its header if it has a header."""
        if self.is_stamped:
            stamp = message.header.stamp
            stamp.sec, stamp.nanosec = divmod(self._clock.now_ns(self.name, self.matched), NS_PER_S)
        return rcl.serialize(message)

    def call_stopper(self) -> None:
        """Start the stoppers, if necessary, and send them this topic before a command that moves the robot."""
        if self._lifeline:
            self._lifeline.begin(self)

    def wait_stopper(self) -> Steps[Guarded]:
        """Steps that wait until the stoppers have matched the subscribers, too: at most 2 s, and
        only for the first command.
        """
        return (yield from self._lifeline.wait(self)) if self._lifeline else Guarded()

    def profiles(self) -> list[tuple[str, str]]:
        """Return the distinct pairs of reliability and durability of its publishers."""
        return sorted({publisher.kind for publisher in list(self.publishers)})

    def about_to_move(self) -> None:
        """Record that a nonzero command leaves next, and notify the stoppers before it does."""
        self.moved_at = time.monotonic()
        self._has_zero = False
        if not self.moves:
            self.moves = True
            self.tell()

    def look_for_rest(self) -> None:
        """Set `moves` to False if the zero has arrived: acknowledged by all subscribers that
        acknowledge, repeated for the others.
        """
        if not (self.moves and self._has_zero) or (self._again_at and self._is_unsure()):
            return
        if all(publisher.done() for publisher in self.publishers):
            self.moves = False
            self.tell()

    @property
    def waits_to_send_again(self) -> bool:
        """Whether repetitions of the zero are still due."""
        return bool(self._again_at)

    def send_again(self) -> None:
        """Repeat the zero if it is due and a matched subscriber does not acknowledge."""
        if not self._again_at or time.monotonic() < self._again_at[0]:
            return
        del self._again_at[0]
        if self.needs_zero and self._is_unsure():
            self._send_zero()

    def _is_unsure(self) -> bool:
        return any(each.matched() and each.acknowledged() is None for each in list(self.publishers))

    def commanded(self, frame_id: str, *, moves: bool = True) -> None:
        """Record that a command has left, in this frame."""
        self.commands += 1
        self._has_zero = not moves
        if moves:
            self._again_at = []
        if frame_id != self.frame_id:
            self.frame_id = frame_id
            self._changed(self.name, frame_id)
            self.tell()

    def tell(self) -> None:
        """Send the stoppers the current state of this topic."""
        if self._lifeline:
            self._lifeline.tell(self)

    def matched(self) -> int:
        """Return the number of matched subscribers of the publisher that has the most, since several publishers may
        match the same subscriber.
        """
        return max((publisher.matched() for publisher in list(self.publishers)), default=0)

    def send_zero(self) -> None:
        """Send the zero through every publisher, twice each for best-effort subscribers, and schedule its
        repetitions. Thread-safe.

        If one publisher fails, the others still send, and no error is raised.
        """
        self._send_zero()
        self._again_at = [time.monotonic() + after_s for after_s in UNSURE_AGAIN_S]

    def _send_zero(self) -> None:
        try:
            data = self.stamped(self.stop_message())
        except Exception as error:  # noqa: BLE001 - whatever it is, the other topics must be stopped
            self._log_unsent(error)
            return
        for publisher in list(self.publishers):
            try:
                publisher.publish_zero(data)
                publisher.publish_zero(data)
                self.is_moving = False
                self.rested()
            except Exception as error:  # noqa: BLE001 - the other publishers may reach the robot
                self._log_unsent(error)
        self._has_zero = True

    def stop_message(self) -> Any:
        """Return the message that ends the motion, not stamped yet: all zeros, in the frame of the last command."""
        message = self._interface()
        if self.is_stamped:
            message.header.frame_id = self.frame_id
        return message

    def _log_unsent(self, error: Exception) -> None:
        sys.stderr.write(f"{self.name} could not be stopped: {error}\n")

    def stop_whoever_comes(self) -> Steps[None]:
        """Steps that send the zero now, and for 10 s to every newly discovered subscriber,
        until another command is sent.
        """
        zero, deadline = Zero(self), time.monotonic() + DISCOVERED_S
        while time.monotonic() < deadline:
            yield POLL_S
            zero.send()

    def audience(self) -> tuple[object, ...]:
        """Return a value that changes when a zero has to be sent again: with the matches, or when
        simulated time becomes known.
        """
        is_heard = self.is_stamped and self._clock.is_heard
        return is_heard, *(publisher.matched() for publisher in self.publishers)

    def has_all_matched(self) -> bool:
        """Return whether every compatible subscriber discovered so far is matched."""
        return all(publisher.has_all_matched() for publisher in self.publishers)

    def outcome(self) -> StoppedTopic:
        """Return the number of matched subscribers and whether they acknowledged the last
        messages (None: not known).
        """
        told = {publisher.acknowledged() for publisher in self.publishers if publisher.matched()}
        acked = False if False in told else None if None in told or not told else True
        return {"topic": self.name, "type": self.type, "matched": self.matched(), "acked": acked, "problem": ""}


class Zero:
    """The zero of one topic: sent now, and again when a subscriber is discovered, until another command is sent."""

    def __init__(self, topic: VelocityTopic) -> None:
        self.topic = topic
        self._commands = topic.commands
        self._audience: object = None
        self._again_at: list[float] = []
        self.send()

    def send(self) -> None:
        """Send the zero again if it is due."""
        if self.topic.commands != self._commands:
            return
        now, audience = time.monotonic(), self.topic.audience()
        if audience != self._audience:
            self._audience = audience
            self._again_at = [now + after_s for after_s in AGAIN_AFTER_S]
            self.topic.send_zero()
        elif self._again_at and now >= self._again_at[0]:
            del self._again_at[0]
            self.topic.send_zero()


class Velocities:
    """All velocity topics that have a publisher here or are driven; `make` constructs such a topic."""

    def __init__(
        self,
        clock: RobotClock,
        send_event: Callable[[FrameIdChanged], None],
        lifeline: Lifeline | None = None,
        make: Callable[..., VelocityTopic] = VelocityTopic,
    ) -> None:
        self._make = make
        self._clock = clock
        self._send_event = send_event
        self._lifeline = lifeline
        self._topics: dict[tuple[str, str], VelocityTopic] = {}

    @property
    def has_topics(self) -> bool:
        """Whether there is any velocity topic. Thread-safe."""
        return bool(self._topics)

    def driven(self) -> list[VelocityTopic]:
        """Return the topics that a request holds."""
        return [topic for topic in list(self._topics.values()) if topic.is_driven]

    def moving_joints(self) -> set[str]:
        """Return the names of the joints that a fail-safe would have to hold now."""
        return {joint for topic in self.driven() if topic.moves for joint in topic.joints}

    def topic(self, request: Request) -> VelocityTopic | None:
        """Return the velocity topic that a request names, or None if its type is no velocity command or trajectory."""
        name, type_name = request.text("topic"), request.text("type")
        if type_name not in MOTION_TYPES:
            return None
        if (name, type_name) not in self._topics:
            clock, changed = self._clock, self._tell_frame_id
            self._topics[name, type_name] = self._make(
                name, type_name, request.interface, clock=clock, changed=changed, lifeline=self._lifeline
            )
        return self._topics[name, type_name]

    @contextmanager
    def hold(self, topic: VelocityTopic | None, request: Request) -> Generator[None, None, None]:
        """A context manager in which the request holds the topic, and so ensures that its motion is ended.

        Raises:
            OperationError: of kind `bad_request`, if too many topics are driven already.
        """
        if topic is None:
            yield
            return
        if not topic.is_driven and len(self.driven()) >= MAX_FAILSAFES:
            problem = (
                f"{MAX_FAILSAFES} topics that move the robot are driven already, the most that can have a fail-safe."
            )
            raise OperationError("bad_request", problem, "Stop what is no longer needed.")
        if topic.is_stamped:
            self._clock.follow()
        topic.holders[request] = None
        try:
            yield
        finally:
            topic.holders.pop(request, None)
            if not topic.holders and self._lifeline:
                self._lifeline.forget(topic)
            self.forget(topic)

    def forget(self, topic: VelocityTopic) -> None:
        """Remove a topic that no request holds and that has no publisher."""
        if not topic.holders and not topic.publishers:
            self._topics.pop((topic.name, topic.type), None)
            self._clock.forget(topic.name)

    def have_moved(self, since: float) -> bool:
        """Return whether a driven topic is moving (its last message was no zero), or sent a
        nonzero command after `since`.
        """
        return any(topic.is_moving or topic.moved_at >= since for topic in self.driven())

    def watch(self) -> Steps[None]:
        """Steps that repeat zeros where their arrival is not known, and record which topics have come to rest."""
        while True:
            waits = any(topic.waits_to_send_again for topic in list(self._topics.values()))
            yield UNSURE_POLL_S if waits else Seldom(REST_S)
            for topic in list(self._topics.values()):
                topic.send_again()
            self.look_for_rest()

    def look_for_rest(self) -> None:
        """Tell the stoppers which topics need no zero any more because their last zero has arrived."""
        for topic in list(self._topics.values()):
            topic.look_for_rest()

    def send_zeros(self) -> None:
        """Send zeros on all driven topics that need zeros. Thread-safe."""
        for topic in self.driven():
            if topic.needs_zero:
                topic.send_zero()

    def send_missed_zeros(self) -> None:
        """Send zeros again where a zero is not acknowledged: the middleware itself takes seconds to resend a lost
        message.
        """
        for topic in self.driven():
            if topic.needs_zero and not all(publisher.done() for publisher in topic.publishers):
                topic.send_zero()

    def stop(self, topics: list[VelocityTopic], wait_match_s: float, wait_ack_s: float) -> Steps[list[StoppedTopic]]:
        """Steps that send zeros, also to subscribers discovered meanwhile, until all have
        received them or the time is up.
        """
        zeros = [Zero(topic) for topic in topics]
        yield from _until(zeros, lambda: all(topic.has_all_matched() for topic in topics), wait_match_s)
        yield from _until(zeros, lambda: all(topic.outcome()["acked"] is not False for topic in topics), wait_ack_s)
        return [topic.outcome() for topic in topics]

    def _tell_frame_id(self, topic: str, frame_id: str) -> None:
        self._send_event({"event": "frame", "topic": topic, "frame_id": frame_id})


def _until(zeros: list[Zero], is_done: Callable[[], bool], wait_s: float) -> Steps[None]:
    deadline = time.monotonic() + wait_s
    while not is_done() and time.monotonic() < deadline:
        yield POLL_S
        for zero in zeros:
            zero.send()
