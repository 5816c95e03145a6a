"""Relays: the messages of one topic appear on another, as bytes, for a while.

A relay without a source is fed by the server, which sees values and so can compare and change them.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from contextlib import suppress
from functools import partial
from typing import TYPE_CHECKING

from ros2_mcp_bridge.exit.lifeline import Guarded
from ros2_mcp_bridge.exit.velocities import Velocities
from ros2_mcp_bridge.loop import Loop
from ros2_mcp_bridge.request import Cancelled, OperationError, Request, Steps
from ros2_mcp_bridge.ros import qos
from ros2_mcp_bridge.ros.graph import Graph
from ros2_mcp_bridge.stream import Sample
from ros2_mcp_bridge.topics.publishers import Publisher
from ros2_mcp_bridge.topics.subscriptions import (
    DEPTH_FOR_ALL,
    DRAIN_AT_MOST_S,
    DRAIN_PERIOD_S,
    LAST_DRAIN_S,
    RawSubscription,
)
from ros2_mcp_common.policy.velocity import MOTION_TYPES
from ros2_mcp_common.rhythm import Rhythm
from ros2_mcp_common.wire.protocol import EndedBy, RelayCounts, RelayEnd, RelayFeedReply, RelayReply, RelaysReply

if TYPE_CHECKING:
    from rclpy.node import Node

# A relay that is fed has nothing to do but to notice that its time is over. Chosen.
FED_PERIOD_S = 0.25
# The publishers are looked up only while none is matched. Chosen.
CHECK_EVERY_S = 0.1
# A burst must fit while a subscriber is slow; a relay that drives has 1 (decision 10).
DEPTH = 100
# As for repeats, only the first message is waited for; a relay begins more rarely and has more to lose. Chosen.
FIRST_ACK_S = 1.0
# Fast DDS asks every 3 s for what is missing: a subscriber that discovered us late then gets all of it.
LAST_ACK_S = 3.5


class FollowedSource:
    """The subscription of a relay as publishers come and go: made when the first is there, and made anew for others.

    Its QoS is the strongest that every publisher offers.
    """

    def __init__(self, node: Node, graph: Graph, request: Request) -> None:
        self._graph = graph
        self._topic, self._type = request.text("source"), request.text("type")
        self._open = partial(RawSubscription, node, graph, self._topic, request.interface)
        self._checked_next = 0.0
        self._chosen: dict[str, str] | None = None
        self.subscription: RawSubscription | None = None

    def resubscribe(self) -> None:
        """Every 0.1 s, where nobody is matched: subscribe so that all publishers in the graph match."""
        if time.monotonic() < self._checked_next:
            return
        self._checked_next = time.monotonic() + CHECK_EVERY_S
        if self.subscription is not None and self.subscription.publisher_count():
            return
        profiles = [p.qos_profile for p in self._graph.publishers(self._topic) if p.topic_type == self._type]
        reliable = all(profile.reliability.name == "RELIABLE" for profile in profiles)
        latched = all(profile.durability.name == "TRANSIENT_LOCAL" for profile in profiles)
        chosen = {
            "reliability": "reliable" if reliable else "best_effort",
            "durability": "transient_local" if latched else "volatile",
        }
        if profiles and chosen != self._chosen:
            self._chosen = chosen
            self.destroy()
            lost = self.subscription.lost if self.subscription else 0
            self.subscription = self._open(qos.profile(chosen, DEPTH_FOR_ALL))
            self.subscription.lost = lost

    @property
    def is_latched(self) -> bool:
        """Whether it is given what was sent before."""
        return self._chosen is not None and self._chosen["durability"] == "transient_local"

    def destroy(self) -> None:
        """End receiving."""
        if self.subscription is not None:
            self.subscription.destroy()


class Relay:
    """One relay with its entities and counts: `passed` messages were published, of which `limited` less than they
    were; `dropped` were held back by the rate, and `refused` by the policy, or as velocity commands that are not finite
    or cannot be decoded.
    """

    def __init__(
        self, *, node: Node, graph: Graph, loop: Loop, create: Callable[..., Publisher], request: Request
    ) -> None:
        # A depth of 1 is acknowledged at once (see `Publisher`), which a zero needs; else a burst must fit.
        self._awaits_first_ack = request.text("type") in MOTION_TYPES
        self._rhythm = Rhythm(request.rate()) if request.has("rate_hz") else None
        self._source = FollowedSource(node, graph, request) if request.has("source") else None
        self.publisher = create(request=request, max_depth=1 if self._awaits_first_ack else DEPTH)
        self._request = request
        self._loop = loop
        self._started = time.monotonic()
        self._has_begun = self.is_running = False
        self.passed = 0
        self.dropped = 0
        self.refused = 0
        self.limited = 0
        self.ended_by: EndedBy = ""
        self._guarded = Guarded()

    def run(self, duration_s: float) -> Steps[None]:
        """Steps that relay: first wait for the subscribers, so that they miss nothing."""
        self.publisher.call_stopper()
        yield from self.publisher.wait_match(True, self._request.number("wait_match_s", 0.0))
        yield from self.publisher.wait_clock()
        self._guarded = yield from self.publisher.wait_stopper()
        self._has_begun, self.is_running, self._started = True, True, time.monotonic()
        end = self._started + (duration_s or math.inf)
        while time.monotonic() < end:
            pause = self._relay_waiting()
            yield from self.wait_first_ack()
            yield max(0.0, min(pause, end - time.monotonic()))

    def publish(self, data: bytes) -> None:
        """Pass one message on, unless it has ended; afterwards `wait_first_ack`, before the next replaces it.

        Raises `Cancelled` if the relay is not to act any more.
        """
        if not self.is_running:
            return
        try:
            self.limited += self.publisher.publish(self.publisher.outgoing(data, self._request), self._request)
        except Cancelled:
            raise
        except OperationError:
            self.refused += 1
        else:
            self.passed += 1

    def wait_first_ack(self) -> Steps[None]:
        """Steps until the first message is acknowledged, where there is no room for a second one beside it.

        A subscriber discovers a new publisher a little later than the publisher discovers the subscriber.
        """
        if self._awaits_first_ack and self.passed:
            self._awaits_first_ack = False
            yield from self.publisher.wait_acknowledged(FIRST_ACK_S)

    def finish(self) -> Steps[RelayEnd]:
        """Steps that pass on what has come, send the zero of a velocity and wait until it has arrived; its counts."""
        deadline = time.monotonic() + LAST_DRAIN_S
        with suppress(Cancelled):  # a stop, which lets nothing pass on
            while self.is_running and self._relay_waiting() == 0.0 and time.monotonic() < deadline:
                yield 0.0
        counts, velocity = self.counts(), self.publisher.velocity
        self.is_running = False
        if velocity is not None and self._has_begun:
            velocity.send_zero()
        self.publisher.limits.end()  # nobody else could: the publisher ends with the relay
        yield from self.publisher.wait_acknowledged(LAST_ACK_S)
        return {**counts, "final_sent": velocity is not None and self._has_begun}

    def counts(self) -> RelayCounts:
        """What became of the messages so far."""
        subscription = self._source.subscription if self._source else None
        return {
            "running": self.is_running,
            "passed": self.passed,
            "dropped": self.dropped,
            "refused": self.refused,
            "limited": self.limited,
            "lost": subscription.lost if subscription else 0,
            "publishers": subscription.publisher_count() if subscription else 0,
            "matched": self.publisher.matched(),
            "elapsed_s": round(time.monotonic() - self._started, 6),
            "stopper_s": self._guarded.waited_s,
            "unguarded": self._guarded.problem,
        }

    def destroy(self) -> None:
        """End it."""
        if self._source is not None:
            self._source.destroy()
        self.publisher.destroy()

    def _relay_waiting(self) -> float:
        """Relay what the middleware holds, from whoever publishes; returns when to come again, in seconds."""
        if self._source is None:
            return FED_PERIOD_S
        self._source.resubscribe()
        subscription, started = self._source.subscription, time.monotonic()
        if subscription is None:
            return DRAIN_PERIOD_S
        if not subscription.drain(self._take_in, self._loop.turn_of(DRAIN_AT_MOST_S)):
            return 0.0
        subscription.check_publishers()
        return started + DRAIN_PERIOD_S - time.monotonic()

    def _take_in(self, sample: Sample) -> bool:
        """Relay one sample; true where it must be acknowledged before the next."""
        if self._rhythm is None or self._rhythm.passes(sample.received_ns):
            self.publish(sample.data)
        else:
            self.dropped += 1
        return self._awaits_first_ack and self.passed > 0


class Relays:
    """All relays of the bridge, by the names that the server gave them."""

    def __init__(self, velocities: Velocities, create: Callable[..., Relay]) -> None:
        self._velocities = velocities
        self._create = create
        self._open: dict[str, Relay] = {}

    def relay(self, request: Request) -> Steps[RelayReply]:
        """Relay until its time is over or the request is ended, then send the zero where it is a velocity."""
        name, duration_s = request.text("name"), request.number("duration_s", 0.0)
        if name in self._open:
            raise OperationError("bad_request", f"There is a relay {name!r} already.")
        relay = self._open[name] = self._create(request=request)
        try:
            if relay.publisher.velocity is not None:
                relay.publisher.velocity.check_driven()
            with self._velocities.hold(relay.publisher.velocity, request):
                try:
                    yield from relay.run(duration_s)
                except Cancelled as cancelled:
                    relay.ended_by = cancelled.ended_by
                finally:
                    request.task = None  # it ends now, and cannot be cancelled any more
                    counts = yield from relay.finish()
        finally:
            self._open.pop(name, None)
            relay.destroy()
        return {**counts, "ended_by": relay.ended_by}

    def feed(self, request: Request) -> Steps[RelayFeedReply]:
        """Publish messages through a relay of that name: the body is one after the other, of these sizes."""
        relay, offset = self._open.get(request.text("name")), 0
        sizes = request.sizes("sizes")
        if relay is not None and relay.ended_by in ("stop", "lease", "latch", "stopper"):
            raise Cancelled(relay.ended_by)
        if relay is None or not relay.is_running:
            raise OperationError("not_found", f"There is no running relay {request.text('name')!r}.")
        passed_before = relay.passed
        for size in sizes:
            try:
                request.check_accepted()
                relay.publish(request.body[offset : offset + size])
                yield from relay.wait_first_ack()
            except Cancelled as cancelled:
                if relay.passed == passed_before:
                    raise
                sent = f"{relay.passed - passed_before} of {len(sizes)} messages had been sent"
                raise Cancelled(cancelled.ended_by, sent) from None
            offset += size
        return {"passed": relay.passed}

    def counts(self, _request: Request) -> RelaysReply:
        """What became of the messages of every relay so far."""
        return {"relays": {name: relay.counts() for name, relay in self._open.items()}}

    def publishers(self) -> list[Publisher]:
        """Those through which messages may still be under way."""
        return [relay.publisher for relay in self._open.values()]

    def clear(self) -> None:
        """End all."""
        while self._open:
            self._open.popitem()[1].destroy()
