"""Relays: the messages of one topic are published on another, as bytes, for a while.

A relay without a source is fed by the server, which decodes values and so can compare and change them.
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

# The period of a relay that is fed, which only has to notice the end of its duration.
FED_PERIOD_S = 0.25
# The period at which publishers are looked up, which is done only while none is matched.
CHECK_EVERY_S = 0.1
# The depth of the publisher: a burst has to fit while a subscriber is slow. A relay of velocity commands has 1
# (decision 10).
DEPTH = 100
# The longest wait for the acknowledgement of the first message, as for repeats; longer, because relays begin more
# rarely and have more to lose.
FIRST_ACK_S = 1.0
# The longest wait at the end: Fast DDS asks every 3 s for missing messages, so a subscriber that discovered the
# publisher late then gets all of them.
LAST_ACK_S = 3.5


class FollowedSource:
    """The subscription of a relay, created when a first publisher is there, and again when others replace it.

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
        """Subscribe so that all publishers in the graph match; done every 0.1 s, while none is matched."""
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
        """Whether it receives messages sent before it subscribed."""
        return self._chosen is not None and self._chosen["durability"] == "transient_local"

    def destroy(self) -> None:
        """Destroy the subscription."""
        if self.subscription is not None:
            self.subscription.destroy()


class Relay:
    """One relay with its entities and counts.

    `passed` messages were published, `limited` of them with values reduced to the limits. `dropped` were held back by
    the rate. `refused` were held back by the policy, or are velocity commands that are not finite or cannot be decoded.
    """

    def __init__(
        self, *, node: Node, graph: Graph, loop: Loop, create: Callable[..., Publisher], request: Request
    ) -> None:
        # A depth of 1 is acknowledged at once (see `Publisher`), which a zero needs; for other types a burst has to
        # fit.
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
        """Steps that relay for the duration (0: without end), after the subscribers have matched,
        so that they miss nothing.
        """
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
        """Publish one message; do nothing if the relay has ended. Call `wait_first_ack` before the next message, which
        could replace this one in the queue.

        Raises:
            Cancelled: if a stop, the latch or the end of the link lease came after the relay was accepted.
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
        """Steps that wait until the first message is acknowledged, if the queue has no room for a second message.

        A subscriber discovers a new publisher a little later than the publisher discovers the subscriber.
        """
        if self._awaits_first_ack and self.passed:
            self._awaits_first_ack = False
            yield from self.publisher.wait_acknowledged(FIRST_ACK_S)

    def finish(self) -> Steps[RelayEnd]:
        """Steps that relay what has arrived, send the zero of a velocity command, and wait for its
        arrival; return the counts.
        """
        deadline = time.monotonic() + LAST_DRAIN_S
        with suppress(Cancelled):  # after a stop nothing passes
            while self.is_running and self._relay_waiting() == 0.0 and time.monotonic() < deadline:
                yield 0.0
        counts, velocity = self.counts(), self.publisher.velocity
        self.is_running = False
        if velocity is not None and self._has_begun:
            velocity.send_zero()
        self.publisher.limits.end()  # no other code could: the publisher ends with the relay
        yield from self.publisher.wait_acknowledged(LAST_ACK_S)
        return {**counts, "final_sent": velocity is not None and self._has_begun}

    def counts(self) -> RelayCounts:
        """Return the counts so far."""
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
        """Destroy the subscription and the publisher."""
        if self._source is not None:
            self._source.destroy()
        self.publisher.destroy()

    def _relay_waiting(self) -> float:
        """Relay the messages in the middleware's queue; return in how many seconds to call again."""
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
        """Relay one sample. Return True if it must be acknowledged before the next one."""
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
        """Steps that relay until the duration is over or the request is ended, and then send the
        zero of a velocity command.
        """
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
                    request.task = None  # it is ending, and cannot be cancelled any more
                    counts = yield from relay.finish()
        finally:
            self._open.pop(name, None)
            relay.destroy()
        return {**counts, "ended_by": relay.ended_by}

    def feed(self, request: Request) -> Steps[RelayFeedReply]:
        """Steps that publish messages through the relay of that name: the body contains them one after
        the other, in these sizes.
        """
        relay, offset = self._open.get(request.text("name")), 0
        sizes = request.sizes("sizes")
        if relay is not None and relay.ended_by in ("stop", "lease", "latch", "stopper", "keep_out"):
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
        """Return the counts of every relay so far."""
        return {"relays": {name: relay.counts() for name, relay in self._open.items()}}

    def publishers(self) -> list[Publisher]:
        """Return the publishers of all relays, through which messages may still be under way."""
        return [relay.publisher for relay in self._open.values()]

    def clear(self) -> None:
        """Destroy all relays."""
        while self._open:
            self._open.popitem()[1].destroy()
