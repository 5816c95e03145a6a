"""Publishing bytes: once with proof of who got it, or repeatedly at a rate that the bridge keeps by itself."""

from __future__ import annotations

import time
from collections.abc import Hashable
from contextlib import AbstractContextManager
from functools import partial
from typing import TYPE_CHECKING

from . import protocol, qos, rcl
from .failsafes import FailSafes
from .graph import Graph
from .pool import Pool
from .protocol import PublishReply, RepeatReply
from .request import Cancelled, OperationError, Request, Steps

if TYPE_CHECKING:
    from rclpy.node import Node

# While a publication waits for a match or an acknowledgement: on one machine, either comes within milliseconds.
POLL_S = 0.002
# Chosen: if no further subscriber has matched for so long, the others are not waited for, only counted.
NO_MORE_MATCHES_S = 0.1
# A repeat waits for the acknowledgement of its first message only, which a second one would replace; afterwards it goes
# on without. Chosen.
FIRST_ACK_S = 0.5
# Before the answer of a repeat that has ended: its final message was sent twice, and does not depend on this. Chosen.
FINAL_ACK_S = 0.1
# A subscriber discovers a new publisher a little later than the publisher discovers the subscriber. Chosen.
DISCOVERED_S = 0.1
# A latched publisher keeps as many messages for late joiners as it was asked for, up to this. Chosen.
MAX_LATCHED_DEPTH = 1000
# A period counts as missed, or the end as reached, with this share of a period to spare: sums of floats are inexact.
ROUNDING = 1e-6


class Publisher:
    """A publisher of serialized messages."""

    def __init__(self, node: Node, graph: Graph, request: Request, max_depth: int | None = None) -> None:
        self._graph = graph
        self._topic, self._type = request.text("topic"), request.text("type")
        # Fast DDS asks for acknowledgement at once (5 ms) only when its history is full, else every 3 s. A depth of 1
        # is always full. Nobody can tell the difference but late joiners of a transient-local topic.
        is_volatile = request.qos().get("durability") != "transient_local"
        max_depth = max_depth or (1 if is_volatile else MAX_LATCHED_DEPTH)
        self._profile = qos.profile(request.qos(), max_depth=max_depth)
        self.is_busy = False
        self._accepted: tuple[int, int] | None = None
        self._raw = rcl.publisher(node, request.interface, self._topic, self._profile)

    def publish(self, data: bytes) -> None:
        """Hand one message to the middleware."""
        self._raw.publish_raw(data)

    def publish_last(self, data: bytes) -> Publisher | None:
        """Publish a final message, if there is one: twice, for best-effort subscribers; returns what is then `done`."""
        if not data:
            return None
        self.publish(data)
        self.publish(data)
        return self

    def matched(self) -> int:
        """The number of subscribers that would get a message now."""
        return self._raw.get_subscription_count()

    def wait_match(self, created: bool, wait_s: float) -> Steps[None]:
        """Steps until every subscriber in the graph that can match does, or no more of them come, or time is up."""
        changed_at = time.monotonic()
        deadline, before = changed_at + wait_s, None
        while time.monotonic() < deadline:
            matched, fitting = now = self.matched(), len(self._subscribers_reliable())
            if now != before:
                before, changed_at = now, time.monotonic()
            no_more = now == self._accepted or time.monotonic() - changed_at > NO_MORE_MATCHES_S
            if matched and (matched >= fitting or no_more) and (self._graph.settled or not created):
                break
            yield POLL_S
        self._accepted = before
        if created and self.matched() and not all(self._subscribers_reliable()):
            yield DISCOVERED_S  # a best-effort subscriber would not ask for what it has missed

    def publish_acknowledged(self, data: bytes, wait_s: float) -> Steps[tuple[int, bool | None]]:
        """Steps that publish one message after the other: returns the number of matches and `wait_acknowledged`."""
        while self.is_busy:
            yield POLL_S
        self.is_busy = True
        try:
            matched = self.matched()
            self.publish(data)
            acked = yield from self.wait_acknowledged(wait_s)
        finally:
            self.is_busy = False
        return matched, acked

    def wait_acknowledged(self, wait_s: float) -> Steps[bool | None]:
        """Steps until all is acknowledged: returns True, False when time is up, None where nobody acknowledges."""
        is_reliable = self._profile.reliability.name == "RELIABLE" and any(self._subscribers_reliable())
        if not is_reliable or not self.matched():
            return None
        deadline = time.monotonic() + wait_s
        while not self.done():
            if time.monotonic() >= deadline:
                return False
            yield POLL_S
        return True

    def done(self) -> bool:
        """Whether every reliable subscriber has acknowledged everything."""
        return rcl.is_acknowledged(self._raw)

    def destroy(self) -> None:
        """End it."""
        self._raw.destroy_when_not_in_use()

    def _subscribers_reliable(self) -> list[bool]:
        """For each subscriber in the graph that can match, whether it is reliable."""
        return [
            info.qos_profile.reliability.name == "RELIABLE"
            for info in self._graph.subscribers(self._topic)
            if info.topic_type == self._type and qos.offers_enough(self._profile, info.qos_profile)
        ]


