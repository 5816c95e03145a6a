"""Raw subscriptions, drained by the loop instead of by the executor, which takes only one message at a time."""

from __future__ import annotations

import itertools
import time
from collections.abc import Callable, Iterator, Sequence
from typing import TYPE_CHECKING, Any

from ros2_mcp_bridge.loop import Loop, Seldom, Task, log_failure
from ros2_mcp_bridge.request import OperationError, Request, Steps
from ros2_mcp_bridge.ros import qos, rcl
from ros2_mcp_bridge.ros.graph import Graph
from ros2_mcp_bridge.stream import Outbox, Sample, SampleQueue
from ros2_mcp_bridge.topics.replayed import NewestOfOld
from ros2_mcp_common.wire.limits import NO_HURRY_S
from ros2_mcp_common.wire.protocol import Counts, SubscribeReply

if TYPE_CHECKING:
    from rclpy.node import Node
    from rclpy.qos import QoSProfile

# The period of draining, and so the longest wait of a message. A shorter one costs processor time without traffic; with
# this, 1 kHz costs 5 to 6 % of a core (decision 7).
DRAIN_PERIOD_S = 0.005
# The shortest period that a subscription may request: each round costs 0.2 ms with ten subscriptions.
LEAST_DRAIN_PERIOD_S = 0.002
# The longest draining in one turn: under a flood, the rest is drained in the next turn, after other work.
DRAIN_AT_MOST_S = 0.01
# The longest draining at the end: messages that have arrived are sent, a flood that goes on is not.
LAST_DRAIN_S = 0.1
# The depth of the middleware's queue, which holds messages between two rounds (decision 7): 0.2 s of 5 kHz.
DEPTH_FOR_ALL = 1000
# Clock and queues are checked once in so many messages, because that costs time, too.
_LOOK_EVERY_MESSAGES = 16
NO_SEQUENCE = (None, 0, 2**64 - 1)
CDR_HEAD_BYTES = 4


class RawSubscription:
    """A raw subscription outside any executor. `lost` counts the messages that never reached it.

    Losses are gaps in a publisher's sequence numbers. A message does not identify its publisher, so gaps
    can be counted only while there is exactly one. Otherwise, or if the middleware has no sequence numbers,
    `lost` is None from then on.
    """

    def __init__(self, node: Node, graph: Graph, topic: str, interface: Any, profile: QoSProfile) -> None:
        self.lost: int | None = 0
        self._graph = graph
        self._topic = topic
        self._interface = interface
        self._gids: set[bytes] | None = None
        self._last: int | None = None
        self._raw = rcl.subscription(node, interface, topic, profile)

    def publisher_count(self) -> int:
        """Return the number of matched publishers, without the stoppers' publishers, which publish nothing.

        Where rclpy does not report matches (Humble), it is the number of publishers in the graph.
        """
        count: Callable[[], int] | None = getattr(self._raw, "get_publisher_count", None)
        matched = len(self._graph.publishers(self._topic)) if count is None else count()
        return matched - self._graph.stoppers(self._topic) if count and matched > 1 else matched

    def drain(self, take_in: Callable[[Sample], bool | None], is_enough: Callable[[], bool]) -> bool:
        """Pass the messages in the middleware's queue to `take_in`.

        Return False if `take_in` returned True, or `is_enough`, asked now and then, did: then messages may be left.
        """
        for number, sample in enumerate(self._waiting(), 1):
            if take_in(sample) or (number % _LOOK_EVERY_MESSAGES == 0 and is_enough()):
                return False
        return True

    def check_publishers(self) -> None:
        """Stop counting losses if there is more than one publisher."""
        if self.lost is not None and self.publisher_count() > 1:
            self.lost = None

    def destroy(self) -> None:
        """Destroy the subscription."""
        self._raw.destroy_when_not_in_use()

    def _waiting(self) -> Iterator[Sample]:
        """Yield the messages in the middleware's queue.

        While Fast DDS assembles a large message, it can return an empty one, again and again, with a time
        of 1970 (seen after another subscriber was killed). A message is never shorter than the head of its
        CDR, so this is not one yet.
        """
        while (taken := self._raw.take_message(self._interface, True)) and len(taken[0]) >= CDR_HEAD_BYTES:
            data, info = taken
            sequence: int | None = info.get("publication_sequence_number")
            sequence = None if sequence in NO_SEQUENCE else sequence
            if self.lost is not None:
                self.lost = self._lost_before(sequence, self.lost)
                self._last = sequence
            received_ns: int = info.get("received_timestamp") or time.time_ns()
            yield Sample(received_ns, info.get("source_timestamp") or 0, sequence, data, self.lost)

    def _lost_before(self, sequence: int | None, lost: int) -> int | None:
        """Return how many messages were lost up to this message, if `lost` were lost up to the last message; None if it
        is not known.
        """
        if sequence is None:
            return None
        if self._last is None or sequence <= self._last:  # the first message, or the first of a restarted publisher
            self._gids = self._graph.publisher_gids(self._topic)
        elif sequence > self._last + 1:
            is_same = self._graph.publisher_gids(self._topic) == self._gids
            return lost + sequence - self._last - 1 if is_same else None
        return lost


