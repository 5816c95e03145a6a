"""Publishing messages: once, with proof of who received it, or repeatedly at a rate that the bridge keeps."""

from __future__ import annotations

import time
from collections.abc import Callable, Hashable
from contextlib import AbstractContextManager
from typing import TYPE_CHECKING

from ros2_mcp_bridge.exit.failsafes import HOLD_S
from ros2_mcp_bridge.exit.lifeline import Guarded
from ros2_mcp_bridge.exit.limiter import Limiter, check_size
from ros2_mcp_bridge.exit.velocities import Decoded, Outgoing, Raw, Velocities, decoded
from ros2_mcp_bridge.request import Cancelled, OperationError, Request, Steps
from ros2_mcp_bridge.ros import qos, rcl
from ros2_mcp_bridge.ros.graph import Graph
from ros2_mcp_bridge.ros.joint_states import JOINT_STATE, JointStates
from ros2_mcp_bridge.topics.pool import Pool
from ros2_mcp_common.policy.velocity import MOTION_TYPES
from ros2_mcp_common.wire import protocol
from ros2_mcp_common.wire.protocol import PublishReply, RepeatBegun, RepeatReply

if TYPE_CHECKING:
    from rclpy.node import Node

# The polling period while a publication waits for a match or an acknowledgement. On one machine, either comes within
# milliseconds.
POLL_S = 0.002
# Fast DDS acknowledges 5 ms after it was asked. For SOON_S the acknowledgement is polled more often, at 30 µs a look.
SOON_S, SOON_POLL_S = 0.01, 0.0005
# If no further subscriber has matched for this time, the remaining ones are not waited for, only counted.
NO_MORE_MATCHES_S = 0.1
# The longest wait of a repeat for the acknowledgement of its first message, which the second one would replace.
FIRST_ACK_S = 0.5
# The longest wait before the answer of a repeat that has ended. Its final message was sent twice and does not depend on
# it.
FINAL_ACK_S = 0.1
# The wait for best-effort subscribers of a new publisher: a subscriber discovers the publisher a little later than the
# publisher discovers the subscriber.
DISCOVERED_S = 0.1
# For this time a listing of the subscribers is valid while their number is the same; then a replaced subscriber is
# seen, too. A listing costs as much as publishing, and only what is reported of a message depends on it.
LISTED_S = 1.0
# The most messages that a latched publisher keeps for late subscribers.
MAX_LATCHED_DEPTH = 1000
# The tolerance for rounding, as a share of a period, with which a period is missed or the end is reached.
ROUNDING = 1e-6


