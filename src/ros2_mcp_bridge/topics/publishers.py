"""Publishing bytes: once with proof of who got it, or repeatedly at a rate that the bridge keeps by itself."""

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

# While a publication waits for a match or an acknowledgement: on one machine, either comes within milliseconds.
POLL_S = 0.002
# Fast DDS answers 5 ms after it was asked: so long an acknowledgement is looked for more often, at 30 µs a look.
SOON_S, SOON_POLL_S = 0.01, 0.0005
# Chosen: if no further subscriber has matched for so long, the others are not waited for, only counted.
NO_MORE_MATCHES_S = 0.1
# A repeat waits for the acknowledgement of its first message only, which a second one would replace; afterwards it goes
# on without. Chosen.
FIRST_ACK_S = 0.5
# Before the answer of a repeat that has ended: its final message was sent twice, and does not depend on this. Chosen.
FINAL_ACK_S = 0.1
# A subscriber discovers a new publisher a little later than the publisher discovers the subscriber. Chosen.
DISCOVERED_S = 0.1
# A listing of the subscribers costs as much as publishing. It holds while their number is the same, for so long: then
# one that has taken the place of another is seen, too. Only what is told of a message depends on it. Chosen.
LISTED_S = 1.0
# A latched publisher keeps as many messages for late joiners as it was asked for, up to this. Chosen.
MAX_LATCHED_DEPTH = 1000
# A period counts as missed, or the end as reached, with this share of a period to spare: sums of floats are inexact.
ROUNDING = 1e-6


class Publisher:
    """A publisher of serialized messages, with the `velocity` topic that it belongs to, if it is of such a type.

    `publish` is the one exit of what the server or another node has made; `limits` is what the policy says of it.
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
        self.limits = limiter.topic(request)  # first of all: nothing is made for what is not allowed
        self._graph = graph
        self._velocities = velocities
        self._topic, self._type = request.text("topic"), request.text("type")
        self._joint_states = joint_states if self._type == JOINT_STATE else None
        # Fast DDS asks for acknowledgement at once (5 ms) only when its history is full, else every 3 s. A depth of 1
        # is always full. Nobody can tell the difference but late joiners of a transient-local topic.
        is_volatile = request.qos().get("durability") != "transient_local"
        max_depth = max_depth or (1 if is_volatile else MAX_LATCHED_DEPTH)
        wanted = request.qos()
        if (
            self._type in MOTION_TYPES
        ):  # whoever comes late, or was held up, gets the newest command: after a stop, the zero
            wanted, max_depth = {**wanted, "history": "keep_last"}, 1
        self._profile = qos.profile(wanted, max_depth=max_depth)
        self.kind: tuple[str, str] = (self._profile.reliability.name.lower(), self._profile.durability.name.lower())
        self.is_busy = False
        self._accepted: tuple[int, int] | None = None
        self._listed: tuple[tuple[int, int], float, list[bool], int] | None = None
        self._interface = request.interface
        self._raw = rcl.publisher(node, request.interface, self._topic, self._profile)
        self.velocity = velocities.topic(request)  # not before: nothing is kept of a publisher that could not be made
        if self.velocity is not None:
            self.velocity.publishers[self] = None
            self.velocity.rested = self.limits.rest
            self.limits.zeros[self.velocity] = self.velocity.send_zero
        else:
            self.limits.zeros[self] = self._send_default

    def outgoing(self, data: bytes, request: Request) -> Outgoing:
        """What `publish` takes; raises `OperationError` for what is refused."""
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
        """Hand one message to the middleware: returns whether less was sent than was wanted, by a limit or its ramp.

        Raises `Cancelled` if its request is not to act any more, `OperationError` if the policy does not let it out.
        """
        with self.limits.passing(message.value, request) as is_held_back:
            request.leave()
            if self._joint_states:
                self._joint_states.publishes(message.value)
            data = message.data()  # from here on it moves, as far as the stopper knows
            self._raw.publish_raw(data)
        message.has_left()
        return message.is_clamped or is_held_back

    def publish_zero(self, data: bytes) -> None:
        """Hand a zero to the middleware: no stop holds it back. From any thread."""
        self._raw.publish_raw(data)

    def _send_default(self) -> None:
        """What ends a command of a type that is no velocity, where a limit says how long it may hold."""
        self.publish_zero(rcl.serialize(self._interface()))

    def is_needed(self) -> bool:
        """Whether a zero may have to go through it."""
        return self.limits.is_held or (self.velocity is not None and self.velocity.is_driven)

    def matched(self) -> int:
        """The number of subscribers that would get a message now."""
        return self._raw.get_subscription_count()

    def ours(self) -> int:
        """The number of matched subscribers that are this server's own: its reads, recordings, relays, black box."""
        return min(self._lately_listed()[1], self.matched())

    def endpoints(self) -> tuple[int, int]:
        """How many publishers and subscribers its topic has, whoever they are."""
        return self._graph.count(self._topic)

    def wait_match(self, created: bool, wait_s: float) -> Steps[None]:
        """Steps until every subscriber in the graph that can match does, or no more of them come, or time is up."""
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
            yield DISCOVERED_S  # a best-effort subscriber would not ask for what it has missed

    def has_all_matched(self) -> bool:
        """Whether every subscriber that can match does, as far as discovery has come."""
        return self._graph.settled and self.matched() >= len(self._subscribers_reliable())

    def wait_clock(self) -> Steps[None]:
        """Steps until the time of its stamps is known."""
        if self.velocity is not None:
            yield from self.velocity.wait_clock()

    def call_stopper(self, message: Outgoing | None = None) -> None:
        """A velocity is to come: this message, if it is known already. A zero waits for nobody."""
        if self.velocity is not None and (message is None or message.moves):
            self.velocity.call_stopper()

    def wait_stopper(self, message: Outgoing | None = None) -> Steps[Guarded]:
        """Steps until the stopper is ready for it, as far as it is waited for."""
        if self.velocity is None or (message is not None and not message.moves):
            return Guarded()
        return (yield from self.velocity.wait_stopper())

    def publish_acknowledged(
        self, message: Outgoing, request: Request, wait_s: float
    ) -> Steps[tuple[int, bool | None, bool]]:
        """Steps that publish one message after the other: returns the number of matches, `wait_acknowledged`, and
        whether less was sent than was wanted.
        """
        while self.is_busy:
            yield POLL_S
        self.is_busy = True
        try:
            matched = self.matched()
            is_limited = self.publish(message, request)
            yield 0.0  # what else is to be published goes first
            acked = yield from self.wait_acknowledged(wait_s)
        finally:
            self.is_busy = False
        return matched, acked, is_limited

    def wait_acknowledged(self, wait_s: float) -> Steps[bool | None]:
        """Steps until all that acknowledge have done so, or time is up: returns `acknowledged`."""
        began_at = time.monotonic()
        while (is_acked := self._acknowledged(self._lately_listed()[0])) is False:
            waited_s = time.monotonic() - began_at
            if waited_s >= wait_s:
                break
            yield SOON_POLL_S if waited_s < SOON_S else POLL_S
        return is_acked

    def acknowledged(self) -> bool | None:
        """Whether every subscriber has acknowledged everything; None where one of them acknowledges nothing.

        False as long as a reliable one has not: it is worth waiting for.
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
        """Whether every reliable subscriber has acknowledged everything."""
        return rcl.is_acknowledged(self._raw)

    def destroy(self) -> None:
        """End it."""
        if self.velocity is not None:
            self.velocity.publishers.pop(self, None)
            self._velocities.forget(self.velocity)
        if self.velocity is None or not self.velocity.publishers:
            self.limits.zeros.pop(self.velocity or self, None)
        self._raw.destroy_when_not_in_use()

    def _lately_listed(self) -> tuple[list[bool], int]:
        """`_subscribers_reliable`, and how many subscribers of its type are this bridge's own."""
        now, present = time.monotonic(), (self.matched(), self._graph.count(self._topic)[1])
        if self._listed is None or self._listed[0] != present or now - self._listed[1] > LISTED_S:
            own = self._graph.own_subscribers(self._topic, self._type)
            self._listed = present, now, self._subscribers_reliable(), own
        return self._listed[2:]

    def _subscribers_reliable(self) -> list[bool]:
        """For each subscriber in the graph that can match, whether it is reliable."""
        return [
            info.qos_profile.reliability.name == "RELIABLE"
            for info in self._graph.subscribers(self._topic)
            if info.topic_type == self._type and qos.offers_enough(self._profile, info.qos_profile)
        ]