class Subscription(RawSubscription):
    """A subscription of the server, with the queue of its samples."""

    def __init__(self, number: int, node: Node, graph: Graph, request: Request) -> None:
        keeps_all = request.choice("keep", ("all", "latest")) == "all"
        max_samples = max(1, request.number("max_samples")) if keeps_all else 1
        self.drain_s = max(LEAST_DRAIN_PERIOD_S, request.number("drain_s", DRAIN_PERIOD_S))
        self._head_bytes = int(request.number("head_bytes", 0))
        self._every_n = max(1, int(request.number("every_n", 1)))
        self._seen = 0
        self.queue = SampleQueue(number, max_samples, request.number("max_bytes"))
        profile = qos.profile(request.qos(), DEPTH_FOR_ALL if keeps_all else 1)
        opened_ns = time.time_ns()
        super().__init__(node, graph, request.text("topic"), request.interface, profile)
        if not keeps_all:
            self.lost = None  # overwritten in the middleware, as requested: no loss
        self._has_failed = False
        is_latched = request.qos().get("durability") == "transient_local"
        judges = request.flag("newest_of_old") and is_latched
        self._old = NewestOfOld[Sample](opened_ns, time.monotonic()) if judges else None

    def drain_to(self, outbox: Outbox, is_enough: Callable[[], bool]) -> bool:
        """Move messages from the middleware to the outbox; return False if `is_enough` ended
        that before all were taken.
        """
        samples: list[Sample] = []
        seen_before = self._seen

        def give_on(found: Sequence[Sample]) -> None:
            for sample in found:
                if self._seen % self._every_n == 0:
                    samples.append(self._head_of(sample))
                self._seen += 1

        def take_in(sample: Sample) -> None:
            give_on(self._old.passed(sample, time.monotonic()) if self._old else [sample])

        try:
            is_empty = self.drain(take_in, is_enough)
            if self._old:
                give_on(self._old.due(time.monotonic()))
        except rcl.RCLError as error:
            is_empty = True  # this subscription is tried again, the others go on
            if not self._has_failed:
                log_failure(None, error)  # once
            self._has_failed, self.lost = True, None
        if self._seen > seen_before:
            self.check_publishers()
            self.queue.skipped += self._seen - seen_before - len(samples)
        if samples:
            outbox.add_samples(self.queue, samples)
        return is_empty

    def _head_of(self, sample: Sample) -> Sample:
        """Return the sample with no more bytes than were requested."""
        size = len(sample.data)
        if not self._head_bytes or size <= self._head_bytes:
            return sample
        return sample._replace(data=sample.data[: self._head_bytes], whole=size)


class Subscriptions:
    """All subscriptions of the server."""

    def __init__(self, node: Node, graph: Graph, loop: Loop, outbox: Outbox) -> None:
        self._node = node
        self._graph = graph
        self._loop = loop
        self._outbox = outbox
        self._numbers = itertools.count(1)
        self._open: dict[float, Subscription] = {}
        self._draining: Task[None] | None = None

    def __len__(self) -> int:
        return len(self._open)

    def subscribe(self, request: Request) -> SubscribeReply:
        """Start to receive, and return the number of the subscription."""
        number = next(self._numbers)
        self._open[number] = Subscription(number, self._node, self._graph, request)
        if self._draining is None or not self._draining.open:
            self._draining = self._loop.start(self._drain_all(), log_failure)
        self._draining.wake()  # the other subscriptions may have a longer period
        return {"sub": number}

    def unsubscribe(self, request: Request) -> Steps[None]:
        """Steps that send what has arrived, and end the subscription. The queue of samples sends the answer."""
        subscription = self._of(request)
        del self._open[subscription.queue.number]
        yield from self._send_rest(subscription, request, is_last=True)
        subscription.destroy()

    def counts_of(self, request: Request) -> Counts | Steps[None]:
        """Return the counts of a subscription, or with `after_samples` steps that send them after what has arrived."""
        subscription = self._of(request)
        if request.flag("after_samples"):
            return self._send_rest(subscription, request, is_last=False)
        return subscription.queue.counts(subscription.lost)

    def _of(self, request: Request) -> Subscription:
        subscription = self._open.get(request.number("sub"))
        if subscription is None:
            raise OperationError("not_found", "There is no such subscription.")
        return subscription

    def _send_rest(self, subscription: Subscription, request: Request, *, is_last: bool) -> Steps[None]:
        """Steps that send what has arrived, and then answer.

        Unless `is_last`, another request may end the subscription meanwhile.
        """
        deadline = time.monotonic() + LAST_DRAIN_S
        while (is_last or subscription.queue.number in self._open) and time.monotonic() < deadline:
            if subscription.drain_to(self._outbox, self._loop.has_due):
                break
            yield 0.0
        self._outbox.reply_after_samples(subscription.queue, request.id, subscription.lost, is_last=is_last)

    def clear(self) -> None:
        """Destroy all subscriptions."""
        while self._open:
            self._open.popitem()[1].destroy()

    def _drain_all(self) -> Steps[None]:
        while self._open:
            started = time.monotonic()
            is_enough = self._loop.turn_of(DRAIN_AT_MOST_S)
            drained = [subscription.drain_to(self._outbox, is_enough) for subscription in list(self._open.values())]
            period_s = min((subscription.drain_s for subscription in self._open.values()), default=0.0)
            wait_s = max(0.0, started + period_s - time.monotonic()) if all(drained) else 0.0
            yield Seldom(wait_s) if period_s >= NO_HURRY_S else wait_s