class Publisher:
    """A publisher of serialized messages, with its `velocity` topic if its type is a velocity command or trajectory.

    `publish` is the only exit for messages of the server or another node; `limits` are those of the policy.
    """

    def __init__(
        self,
        *,
        node: Node,
        graph: Graph,
        velocities: Velocities,
        limiter: Limiter,
        joint_states: JointStates,
        request: Request,
        max_depth: int | None = None,
    ) -> None:
        self.limits = limiter.topic(request)  # first of all: raises before anything is created
        self._graph = graph
        self._velocities = velocities
        self._topic, self._type = request.text("topic"), request.text("type")
        self._joint_states = joint_states if self._type == JOINT_STATE else None
        # Fast DDS asks for acknowledgement at once (5 ms) only when its history is full, else every 3 s. A depth of 1
        # is always full. Only late subscribers of a transient-local topic would notice the depth.
        is_volatile = request.qos().get("durability") != "transient_local"
        max_depth = max_depth or (1 if is_volatile else MAX_LATCHED_DEPTH)
        wanted = request.qos()
        if self._type in MOTION_TYPES:  # a late or delayed subscriber gets the newest command: after a stop, the zero
            wanted, max_depth = {**wanted, "history": "keep_last"}, 1
        self._profile = qos.profile(wanted, max_depth=max_depth)
        self.kind: tuple[str, str] = (self._profile.reliability.name.lower(), self._profile.durability.name.lower())
        self.is_busy = False
        self._accepted: tuple[int, int] | None = None
        self._listed: tuple[tuple[int, int], float, list[bool], int] | None = None
        self._interface = request.interface
        self._raw = rcl.publisher(node, request.interface, self._topic, self._profile)
        self.velocity = velocities.topic(request)  # not earlier: a publisher that could not be created leaves nothing
        if self.velocity is not None:
            self.velocity.publishers[self] = None
            self.velocity.rested = self.limits.rest
            self.limits.zeros[self.velocity] = self.velocity.send_zero
        else:
            self.limits.zeros[self] = self._send_default

    def outgoing(self, data: bytes, request: Request) -> Outgoing:
        """Return the message as `publish` takes it. Raise `OperationError` if it is refused or cannot be decoded."""
        if needs_value := self.limits.needs_value(request):
            check_size(data)
        if self.velocity is not None:
            message: Outgoing = self.velocity.command(data)
        elif needs_value or self._joint_states:
            message = Decoded(decoded(data, self._interface, self._type))
        else:
            return Raw(data)
        message.is_clamped = self.limits.fit(message.value, request)
        return message

    def publish(self, message: Outgoing, request: Request) -> bool:
        """Publish one message. Return whether its values were reduced by a limit or its ramp.

        Raises:
            Cancelled: if its request must not act any more.
            OperationError: if the policy refuses the message.
        """
        with self.limits.passing(message.value, request) as is_held_back:
            request.leave()
            if self._joint_states:
                self._joint_states.publishes(message.value)
            data = message.data()  # from here on the stoppers treat the topic as moving
            self._raw.publish_raw(data)
        message.has_left()
        return message.is_clamped or is_held_back

    def publish_zero(self, data: bytes) -> None:
        """Publish a serialized zero; neither a stop nor the policy holds it back. Thread-safe."""
        self._raw.publish_raw(data)

    def _send_default(self) -> None:
        """Publish the default value, which ends a command of another type when a limit's hold time is over."""
        self.publish_zero(rcl.serialize(self._interface()))

    def is_needed(self) -> bool:
        """Return whether a zero may have to be sent through this publisher."""
        return self.limits.is_held or (self.velocity is not None and self.velocity.is_driven)

    def matched(self) -> int:
        """Return the number of matched subscribers."""
        return self._raw.get_subscription_count()

    def ours(self) -> int:
        """Return the number of matched subscribers of this server itself: its reads, recordings, relays, black box."""
        return min(self._lately_listed()[1], self.matched())

    def endpoints(self) -> tuple[int, int]:
        """Return the numbers of all publishers and subscribers of its topic."""
        return self._graph.count(self._topic)

    def wait_match(self, created: bool, wait_s: float) -> Steps[None]:
        """Steps that wait until every compatible subscriber in the graph is matched, no more of
        them come, or the time is up.
        """
        changed_at = time.monotonic()
        deadline, before = changed_at + wait_s, None
        while time.monotonic() < deadline:
            matched, fitting = now = self.matched(), len(self._lately_listed()[0])
            if now != before:
                before, changed_at = now, time.monotonic()
            no_more = now == self._accepted or time.monotonic() - changed_at > NO_MORE_MATCHES_S
            if matched and (matched >= fitting or no_more) and (self._graph.settled or not created):
                break
            yield POLL_S
        self._accepted = before
        if created and self.matched() and not all(self._subscribers_reliable()):
            yield DISCOVERED_S  # a best-effort subscriber does not request missed messages

    def has_all_matched(self) -> bool:
        """Return whether every compatible subscriber discovered so far is matched, and discovery has settled."""
        return self._graph.settled and self.matched() >= len(self._subscribers_reliable())

    def wait_clock(self) -> Steps[None]:
        """Steps that wait until the time for its stamps is known."""
        if self.velocity is not None:
            yield from self.velocity.wait_clock()

    def call_stopper(self, message: Outgoing | None = None) -> None:
        """Start the stoppers for a velocity command to come: `message`, if it is known already. A zero needs none."""
        if self.velocity is not None and (message is None or message.moves):
            self.velocity.call_stopper()

    def wait_stopper(self, message: Outgoing | None = None) -> Steps[Guarded]:
        """Steps that wait, for a limited time, until the stoppers are ready for the message."""
        if self.velocity is None or (message is not None and not message.moves):
            return Guarded()
        return (yield from self.velocity.wait_stopper())

    def publish_acknowledged(
        self, message: Outgoing, request: Request, wait_s: float
    ) -> Steps[tuple[int, bool | None, bool]]:
        """Steps that publish a message, one at a time, and wait for its acknowledgement.

        Return the number of matched subscribers, the result of `wait_acknowledged`, and
        whether the values were reduced.
        """
        while self.is_busy:
            yield POLL_S
        self.is_busy = True
        try:
            matched = self.matched()
            is_limited = self.publish(message, request)
            yield 0.0  # other messages to publish go first
            acked = yield from self.wait_acknowledged(wait_s)
        finally:
            self.is_busy = False
        return matched, acked, is_limited

    def wait_acknowledged(self, wait_s: float) -> Steps[bool | None]:
        """Steps that wait until all subscribers that acknowledge have done so, or the time is
        up; return `acknowledged`.
        """
        began_at = time.monotonic()
        while (is_acked := self._acknowledged(self._lately_listed()[0])) is False:
            waited_s = time.monotonic() - began_at
            if waited_s >= wait_s:
                break
            yield SOON_POLL_S if waited_s < SOON_S else POLL_S
        return is_acked

    def acknowledged(self) -> bool | None:
        """Return whether all subscribers have acknowledged everything, or None if a subscriber never acknowledges.

        False as long as a reliable subscriber has not: then it is worth waiting.
        """
        return self._acknowledged(self._subscribers_reliable())

    def _acknowledged(self, reliable: list[bool]) -> bool | None:
        matched = self.matched()
        if not matched or self._profile.reliability.name != "RELIABLE" or not any(reliable):
            return None
        if not self.done():
            return False
        return True if all(reliable) and len(reliable) >= matched else None

    def done(self) -> bool:
        """Return whether every reliable subscriber has acknowledged everything."""
        return rcl.is_acknowledged(self._raw)

    def destroy(self) -> None:
        """Destroy the publisher."""
        if self.velocity is not None:
            self.velocity.publishers.pop(self, None)
            self._velocities.forget(self.velocity)
        if self.velocity is None or not self.velocity.publishers:
            self.limits.zeros.pop(self.velocity or self, None)
        self._raw.destroy_when_not_in_use()

    def _lately_listed(self) -> tuple[list[bool], int]:
        """Return a recent `_subscribers_reliable`, and the number of subscribers of its type
        that are this bridge's own.
        """
        now, present = time.monotonic(), (self.matched(), self._graph.count(self._topic)[1])
        if self._listed is None or self._listed[0] != present or now - self._listed[1] > LISTED_S:
            own = self._graph.own_subscribers(self._topic, self._type)
            self._listed = present, now, self._subscribers_reliable(), own
        return self._listed[2:]

    def _subscribers_reliable(self) -> list[bool]:
        """Return, for each compatible subscriber in the graph, whether it is reliable."""
        return [
            info.qos_profile.reliability.name == "RELIABLE"
            for info in self._graph.subscribers(self._topic)
            if info.topic_type == self._type and qos.offers_enough(self._profile, info.qos_profile)
        ]


