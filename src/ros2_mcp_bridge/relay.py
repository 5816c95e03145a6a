# pyright: basic
"""Relays: the messages of one topic appear on another, as bytes, for a while.

A relay without a source is fed by the server, which sees values and so can compare and change them.
"""

from __future__ import annotations

import math
import sys
import time

from rclpy.impl.implementation_singleton import rclpy_implementation

from . import qos
from .publishers import FINAL_ACK_S, MAX_RATE_HZ, Publisher
from .request import Cancelled, OperationError
from .rhythm import Rhythm
from .subscriptions import (
    DEPTH_FOR_ALL,
    DRAIN_AT_MOST_S,
    DRAIN_PERIOD_S,
    LAST_DRAIN_S,
    NO_SEQUENCE,
    LossCount,
    take_raw,
)

FED_PERIOD_S = 0.25
LOOK_EVERY_S = 0.1
DEPTH = 100
FIRST_ACK_S = 1.0
# Fast DDS asks every 3 s for what is missing; who discovered us late gets it all then.
LAST_ACK_S = 3.5


class Source:
    """A raw subscription to what is relayed, with the strongest QoS that every publisher offers."""

    def __init__(self, node, graph, topic, interface, chosen):
        profile = qos.profile(chosen, DEPTH_FOR_ALL)
        self.chosen = chosen
        self._interface = interface
        with node.handle:
            self._handle = rclpy_implementation.Subscription(
                node.handle, self._interface, topic, profile.get_c_qos_profile()
            )
        self.publisher_count = getattr(self._handle, "get_publisher_count", lambda: node.count_publishers(topic))
        self.loss = LossCount(self.publisher_count, lambda: graph.publisher_gids(topic))

    def take(self):
        """The next message and the time when it came, in nanoseconds; None if there is none."""
        taken = take_raw(self._handle, self._interface)
        if taken is None:
            return None
        data, info = taken
        sequence = info.get("publication_sequence_number")
        self.loss.count(None if sequence in NO_SEQUENCE else sequence)
        return data, info.get("received_timestamp") or time.time_ns()

    def destroy(self):
        """End receiving."""
        self._handle.destroy_when_not_in_use()


class Following:
    """The subscription of a relay as publishers come and go: made when the first is there, and made anew for others."""

    def __init__(self, node, graph, request):
        self._graph = graph
        self._topic, self._type = request.text("source"), request.text("type")
        self._open = lambda chosen: Source(node, graph, self._topic, request.interface, chosen)
        self._look_at = 0.0
        self.source = None

    def look(self):
        """Every now and then, where nobody is matched: subscribe in a way that matches those who are there."""
        if time.monotonic() < self._look_at:
            return
        self._look_at = time.monotonic() + LOOK_EVERY_S
        if self.source is not None and self.source.publisher_count():
            return
        profiles = [p.qos_profile for p in self._graph.publishers(self._topic) if p.topic_type == self._type]
        if not profiles:
            return
        reliable = all(profile.reliability.name == "RELIABLE" for profile in profiles)
        latched = all(profile.durability.name == "TRANSIENT_LOCAL" for profile in profiles)
        chosen = {
            "reliability": "reliable" if reliable else "best_effort",
            "durability": "transient_local" if latched else "volatile",
        }
        if self.source is None or self.source.chosen != chosen:
            self.destroy()
            self.source = self._open(chosen)

    def destroy(self):
        """End receiving."""
        if self.source is not None:
            self.source.destroy()


