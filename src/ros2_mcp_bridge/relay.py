# pyright: basic
"""Relays: the messages of one topic appear on another, as bytes, for a while.

A relay without a source is fed by the server, which sees values and so can compare and change them.
"""

from __future__ import annotations

import math
import time

from . import qos
from .publishers import Publisher
from .request import Cancelled, OperationError
from .rhythm import Rhythm
from .subscriptions import DEPTH_FOR_ALL, DRAIN_AT_MOST_S, DRAIN_PERIOD_S, LAST_DRAIN_S, RawSubscription

FED_PERIOD_S = 0.25
LOOK_EVERY_S = 0.1
DEPTH = 100
FIRST_ACK_S = 1.0
# Fast DDS asks every 3 s for what is missing; who discovered us late gets it all then.
LAST_ACK_S = 3.5


class FollowedSource:
    """The subscription of a relay as publishers come and go: made when the first is there, and made anew for others.

    Its QoS is the strongest that every publisher offers.
    """

    def __init__(self, graph, request):
        self._graph = graph
        self._topic, self._type = request.text("source"), request.text("type")
        self._open = lambda profile: RawSubscription(graph, self._topic, request.interface, profile)
        self._look_at = 0.0
        self._chosen = None
        self.source = None

    def look(self):
        """Every now and then, where nobody is matched: subscribe in a way that matches those who are there."""
        if time.monotonic() < self._look_at:
            return
        self._look_at = time.monotonic() + LOOK_EVERY_S
        if self.source is not None and self.source.publisher_count():
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
            self._subscribe(qos.profile(chosen, DEPTH_FOR_ALL))

    def destroy(self):
        """End receiving."""
        if self.source is not None:
            self.source.destroy()

    def _subscribe(self, profile):
        self.destroy()
        lost = self.source.lost if self.source else 0
        self.source = self._open(profile)
        self.source.lost = lost


class Relay:
    """One relay with its entities and counts: `passed` messages were published, `dropped` held back by the rate."""

    def __init__(self, graph, loop, request):
        # A depth of 1 is acknowledged at once (see `Publisher`), which the final message needs; else a burst must fit.
        self._is_unheard = bool(request.body)
        self._rhythm = Rhythm(request.rate()) if request.has("rate_hz") else None
        self._source = FollowedSource(graph, request) if request.has("source") else None
        self._publisher = Publisher(graph, request, max_depth=1 if self._is_unheard else DEPTH)
        self._loop = loop
        self._started = time.monotonic()
        self._final = b""
        self.is_running = False
        self.passed = 0
        self.dropped = 0

    def run(self, request, duration_s):
        """Steps that relay: first wait for those who listen, so that they miss nothing."""
        yield from self._publisher.wait_match(True, request.number("wait_match_s", 0.0))
        self._final, self.is_running, self._started = request.body, True, time.monotonic()
        end = self._started + (duration_s or math.inf)
        while time.monotonic() < end:
            pause = self._relay_waiting()
            yield from self.wait_heard()
            yield max(0.0, min(pause, end - time.monotonic()))

    def publish(self, data):
        """Pass one message on, unless it has ended; afterwards `wait_heard`, before the next replaces it."""
        if self.is_running:
            self._publisher.publish(data)
            self.passed += 1

    def wait_heard(self):
        """Steps until the first message is acknowledged, where there is no room for a second one beside it.

        A subscriber learns of a new publisher a moment later than the publisher of the subscriber.
        """
        if self._is_unheard and self.passed:
            self._is_unheard = False
            yield from self._publisher.wait_acknowledged(FIRST_ACK_S)

    def finish(self):
        """Steps that pass on what has come, send the final message and wait until that is acknowledged; its counts."""
        deadline = time.monotonic() + LAST_DRAIN_S
        while self.is_running and self._relay_waiting() == 0.0 and time.monotonic() < deadline:
            yield 0.0
        counts = self.counts()
        self.send_final()
        yield from self._publisher.wait_acknowledged(LAST_ACK_S)
        return {**counts, "final_sent": bool(self._final)}

    def send_final(self):
        """Send the final message, if there is one and it has begun; nothing passes any more."""
        self.is_running = False
        return self._publisher.publish_last(self._final)

    def counts(self):
        """What became of the messages so far."""
        source = self._source.source if self._source else None
        return {
            "running": self.is_running,
            "passed": self.passed,
            "dropped": self.dropped,
            "lost": source.lost if source else 0,
            "publishers": source.publisher_count() if source else 0,
            "matched": self._publisher.matched(),
            "elapsed_s": round(time.monotonic() - self._started, 6),
        }

    def destroy(self):
        """End it."""
        if self._source is not None:
            self._source.destroy()
        self._publisher.destroy()

    def _relay_waiting(self):
        """Relay what the middleware holds, from whoever publishes; returns when to come again, in seconds."""
        if self._source is None:
            return FED_PERIOD_S
        self._source.look()
        source, started = self._source.source, time.monotonic()
        if source is None:
            return DRAIN_PERIOD_S
        if not source.drain(self._take_in, self._loop.turn_of(DRAIN_AT_MOST_S)):
            return 0.0
        source.check_publishers()
        return started + DRAIN_PERIOD_S - time.monotonic()

    def _take_in(self, sample):
        """Relay one sample; true where it must be heard before the next."""
        if self._rhythm is None or self._rhythm.passes(sample[0]):
            self.publish(sample[3])
        else:
            self.dropped += 1
        return self._is_unheard and self.passed


class Relays:
    """All relays of the bridge, by the names that the server gave them."""

    def __init__(self, graph, loop, failsafes):
        self._graph = graph
        self._loop = loop
        self._failsafes = failsafes
        self._open = {}

    def relay(self, request):
        """Relay until its time is over or the request is cancelled, then send the final message."""
        name, duration_s, cancelled = request.text("name"), request.number("duration_s", 0.0), False
        if name in self._open:
            raise OperationError("bad_request", f"There is a relay {name!r} already.")
        relay = self._open[name] = Relay(self._graph, self._loop, request)
        try:
            with self._failsafes.in_force(request, relay.send_final):
                try:
                    yield from relay.run(request, duration_s)
                except Cancelled:
                    cancelled = True
                finally:
                    request.task = None  # it ends now, and cannot be cancelled any more
                    counts = yield from relay.finish()
        finally:
            self._open.pop(name, None)
            relay.destroy()
        return {**counts, "cancelled": cancelled}

    def feed(self, request):
        """Publish messages through a relay of that name: the body is one after the other, of these sizes."""
        relay, offset = self._open.get(request.text("name")), 0
        if relay is None or not relay.is_running:
            raise OperationError("not_found", f"There is no running relay {request.text('name')!r}.")
        for size in request.sizes("sizes"):
            relay.publish(request.body[offset : offset + size])
            yield from relay.wait_heard()
            offset += size
        return {"passed": relay.passed}

    def counts(self, _request):
        """What became of the messages of every relay so far."""
        return {"relays": {name: relay.counts() for name, relay in self._open.items()}}

    def clear(self):
        """End all."""
        while self._open:
            self._open.popitem()[1].destroy()
