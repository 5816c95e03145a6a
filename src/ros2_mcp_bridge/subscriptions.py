# pyright: basic
"""Raw subscriptions, drained by the loop instead of by the executor, which takes one message at a time."""

from __future__ import annotations

import itertools
import time

from rclpy.impl.implementation_singleton import rclpy_implementation

from . import qos
from .loop import log_failure
from .request import OperationError
from .stream import SampleQueue

DRAIN_PERIOD_S = 0.005
DRAIN_AT_MOST_S = 0.01
LAST_DRAIN_S = 0.1
DEPTH_FOR_ALL = 1000
NO_SEQUENCE = (None, 0, 2**64 - 1)
CDR_HEAD_BYTES = 4


class RawSubscription:
    """A raw subscription that no executor knows. `lost` counts the messages that never reached it.

    Those are gaps in a publisher's sequence numbers. A message does not tell its publisher, so that gaps can be
    counted only while there is exactly one; otherwise, and where the middleware has no sequence numbers, `lost` is
    None, for good.
    """

    def __init__(self, graph, topic, interface, profile):
        self.lost = 0
        self._interface = interface
        self._publisher_gids = lambda: graph.publisher_gids(topic)
        self._gids = self._last = None
        self._handle = graph.create(rclpy_implementation.Subscription, interface, topic, profile)
        self.publisher_count = getattr(self._handle, "get_publisher_count", lambda: len(graph.publishers(topic)))

    def drain(self, take_in, is_enough):
        """Give `take_in` what the middleware holds; False if it or, now and then, `is_enough` ended it before all was.

        A sample is what `SampleQueue` says.
        """
        for number, sample in enumerate(iter(self._take, None), 1):
            if take_in(sample) or (number % 16 == 0 and is_enough()):
                return False
        return True

    def check_publishers(self):
        """Give up counting what is lost when there is more than one publisher."""
        if self.lost is not None and self.publisher_count() > 1:
            self.lost = None

    def destroy(self):
        """End receiving."""
        self._handle.destroy_when_not_in_use()

    def _take(self):
        """The next sample; None if there is none.

        While Fast DDS puts a large message together, it can hand out an empty one, again and again, with a time of 1970
        (seen after another subscriber was killed). No message is shorter than the head of its CDR: that is none yet.
        """
        taken = self._handle.take_message(self._interface, True)
        if taken is None or len(taken[0]) < CDR_HEAD_BYTES:
            return None
        data, info = taken
        sequence = info.get("publication_sequence_number")
        sequence = None if sequence in NO_SEQUENCE else sequence
        if self.lost is not None:
            self._count(sequence)
        received_ns = info.get("received_timestamp") or time.time_ns()
        return received_ns, info.get("source_timestamp") or 0, sequence, data, self.lost

    def _count(self, sequence):
        if sequence is None:
            self.lost = None
        elif self._last is None or sequence <= self._last:  # the first message, or the first of a restarted publisher
            self._gids = self._publisher_gids()
        elif sequence > self._last + 1:
            is_same = self._publisher_gids() == self._gids
            self.lost = self.lost + sequence - self._last - 1 if is_same else None
        self._last = sequence


class Subscription(RawSubscription):
    """A subscription of the server with the queue of its samples."""

    def __init__(self, number, graph, request):
        keeps_all = request.choice("keep", ("all", "latest")) == "all"
        max_samples = max(1, request.number("max_samples")) if keeps_all else 1
        self.drain_s = max(DRAIN_PERIOD_S, request.number("drain_s", DRAIN_PERIOD_S))
        self.queue = SampleQueue(number, max_samples, request.number("max_bytes"))
        profile = qos.profile(request.qos(), DEPTH_FOR_ALL if keeps_all else 1)
        super().__init__(graph, request.text("topic"), request.interface, profile)
        if not keeps_all:
            self.lost = None  # overwritten in the middleware, as asked for: not a loss to count
        self._has_failed = False

    def drain_to(self, outbox, is_enough):
        """Move what the middleware holds to the outbox; returns False if `is_enough` ended it before all was taken."""
        samples = []
        try:
            is_empty = self.drain(samples.append, is_enough)
        except rclpy_implementation.RCLError as error:
            is_empty = True  # this one is tried again, and the others go on
            self._fail(error)
        if samples:
            self.check_publishers()
            outbox.add_samples(self.queue, samples)
        return is_empty

    def _fail(self, error):
        """What was lost is not known from now on; it is logged once."""
        if not self._has_failed:
            log_failure(None, error)
        self._has_failed, self.lost = True, None

    def counts(self):
        """What became of the messages so far."""
        return {"received": self.queue.received, "dropped": self.queue.dropped, "lost": self.lost}


class Subscriptions:
    """All subscriptions of the server."""

    def __init__(self, graph, loop, outbox):
        self._graph = graph
        self._loop = loop
        self._outbox = outbox
        self._numbers = itertools.count(1)
        self._open = {}
        self._draining = None

    def __len__(self):
        return len(self._open)

    def subscribe(self, request):
        """Begin to receive."""
        number = next(self._numbers)
        self._open[number] = Subscription(number, self._graph, request)
        if self._draining is None or not self._draining.open:
            self._draining = self._loop.start(self._drain_all(), log_failure)
        self._draining.wake()  # those that were there may let it sleep for longer
        return {"sub": number}

    def unsubscribe(self, request):
        """Send what has arrived, and end."""
        subscription = self._open.pop(request.number("sub"), None)
        if subscription is None:
            raise OperationError("not_found", "There is no such subscription.")
        deadline = time.monotonic() + LAST_DRAIN_S
        while not subscription.drain_to(self._outbox, self._loop.has_due) and time.monotonic() < deadline:
            yield 0.0
        subscription.destroy()
        self._outbox.reply_after_samples(subscription.queue, request.id, subscription.counts())

    def clear(self):
        """End all."""
        while self._open:
            self._open.popitem()[1].destroy()

    def _drain_all(self):
        while self._open:
            started = time.monotonic()
            is_enough = self._loop.turn_of(DRAIN_AT_MOST_S)
            drained = [subscription.drain_to(self._outbox, is_enough) for subscription in list(self._open.values())]
            period_s = min((subscription.drain_s for subscription in self._open.values()), default=0.0)
            yield max(0.0, started + period_s - time.monotonic()) if all(drained) else 0.0