class Relay:
    """One relay with its entities and counts: `passed` messages were published, `dropped` held back by the rate."""

    def __init__(self, node, graph, request):
        # A depth of 1 is acknowledged at once (see `Publisher`), which the final message needs; else a burst must fit.
        self._final = request.body
        self._is_unheard = bool(self._final)
        self._rhythm = Rhythm(_rate(request)) if request.has("rate_hz") else None
        self._publisher = Publisher(node, graph, request, max_depth=1 if self._final else DEPTH)
        self._following = Following(node, graph, request) if request.has("source") else None
        self.final_counts = {}
        self._started = time.monotonic()
        self.is_running = False
        self.passed = 0
        self.dropped = 0

    def run(self, wait_match_s, duration_s, has_due):
        """Steps that relay: first wait for those who listen, so that they miss nothing."""
        if wait_match_s:
            yield from self._publisher.wait_match(True, wait_match_s)
        self.is_running, self._started = True, time.monotonic()
        end = self._started + (duration_s or math.inf)
        while time.monotonic() < end:
            pause = self._relay_waiting(has_due)
            yield from self.wait_heard()
            yield max(0.0, min(pause, end - time.monotonic()))

    def publish(self, data):
        """Pass one message on; afterwards `wait_heard`, before the next replaces it."""
        self._publisher.publish(data)
        self.passed += 1

    def wait_heard(self):
        """Steps until the first message is acknowledged, where there is no room for a second one beside it.

        A subscriber learns of a new publisher a moment later than the publisher of the subscriber.
        """
        if self._is_unheard and self.passed:
            self._is_unheard = False
            yield from self._publisher.wait_acknowledged(FIRST_ACK_S)

    def finish(self, has_due):
        """Steps that pass on what has come and send the final message, and end it when that is acknowledged."""
        deadline = time.monotonic() + LAST_DRAIN_S
        try:
            while self._relay_waiting(has_due) == 0.0 and time.monotonic() < deadline:
                yield 0.0
            self.final_counts = self.counts()
            self.send_final()
            yield from self._publisher.wait_acknowledged(FINAL_ACK_S if self._final else LAST_ACK_S)
        finally:
            self.destroy()

    def send_final(self):
        """Publish the final message twice, for best-effort subscribers."""
        if self._final and self.is_running:
            self._publisher.publish(self._final)
            self._publisher.publish(self._final)
            self.final_counts["final_sent"] = True

    def is_acknowledged(self):
        """Whether the final message, if there is one, has been acknowledged."""
        return not self._final or self._publisher.is_acknowledged()

    def counts(self):
        """What became of the messages so far."""
        source = self._following.source if self._following else None
        return {
            "running": self.is_running,
            "passed": self.passed,
            "dropped": self.dropped,
            "lost": source.loss.lost if source else 0,
            "publishers": source.publisher_count() if source else 0,
            "source_qos": source.chosen if source else None,
            "matched": self._publisher.matched(),
            "elapsed_s": round(time.monotonic() - self._started, 6),
            "final_sent": False,
        }

    def destroy(self):
        """End it."""
        if self._following is not None:
            self._following.destroy()
        self._publisher.destroy()

    def _relay_waiting(self, has_due):
        """Relay what has come, from whoever publishes; returns when to come again, in seconds."""
        if self._following is None:
            return FED_PERIOD_S
        self._following.look()
        source = self._following.source
        return DRAIN_PERIOD_S if source is None else self._drain(source, has_due)

    def _drain(self, source, has_due):
        """Relay what the middleware holds; returns when to come again, in seconds."""
        started = time.monotonic()
        while (taken := source.take()) is not None:
            data, received_ns = taken
            if self._rhythm is None or self._rhythm.passes(received_ns):
                self.publish(data)
            else:
                self.dropped += 1
            if self._is_unheard and self.passed:
                return 0.0
            if (self.passed + self.dropped) % 16 == 0 and (has_due() or time.monotonic() > started + DRAIN_AT_MOST_S):
                return 0.0
        source.loss.check_publishers()
        return started + DRAIN_PERIOD_S - time.monotonic()


class Relays:
    """All relays of the bridge, by the names that the server gave them."""

    def __init__(self, node, graph, loop):
        self._node = node
        self._graph = graph
        self._loop = loop
        self._open = {}

    def __len__(self):
        return len(self._open)

    def relay(self, request):
        """Relay until its time is over or the request is cancelled, then send the final message."""
        name, duration_s = request.text("name"), request.number("duration_s", 0.0)
        if name in self._open:
            raise OperationError("bad_request", f"There is a relay {name!r} already.")
        if request.has("source") and request.text("source") == request.text("topic"):
            raise OperationError("bad_request", "relay: source and topic are the same, it would feed itself.")
        relay, cancelled = Relay(self._node, self._graph, request), False
        self._open[name] = relay
        try:
            yield from relay.run(request.number("wait_match_s", 0.0), duration_s, self._loop.has_due)
        except Cancelled:
            cancelled = True
        finally:
            self._open.pop(name, None)
            yield from relay.finish(self._loop.has_due)
        return {**relay.final_counts, "cancelled": cancelled}

    def feed(self, request):
        """Publish messages through a relay of that name: the body is one after the other, of these sizes."""
        relay = self._open.get(request.text("name"))
        if relay is None or not relay.is_running:
            raise OperationError("not_found", f"There is no running relay {request.text('name')!r}.")
        offset = 0
        for size in request.sizes("sizes"):
            relay.publish(request.body[offset : offset + size])
            yield from relay.wait_heard()
            offset += size
        return {"passed": relay.passed}

    def counts(self, _request):
        """What became of the messages of every relay so far."""
        return {"relays": {name: relay.counts() for name, relay in self._open.items()}}

    def send_finals(self):
        """Send the final messages; another thread may call it when the ROS thread does not come to it."""
        for relay in list(self._open.values()):
            try:
                relay.send_final()
            except Exception as error:  # noqa: BLE001 - one that fails must not keep the others from being sent
                sys.stderr.write(f"a final message could not be sent: {error}\n")

    def are_acknowledged(self):
        """Whether every final message has been acknowledged."""
        return all(relay.is_acknowledged() for relay in self._open.values())

    def clear(self):
        """End all."""
        while self._open:
            self._open.popitem()[1].destroy()


def _rate(request):
    rate_hz = request.number("rate_hz")
    if not 0 < rate_hz <= MAX_RATE_HZ:
        raise OperationError("bad_request", f"relay: rate_hz is {rate_hz}, expected up to {MAX_RATE_HZ:.0f}.")
    return rate_hz
