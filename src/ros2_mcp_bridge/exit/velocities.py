"""Velocity commands have one exit: decoded, judged, stamped with the robot's *now*, and ended by a zero made here.

Nothing that a server or another node made is passed on as bytes: what leaves is serialized anew.
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

# While zeros wait for matches and acknowledgements; on one machine, either comes within milliseconds.
POLL_S = 0.005
# After a match, best effort: a subscriber discovers the publisher a little later than it is discovered, mostly within
# 0.1 s; the rest is for a machine that is held up (with the first two alone, 1 of 200 dead bridges under load left one
# without), and the last for what waits for the middleware's next announcement (3 s). So a stopper sends, too: its
# second and third are for what is told below, a little sooner as it begins only when its bridge has ended. Chosen.
AGAIN_AFTER_S = (0.1, 0.34, 0.4, 1.5, 3.5)
# A stopper that has not heard yet of a zero that has arrived sends another one, no more. Chosen.
REST_S = 0.25
# After a zero, it is sent again to whoever acknowledges nothing: what is sent to him at one moment may be lost, most
# of all while Fast DDS gives up a port of its shared memory and opens another, which takes up to 0.33 s. Chosen: the
# second is after that, and within the 0.5 s in which a robot is to have its zero.
UNSURE_AGAIN_S = (0.1, 0.4, 1.0)
# Between two looks at whether it is time to. Chosen.
UNSURE_POLL_S = 0.03
# A new bridge knows the robot after 4 s at most on a quiet network; on a bad one the zero still has to come. Chosen.
DISCOVERED_S = 10.0


class Exit(Protocol):
    """What a velocity topic needs of its publishers; `kind` is their reliability and durability."""

    kind: tuple[str, str]

    def publish_zero(self, data: bytes) -> None:
        """Hand it to the middleware, whatever was stopped."""
        ...

    def matched(self) -> int:
        """The number of subscribers that would get a message now."""
        ...

    def has_all_matched(self) -> bool:
        """Whether every subscriber that can match does, as far as discovery has come."""
        ...

    def acknowledged(self) -> bool | None:
        """Whether every subscriber has acknowledged everything; None where one of them acknowledges nothing."""
        ...

    def done(self) -> bool:
        """Whether nobody who acknowledges has still to do so."""
        ...


class Outgoing:
    """One message that is published once or again and again: `value` is what was decoded, None where nothing was.

    `is_clamped` says that it was made smaller to be within the limits of the policy; `moves` that a robot may go on
    after it until a zero.
    """

    value: Any = None
    is_clamped = False
    moves = False

    def data(self) -> bytes:
        """Its bytes as they are to be sent now."""
        raise NotImplementedError

    def has_left(self) -> None:
        """They were sent."""


class Raw(Outgoing):
    """A message of a type that we know nothing of: sent as it is."""

    def __init__(self, data: bytes) -> None:
        self._data = data

    def data(self) -> bytes:
        """The bytes as they came."""
        return self._data


class Decoded(Outgoing):
    """A message that a policy sets limits to: serialized anew, so that nothing rides behind."""

    def __init__(self, value: Any) -> None:
        self.value = value

    def data(self) -> bytes:
        """Its bytes as it is now."""
        return rcl.serialize(self.value)


class Command(Outgoing):
    """A velocity command that was judged; each time that it is sent, it is stamped anew."""

    def __init__(self, topic: VelocityTopic, message: Any) -> None:
        self._topic = topic
        self.value = message
        self.moves = any(floats_of(message.__class__)[1](message))

    def data(self) -> bytes:
        """Its bytes, stamped now; refused where no fail-safe is in force."""
        self._topic.check_driven()
        if self.moves:
            self._topic.about_to_move()
        return self._topic.stamped(self.value)

    def has_left(self) -> None:
        """The robot may move from now on, and the zero keeps the frame."""
        self._topic.commanded(self.value.header.frame_id if self._topic.is_stamped else "", moves=self.moves)
        self._topic.is_moving = any(floats_of(self.value.__class__)[1](self.value))


def decoded(data: bytes, interface: Any, type_name: str) -> Any:
    """The message in these bytes, as every node of the robot would read it.

    Raises `OperationError` of kind `bad_request`.
    """
    try:
        return rcl.deserialize(data, interface)
    except Exception as error:  # the middlewares raise errors of many kinds
        raise OperationError("bad_request", f"The message is no {type_name}: {error}") from error


def judged(data: bytes, interface: Any, type_name: str) -> Any:
    """The message in these bytes, which cannot be but finite.

    Raises `OperationError` of kind `bad_request`.
    """
    message = decoded(data, interface, type_name)
    names, read = floats_of(interface)
    for path, number in zip(names, read(message), strict=True):
        if not math.isfinite(number):
            raise OperationError("bad_request", f"{path} is {number}: a velocity command has to be finite.")
    return message


class VelocityTopic:
    """One topic that moves the robot: its publishers, the frame of its last command, and whether it is driven.
    One kind moves `joints` (see `trajectories.py`); the others have none.

    It is driven while a request holds it: a fail-safe that is in force, a repeat, a relay. It `moves` from its first
    command that is no zero until a zero is known to have arrived. The last such command left at `moved_at` (monotonic,
    s). `rested` is told of zeros.
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
        """Whether a fail-safe is to send a zero."""
        return True

    @property
    def is_driven(self) -> bool:
        """Whether somebody answers for its end."""
        return bool(self.holders)

    def check_driven(self) -> None:
        """Raise `OperationError` of kind `bad_request` where no fail-safe is in force."""
        if not self.holders:
            problem = f"{self.name} moves the robot, and no fail-safe is in force for it: nothing was sent."
            raise OperationError("bad_request", problem)

    def command(self, data: bytes) -> Outgoing:
        """A message of the server or of another node, judged; raises `OperationError` of kind `bad_request`."""
        self.check_driven()
        return Command(self, judged(data, self._interface, self.type))

    def wait_clock(self) -> Steps[None]:
        """Steps until the robot's *now* is known, where it is simulated; at most 1 s."""
        deadline = time.monotonic() + FIRST_S
        while self.is_stamped and self._clock.is_awaited(self.name, self.matched) and time.monotonic() < deadline:
            yield POLL_S

    def stamped(self, message: Any) -> bytes:
        """The CDR of a message, stamped now where it has a header."""
        if self.is_stamped:
            stamp = message.header.stamp
            stamp.sec, stamp.nanosec = divmod(self._clock.now_ns(self.name, self.matched), NS_PER_S)
        return rcl.serialize(message)

    def call_stopper(self) -> None:
        """A command that moves is to come: a stopper is to be there, which knows this topic."""
        if self._lifeline:
            self._lifeline.begin(self)

    def wait_stopper(self) -> Steps[Guarded]:
        """Steps until the stopper reaches the subscribers, too; at most 2 s, and only for the first command."""
        return (yield from self._lifeline.wait(self)) if self._lifeline else Guarded()

    def profiles(self) -> list[tuple[str, str]]:
        """Reliability and durability of each of its publishers, none of them twice."""
        return sorted({publisher.kind for publisher in list(self.publishers)})

    def about_to_move(self) -> None:
        """A command that moves leaves next: the stopper has to know before it does."""
        self.moved_at = time.monotonic()
        self._has_zero = False
        if not self.moves:
            self.moves = True
            self.tell()

    def look_for_rest(self) -> None:
        """It moves no more if its zero has arrived wherever that can be known, and was sent again where it cannot."""
        if not (self.moves and self._has_zero) or (self._again_at and self._is_unsure()):
            return
        if all(publisher.done() for publisher in self.publishers):
            self.moves = False
            self.tell()

    @property
    def waits_to_send_again(self) -> bool:
        """Whether its zero may have to be sent again."""
        return bool(self._again_at)

    def send_again(self) -> None:
        """Send the zero again if it is time to, and somebody is matched who acknowledges nothing."""
        if not self._again_at or time.monotonic() < self._again_at[0]:
            return
        del self._again_at[0]
        if self.needs_zero and self._is_unsure():
            self._send_zero()

    def _is_unsure(self) -> bool:
        return any(each.matched() and each.acknowledged() is None for each in list(self.publishers))

    def commanded(self, frame_id: str, *, moves: bool = True) -> None:
        """A command has left, in this frame."""
        self.commands += 1
        self._has_zero = not moves
        if moves:
            self._again_at = []
        if frame_id != self.frame_id:
            self.frame_id = frame_id
            self._changed(self.name, frame_id)
            self.tell()

    def tell(self) -> None:
        """Tell the stopper what has become of it."""
        if self._lifeline:
            self._lifeline.tell(self)

    def matched(self) -> int:
        """The number of subscribers of its publishers; those that match several are counted once."""
        return max((publisher.matched() for publisher in list(self.publishers)), default=0)

    def send_zero(self) -> None:
        """Send the zero from any thread: twice, for best-effort subscribers, and later again; through every publisher
        there is.

        One that fails does not keep the others from being sent, and does not end what sends them.
        """
        self._send_zero()
        self._again_at = [time.monotonic() + after_s for after_s in UNSURE_AGAIN_S]

    def _send_zero(self) -> None:
        try:
            data = self.stamped(self.stop_message())
        except Exception as error:  # noqa: BLE001 - whatever it is, other topics are stopped
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
        """What ends the motion, to be stamped: all zero, in the frame of the last command."""
        message = self._interface()
        if self.is_stamped:
            message.header.frame_id = self.frame_id
        return message

    def _log_unsent(self, error: Exception) -> None:
        sys.stderr.write(f"{self.name} could not be stopped: {error}\n")

    def stop_whoever_comes(self) -> Steps[None]:
        """Steps that send the zero now, and for a while to every subscriber that is discovered, until a command."""
        zero, deadline = Zero(self), time.monotonic() + DISCOVERED_S
        while time.monotonic() < deadline:
            yield POLL_S
            zero.send()

    def audience(self) -> tuple[object, ...]:
        """Who would get a zero now, and whether its stamp would be right: whenever that changes, it is sent again."""
        is_heard = self.is_stamped and self._clock.is_heard
        return is_heard, *(publisher.matched() for publisher in self.publishers)

    def has_all_matched(self) -> bool:
        """Whether all of its subscribers are matched."""
        return all(publisher.has_all_matched() for publisher in self.publishers)

    def outcome(self) -> StoppedTopic:
        """How many got its last messages, and whether that is known."""
        told = {publisher.acknowledged() for publisher in self.publishers if publisher.matched()}
        acked = False if False in told else None if None in told or not told else True
        return {"topic": self.name, "type": self.type, "matched": self.matched(), "acked": acked, "problem": ""}