class Repeat:
    """Repeated publishing of one message."""

    def __init__(self) -> None:
        self.sent = 0
        self.late = 0
        self.started = time.monotonic()

    def run(self, publisher: Publisher, message: bytes, rate_hz: float, duration_s: float) -> Steps[None]:
        """Steps that publish at the rate; periods that were missed are counted and not made up for."""
        period = 1.0 / rate_hz
        publisher.publish(message)
        self.sent = 1
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
            publisher.publish(message)
            self.sent += 1


class Publishers:
    """Pooled publishers and what is done with them."""

    def __init__(self, node: Node, graph: Graph, failsafes: FailSafes) -> None:
        self._node = node
        self._graph = graph
        self._failsafes = failsafes
        self.pool: Pool[Hashable, Publisher] = Pool(Publisher.destroy)

    def publish(self, request: Request) -> Steps[PublishReply]:
        """Publish once, when the subscribers are matched, and wait for their acknowledgement."""
        wait_match_s, wait_ack_s = request.number("wait_match_s", 0.0), request.number("wait_ack_s", 0.0)
        started = time.monotonic()
        with self._use(request) as (publisher, created):
            yield from publisher.wait_match(created, wait_match_s)
            matched, acked = yield from publisher.publish_acknowledged(request.body, wait_ack_s)
        waited_s = round(time.monotonic() - started, 6)
        return {"matched": matched, "acked": acked, "created": created, "waited_s": waited_s}

    def repeat(self, request: Request) -> Steps[RepeatReply]:
        """Publish at a rate for a while, then the final message."""
        rate_hz, duration_s = request.rate(), request.number("duration_s")
        wait_match_s = request.number("wait_match_s", 0.0)
        split_at = len(request.body) - int(request.number("final_size", 0))
        if split_at < 0:
            raise OperationError("bad_request", "repeat: final_size is larger than the body.")
        message, final = request.body[:split_at], request.body[split_at:]
        with self._use(request) as (publisher, created):
            repeat, ended_by = Repeat(), ""
            try:
                yield from publisher.wait_match(created, wait_match_s)
                with self._failsafes.in_force(request, partial(publisher.publish_last, final)):
                    yield from repeat.run(publisher, message, rate_hz, duration_s)
            except Cancelled as cancelled:
                ended_by = cancelled.ended_by
            finally:
                request.task = None  # it ends now, and cannot be cancelled any more
                elapsed_s = round(time.monotonic() - repeat.started, 6)
                publisher.publish_last(final)
            matched = publisher.matched()
            yield from publisher.wait_acknowledged(FINAL_ACK_S)
        return {
            "sent": repeat.sent,
            "matched": matched,
            "elapsed_s": elapsed_s,
            "late": repeat.late,
            "final_sent": bool(final),
            "ended_by": ended_by,
        }

    def failsafe(self, request: Request) -> Steps[protocol.Cancelled]:
        """A message to publish at the end, unless the request is cancelled before."""
        with self._use(request) as (publisher, _):
            action = partial(publisher.publish_last, request.body)
            return (yield from self._failsafes.until_cancelled(request, action))

    def _use(self, request: Request) -> AbstractContextManager[tuple[Publisher, bool]]:
        """The pooled publisher that a request names: a context of it and whether it was created for it."""
        key = (request.text("topic"), request.text("type"), tuple(sorted(request.qos().items())))
        return self.pool.use(key, lambda: Publisher(self._node, self._graph, request))