class Repeat:
    """Repeated publishing of one message; `send_event` tells the server when the first one has left."""

    def __init__(self, request: Request, send_event: Callable[[RepeatBegun], None]) -> None:
        self._request = request
        self._send_event = send_event
        self.sent = 0
        self.limited = 0
        self.late = 0
        self.started = time.monotonic()

    def run(self, publisher: Publisher, message: Outgoing, rate_hz: float, duration_s: float) -> Steps[None]:
        """Steps that publish at the rate; periods that were missed are counted and not made up for."""
        period = 1.0 / rate_hz
        self._publish(publisher, message)
        if self._request.has("name"):
            self._send_event(RepeatBegun(event="begun", name=self._request.text("name")))
        # A subscriber may not know a new publisher yet, and with a depth of 1 the second message replaces the first.
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
    """Pooled publishers and what is done with them; `send_event` tells the server that a repeat has begun."""

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
        """Publish once, when the subscribers are matched, and wait for their acknowledgement."""
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
        """Publish at a rate for a while, then the zero where it is a velocity command."""
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
                    request.task = None  # it ends now, and cannot be cancelled any more
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
        """The topic is driven, and gets its zero when the server is gone, unless the request is cancelled before.

        With `now` it gets one at once, as of a robot that a former bridge has left moving.
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
        """The pooled publisher that a request names: a context of it and whether it was created for it."""
        key = (request.text("topic"), request.text("type"), tuple(sorted(request.qos().items())))
        return self.pool.use(key, lambda: self._create(request=request))