class Zero:
    """The zero of one topic: sent now, and again for whoever is discovered later, unless it is commanded meanwhile."""

    def __init__(self, topic: VelocityTopic) -> None:
        self.topic = topic
        self._commands = topic.commands
        self._audience: object = None
        self._again_at: list[float] = []
        self.send()

    def send(self) -> None:
        """Send it again if it is time to."""
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
    """All velocity topics that have a publisher here or are driven; `make` makes one."""

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
        """Whether there is any. From any thread."""
        return bool(self._topics)

    def driven(self) -> list[VelocityTopic]:
        """Those for whose end somebody answers."""
        return [topic for topic in list(self._topics.values()) if topic.is_driven]

    def moving_joints(self) -> set[str]:
        """The joints that a fail-safe would have to hold now."""
        return {joint for topic in self.driven() if topic.moves for joint in topic.joints}

    def topic(self, request: Request) -> VelocityTopic | None:
        """The velocity topic that a request names; None if it is of another type."""
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
        """A context in which the request answers for the end of a topic.

        Raises `OperationError` of kind `bad_request` for one topic too many.
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
        """Nothing is kept of a topic that nobody holds and that has no publisher."""
        if not topic.holders and not topic.publishers:
            self._topics.pop((topic.name, topic.type), None)
            self._clock.forget(topic.name)

    def have_moved(self, since: float) -> bool:
        """Whether the last message on one of the topics is a command that is no zero, or one left since that time."""
        return any(topic.is_moving or topic.moved_at >= since for topic in self.driven())

    def watch(self) -> Steps[None]:
        """Steps that see which topics have come to rest, and send the zero again on those of which it is not known."""
        while True:
            waits = any(topic.waits_to_send_again for topic in list(self._topics.values()))
            yield UNSURE_POLL_S if waits else Seldom(REST_S)
            for topic in list(self._topics.values()):
                topic.send_again()
            self.look_for_rest()

    def look_for_rest(self) -> None:
        """Tell the stopper of topics whose zero has arrived."""
        for topic in list(self._topics.values()):
            topic.look_for_rest()

    def send_zeros(self) -> None:
        """Zeros on all driven topics, from any thread."""
        for topic in self.driven():
            if topic.needs_zero:
                topic.send_zero()

    def send_missed_zeros(self) -> None:
        """Zeros once more where one is not acknowledged: the middleware repeats what was lost after seconds only."""
        for topic in self.driven():
            if topic.needs_zero and not all(publisher.done() for publisher in topic.publishers):
                topic.send_zero()

    def stop(self, topics: list[VelocityTopic], wait_match_s: float, wait_ack_s: float) -> Steps[list[StoppedTopic]]:
        """Steps that send zeros, again for whoever is discovered meanwhile, until all have them or time is up."""
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
