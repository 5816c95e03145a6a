# pyright: basic
"""Raw subscriptions, drained by the loop instead of by the executor, which takes one message at a time."""

from __future__ import annotations

import itertools
import time

from rclpy.impl.implementation_singleton import rclpy_implementation

from . import qos
from .request import OperationError
from .stream import SampleQueue

DRAIN_PERIOD_S = 0.005
DRAIN_AT_MOST_S = 0.01
LAST_DRAIN_S = 0.1
DEPTH_FOR_ALL = 1000
NO_SEQUENCE = (None, 0, 2**64 - 1)
CDR_HEAD_BYTES = 4


def take_raw(handle, interface):
    """The next message as bytes and info; None if there is none.

    While Fast DDS puts a large message together, it can hand out an empty one, again and again, with a time of 1970
    (seen after another subscriber was killed). No message is shorter than the head of its CDR: that is none yet.
    """
    taken = handle.take_message(interface, True)
    return None if taken is None or len(taken[0]) < CDR_HEAD_BYTES else taken


class LossCount:
    """Messages that never reached us: gaps in a publisher's sequence numbers.

    A message does not tell its publisher, so that gaps can be counted only while there is exactly one; otherwise,
    and where the middleware has no sequence numbers, `lost` is None.
    """

    def __init__(self, publisher_count, publisher_gids):
        self.lost = 0
        self._publisher_count = publisher_count
        self._publisher_gids = publisher_gids
        self._last = None
        self._gids = None

    def check_publishers(self):
        """Give up for good when there is more than one publisher."""
        if self.lost is not None and self._publisher_count() > 1:
            self.lost = None

    def count(self, sequence):
        """Take note of the next message."""
        if self.lost is None:
            return
        if sequence is None:
            self.lost = None
        elif self._last is None or sequence <= self._last:  # the first message, or the first of a restarted publisher
            self._gids = self._publisher_gids()
        elif sequence > self._last + 1:
            is_same = self._publisher_gids() == self._gids
            self.lost = self.lost + sequence - self._last - 1 if is_same else None
        self._last = sequence


class Subscription:
    """One raw subscription and the queue of its samples."""

    def __init__(self, number, node, graph, request):
        keeps_all = request.choice("keep", ("all", "latest")) == "all"
        topic, self._interface = request.text("topic"), request.interface
        profile = qos.profile(request.qos(), DEPTH_FOR_ALL if keeps_all else 1)
        max_samples = max(1, request.number("max_samples")) if keeps_all else 1
        self.drain_s = max(DRAIN_PERIOD_S, request.number("drain_s", DRAIN_PERIOD_S))
        self.queue = SampleQueue(number, max_samples, request.number("max_bytes"))
        with node.handle:
            self._handle = rclpy_implementation.Subscription(
                node.handle, self._interface, topic, profile.get_c_qos_profile()
            )
        count_publishers = getattr(self._handle, "get_publisher_count", lambda: node.count_publishers(topic))
        self.loss = LossCount(count_publishers, lambda: graph.publisher_gids(topic))
        if not keeps_all:
            self.loss.lost = None  # overwritten in the middleware, as asked for: not a loss to count

    def drain(self, outbox, is_enough):
        """Move what the middleware holds to the outbox; returns False if `is_enough` ended it before all was taken."""
        samples, is_empty = [], False
        while not is_empty and not (len(samples) % 16 == 15 and is_enough()):
            taken = take_raw(self._handle, self._interface)
            is_empty = taken is None
            if taken is not None:
                samples.append(self._sample(*taken))
        if samples:
            self.loss.check_publishers()
            outbox.add_samples(self.queue, samples)
        return is_empty

    def counts(self):
        """What became of the messages so far."""
        return {"received": self.queue.received, "dropped": self.queue.dropped, "lost": self.loss.lost}

    def destroy(self):
        """End receiving."""
        self._handle.destroy_when_not_in_use()

    def _sample(self, data, info):
        sequence = info.get("publication_sequence_number")
        sequence = None if sequence in NO_SEQUENCE else sequence
        self.loss.count(sequence)
        received_ns = info.get("received_timestamp") or time.time_ns()
        return received_ns, info.get("source_timestamp") or 0, sequence, data, self.loss.lost


class Subscriptions:
    """All subscriptions of the bridge."""

    def __init__(self, node, graph, loop, outbox):
        self._node = node
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
        self._open[number] = Subscription(number, self._node, self._graph, request)
        if self._draining is None or not self._draining.open:
            self._draining = self._loop.start(self._drain_all(), lambda *_: None)
        self._draining.wake()  # those that were there may let it sleep for longer
        return {"sub": number}

    def unsubscribe(self, request):
        """Send what has arrived, and end."""
        subscription = self._open.pop(request.number("sub"), None)
        if subscription is None:
            raise OperationError("not_found", "There is no such subscription.")
        deadline = time.monotonic() + LAST_DRAIN_S
        while not subscription.drain(self._outbox, self._loop.has_due) and time.monotonic() < deadline:
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

            def is_enough(deadline=started + DRAIN_AT_MOST_S):
                return self._loop.has_due() or time.monotonic() > deadline

            drained = [subscription.drain(self._outbox, is_enough) for subscription in list(self._open.values())]
            period_s = min((subscription.drain_s for subscription in self._open.values()), default=0.0)
            yield max(0.0, started + period_s - time.monotonic()) if all(drained) else 0.0