class Repeat:
    """Repeated publishing of one message; `send_event` reports to the server that the first message was sent."""

    def __init__(self, request: Request, send_event: Callable[[RepeatBegun], None]) -> None:
        self._request = request
        self._send_event = send_event
        self.sent = 0
        self.limited = 0
        self.late = 0
        self.started = time.monotonic()

    def run(self, publisher: Publisher, message: Outgoing, rate_hz: float, duration_s: float) -> Steps[None]:
        """Steps that publish at the rate. Missed periods are counted as `late` and not made up for."""
        period = 1.0 / rate_hz
        self._publish(publisher, message)
        if self._request.has("name"):
            self._send_event(RepeatBegun(event="begun", name=self._request.text("name")))
        # A subscriber may not have discovered a new publisher yet, and with a depth of 1 the second message replaces
        # the first.
        yield from publisher.wait_acknowledged(FIRST_ACK_S)
        self.started = due = time.monotonic()
        end = self.started + duration_s
        while True:
            due += period
            behind_s = min(time.monotonic(), end) - due  # there are no periods after the end
            missed = int(max(0.0, behind_s) / period + ROUNDING)
            self.late += missed
            due += missed * period
            yield max(0.0, min(due, end) - time.monotonic())
            if due >= end - period * ROUNDING:
                return
            self._publish(publisher, message)

    def _publish(self, publisher: Publisher, message: Outgoing) -> None:
        self.limited += publisher.publish(message, self._request)
        self.sent += 1


