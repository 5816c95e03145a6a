"""Velocity commands have one exit: decoded, judged, stamped with the robot's *now*, and ended by a zero made here.

Nothing that a server or another node made is passed on as bytes: what leaves is serialized anew.
"""

from __future__ import annotations

import math
import sys
import time
from collections.abc import Callable, Generator, Iterator
from contextlib import contextmanager
from typing import Any, Protocol

from . import rcl
from .clock import FIRST_S, NS_PER_S, RobotClock
from .limits import MAX_FAILSAFES
from .protocol import FrameIdChanged, StoppedTopic
from .request import OperationError, Request, Steps
from .velocity import VELOCITY_TYPES

# While zeros wait for matches and acknowledgements; on one machine, either comes within milliseconds.
POLL_S = 0.005
# After a match, best effort: a subscriber discovers the publisher a little later than it is discovered, mostly within
# 0.1 s; 0.5 s are for a machine that is held up. Chosen.
AGAIN_AFTER_S = (0.1, 0.5)
# A new bridge knows the robot after 4 s at most on a quiet network; on a bad one the zero still has to come. Chosen.
DISCOVERED_S = 10.0


class Exit(Protocol):
    """What a velocity topic needs of its publishers."""

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


class Outgoing(Protocol):
    """One message that is published once or again and again."""

    def data(self) -> bytes:
        """Its bytes as they are to be sent now."""
        ...

    def has_left(self) -> None:
        """They were sent."""
        ...


class Raw:
    """A message of a type that we know nothing of: sent as it is."""

    def __init__(self, data: bytes) -> None:
        self._data = data

    def data(self) -> bytes:
        """The bytes as they came."""
        return self._data

    def has_left(self) -> None:
        """Nothing to remember."""


class Command:
    """A velocity command that was judged; each time that it is sent, it is stamped anew."""

    def __init__(self, topic: VelocityTopic, message: Any) -> None:
        self._topic = topic
        self._message = message

    def data(self) -> bytes:
        """Its bytes, stamped now; refused where no fail-safe is in force."""
        self._topic.check_driven()
        return self._topic.stamped(self._message)

    def has_left(self) -> None:
        """The robot may move from now on, and the zero keeps the frame."""
        self._topic.commanded(self._message.header.frame_id if self._topic.is_stamped else "")


def judged(data: bytes, interface: Any, type_name: str) -> Any:
    """The message in these bytes, which cannot be but finite.

    Raises `OperationError` of kind `bad_request`.
    """
    try:
        message = rcl.deserialize(data, interface)
    except Exception as error:  # the middlewares raise errors of many kinds
        raise OperationError("bad_request", f"The message is no {type_name}: {error}") from error
    for path, number in _numbers(message):
        if not math.isfinite(number):
            raise OperationError("bad_request", f"{path} is {number}: a velocity command has to be finite.")
    return message


def _numbers(message: Any, prefix: str = "") -> Iterator[tuple[str, float]]:
    """The floating-point numbers of a message and of those in it, with their paths."""
    for name in message.get_fields_and_field_types():
        value = getattr(message, name)
        if isinstance(value, float):
            yield prefix + name, value
        elif hasattr(value, "get_fields_and_field_types"):
            yield from _numbers(value, f"{prefix}{name}.")


class VelocityTopic:
    """One topic that moves the robot: its publishers, the frame of its last command, and whether it is driven.

    It is driven while a request holds it: a fail-safe that is in force, a repeat, a relay.
    """

    def __init__(
        self, name: str, type_name: str, interface: Any, *, clock: RobotClock, changed: Callable[[str, str], None]
    ) -> None:
        self.name = name
        self.type = type_name
        self.is_stamped = VELOCITY_TYPES[type_name]
        self.frame_id = ""
        self.commands = 0
        self.holders: dict[Request, None] = {}
        self.publishers: dict[Exit, None] = {}
        self._interface = interface
        self._clock = clock
        self._changed = changed

    @property
    def is_driven(self) -> bool:
        """Whether somebody answers for its end."""
        return bool(self.holders)

    def check_driven(self) -> None:
        """Raise `OperationError` of kind `bad_request` where no fail-safe is in force."""
        if not self.holders:
            problem = f"{self.name} moves the robot, and no fail-safe is in force for it: nothing was sent."
            raise OperationError("bad_request", problem)

    def command(self, data: bytes) -> Command:
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

    def commanded(self, frame_id: str) -> None:
        """A command has left, in this frame."""
        self.commands += 1
        if frame_id != self.frame_id:
            self.frame_id = frame_id
            self._changed(self.name, frame_id)

    def matched(self) -> int:
        """The number of subscribers of its publishers; those that match several are counted once."""
        return max((publisher.matched() for publisher in list(self.publishers)), default=0)

    def send_zero(self) -> None:
        """Send the zero from any thread: twice, for best-effort subscribers; through every publisher there is.

        One that fails does not keep the others from being sent, and does not end what sends them.
        """
        try:
            message = self._interface()
            if self.is_stamped:
                message.header.frame_id = self.frame_id
            data = self.stamped(message)
        except Exception as error:  # noqa: BLE001 - whatever it is, other topics are stopped
            self._log_unsent(error)
            return
        for publisher in list(self.publishers):
            try:
                publisher.publish_zero(data)
                publisher.publish_zero(data)
            except Exception as error:  # noqa: BLE001 - the other publishers may reach the robot
                self._log_unsent(error)

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
        return {"topic": self.name, "type": self.type, "matched": self.matched(), "acked": acked}


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
    """All velocity topics that have a publisher here or are driven."""

    def __init__(self, clock: RobotClock, send_event: Callable[[FrameIdChanged], None]) -> None:
        self._clock = clock
        self._send_event = send_event
        self._topics: dict[tuple[str, str], VelocityTopic] = {}

    def driven(self) -> list[VelocityTopic]:
        """Those for whose end somebody answers."""
        return [topic for topic in list(self._topics.values()) if topic.is_driven]

    def topic(self, request: Request) -> VelocityTopic | None:
        """The velocity topic that a request names; None if it is of another type."""
        name, type_name = request.text("topic"), request.text("type")
        if type_name not in VELOCITY_TYPES:
            return None
        if (name, type_name) not in self._topics:
            clock, changed = self._clock, self._tell_frame_id
            self._topics[name, type_name] = VelocityTopic(
                name, type_name, request.interface, clock=clock, changed=changed
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
            problem = f"{MAX_FAILSAFES} topics that move the robot are driven already, and no more have a fail-safe."
            raise OperationError("bad_request", problem, "Stop what is no longer needed.")
        if topic.is_stamped:
            self._clock.follow()
        topic.holders[request] = None
        try:
            yield
        finally:
            topic.holders.pop(request, None)
            self.forget(topic)

    def forget(self, topic: VelocityTopic) -> None:
        """Nothing is kept of a topic that nobody holds and that has no publisher."""
        if not topic.holders and not topic.publishers:
            self._topics.pop((topic.name, topic.type), None)
            self._clock.forget(topic.name)

    def send_zeros(self) -> None:
        """Zeros on all driven topics, from any thread."""
        for topic in self.driven():
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