class Publishers:
    """Pooled publishers and the operations on them; `send_event` reports to the server that a repeat has begun."""

    def __init__(
        self,
        velocities: Velocities,
        create: Callable[..., Publisher],
        send_event: Callable[[RepeatBegun], None],
    ) -> None:
        self._velocities = velocities
        self._send_event = send_event
        self._create = create
        self.pool: Pool[Hashable, Publisher] = Pool(Publisher.destroy, keeps=Publisher.is_needed)

    def publish(self, request: Request) -> Steps[PublishReply]:
        """Steps that publish once, when the subscribers are matched, and wait for their acknowledgement."""
        wait_match_s, wait_ack_s = request.number("wait_match_s", 0.0), request.number("wait_ack_s", 0.0)
        started = time.monotonic()
        with self.use(request) as (publisher, created):
            message = publisher.outgoing(request.body, request)
            publisher.call_stopper(message)
            yield from publisher.wait_match(created, wait_match_s)
            yield from publisher.wait_clock()
            guarded = yield from publisher.wait_stopper(message)
            matched, acked, is_limited = yield from publisher.publish_acknowledged(message, request, wait_ack_s)
            ours = publisher.ours()
            hold_s, endpoints = publisher.limits.hold_s, publisher.endpoints()
        return {
            "matched": matched,
            "ours": ours,
            "acked": acked,
            "created": created,
            "waited_s": round(time.monotonic() - started, 6),
            "limited": int(is_limited),
            "hold_s": hold_s,
            "endpoints": endpoints,
            "stopper_s": guarded.waited_s,
            "unguarded": guarded.problem,
        }

    def repeat(self, request: Request) -> Steps[RepeatReply]:
        """Steps that publish at a rate for a duration, and then the zero if it is a velocity command."""
        rate_hz, duration_s = request.rate(), request.number("duration_s")
        wait_match_s, ended_by, guarded = request.number("wait_match_s", 0.0), "", Guarded()
        with self.use(request) as (publisher, created):
            message = publisher.outgoing(request.body, request)
            repeat, velocity = Repeat(request, self._send_event), publisher.velocity
            with self._velocities.hold(velocity, request):
                try:
                    publisher.call_stopper(message)
                    yield from publisher.wait_match(created, wait_match_s)
                    yield from publisher.wait_clock()
                    guarded = yield from publisher.wait_stopper(message)
                    yield from repeat.run(publisher, message, rate_hz, duration_s)
                except Cancelled as cancelled:
                    ended_by = cancelled.ended_by
                finally:
                    request.task = None  # it is ending, and cannot be cancelled any more
                    elapsed_s = round(time.monotonic() - repeat.started, 6)
                    if velocity is not None:
                        velocity.send_zero()
                matched, ours = publisher.matched(), publisher.ours()
                yield from publisher.wait_acknowledged(FINAL_ACK_S)
        return {
            "sent": repeat.sent,
            "matched": matched,
            "ours": ours,
            "elapsed_s": elapsed_s,
            "late": repeat.late,
            "limited": repeat.limited,
            "final_sent": velocity is not None,
            "ended_by": ended_by,
            "stopper_s": guarded.waited_s,
            "unguarded": guarded.problem,
        }

    def failsafe(self, request: Request) -> Steps[protocol.Cancelled]:
        """Steps that hold a topic, which gets its zero when the server is gone, until the request is cancelled.

        With `now` it gets a zero at once, for a robot that a former bridge has left moving.
        """
        with self.use(request) as (publisher, _):
            velocity = publisher.velocity
            if velocity is None:
                problem = f"{request.text('type')} is not a velocity command: no command is known that stops it."
                raise OperationError("bad_request", problem)
            with self._velocities.hold(velocity, request):
                if not velocity.commands:
                    velocity.frame_id = request.text("frame", default=velocity.frame_id)
                    velocity.joints = tuple(request.texts("joints")) if request.has("joints") else ()
                try:
                    if request.flag("now"):
                        yield from velocity.stop_whoever_comes()
                    while True:
                        yield HOLD_S
                except Cancelled:
                    return {"cancelled": True}

    def use(self, request: Request) -> AbstractContextManager[tuple[Publisher, bool]]:
        """Return a context manager of the pooled publisher that a request names, and whether it
        was created for the request.
        """
        key = (request.text("topic"), request.text("type"), tuple(sorted(request.qos().items())))
        return self.pool.use(key, lambda: self._create(request=request))
