"""What the server can ask of ROS: a row of the table for each operation, and how each request gets its one answer."""

from __future__ import annotations

import os
import signal
import sys
import time
from collections.abc import Callable, Generator
from contextlib import suppress
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from . import interfaces, shared_memory
from .clients import Clients
from .clock import CLOCK_TYPE, RobotClock
from .epoch import Overtaken, StopEpoch
from .failsafes import FailSafes
from .graph import Graph
from .loop import Loop, log_failure
from .protocol import Empty, RelayStopReply, ServicesReply, StatsReply, StopReply, ZeroReply
from .publishers import Publisher, Publishers
from .relay import Relay, Relays
from .request import Answer, Cancelled, OperationError, Request, Steps
from .stream import Outbox
from .subscriptions import Subscriptions
from .velocities import Velocities, VelocityTopic
from .velocity import VELOCITY_TYPES

if TYPE_CHECKING:
    from rclpy.executors import Executor
    from rclpy.node import Node

# What acts until it is ended.
LASTING = ("repeat", "relay")
# What acts once, as soon as it can, and the argument that names what it acts on.
LEAVING = {"publish": "topic", "call": "service", "relay_feed": "name"}

Operation = Callable[[Request], "Answer | Steps[Answer]"]

# Often enough for entities that are destroyed after a minute without use. Chosen.
EXPIRE_EVERY_S = 5.0
# A loss is for good, and rare; each check reads the list of all mapped files. Chosen.
SHARED_MEMORY_CHECKED_EVERY_S = 2.0
# For acknowledgements of what is sent last. Chosen so that it fits into the end of the process, which is enforced after
# 1 s (GIVE_UP_AFTER_S).
ARRIVAL_S = 0.3
ARRIVAL_POLL_S = 0.005


class Operations:
    """All that needs ROS; lives on the ROS thread. `node` is the bridge's own node, `table` is what it adds to."""

    def __init__(
        self, *, node: Node, loop: Loop, outbox: Outbox, stops: StopEpoch, table: dict[str, Operation]
    ) -> None:
        self._node = node
        self._loop = loop
        self._outbox = outbox
        self._started = time.monotonic()
        self._requests: dict[int | None, Request] = {}
        self._stops = stops
        self._graph = Graph(node)
        self._clock = RobotClock(node, self._graph)
        self._velocities = Velocities(self._clock, outbox.send)
        self.send_zeros = self._velocities.send_zeros
        self.failsafes = FailSafes(self.send_zeros)
        self._subscriptions = Subscriptions(node, self._graph, loop, outbox)
        self._clients = Clients(node, self.failsafes)
        create = partial(Publisher, node=node, graph=self._graph, velocities=self._velocities)
        self._publishers = Publishers(self._velocities, create)
        self._relays = Relays(self._velocities, partial(Relay, node=node, graph=self._graph, loop=loop, create=create))
        self._table = table
        table.update(
            {
                "cancel": self._cancel,
                "topics": self._graph.topics,
                "services": self._services,
                "nodes": self._graph.nodes,
                "node": self._graph.node,
                "endpoints": self._graph.endpoints,
                "wait_endpoints": self._graph.wait_endpoints,
                "subscribe": self._subscriptions.subscribe,
                "unsubscribe": self._subscriptions.unsubscribe,
                "publish": self._publishers.publish,
                "repeat": self._publishers.repeat,
                "repeat_stop": self._repeat_stop,
                "relay": self._relays.relay,
                "relay_feed": self._relays.feed,
                "relay_stop": self._relay_stop,
                "relays": self._relays.counts,
                "call": self._clients.call,
                "failsafe_publish": self._publishers.failsafe,
                "failsafe_call": self._clients.failsafe,
                "stop": self._stop,
                "zero": self._zero,
                "stats": self._stats,
            }
        )
        for type_name in (*VELOCITY_TYPES, CLOCK_TYPE):
            with suppress(OperationError):  # a robot need not have all of them
                interfaces.load(
                    type_name
                )  # before anything is commanded: no command and no stop waits for these imports
        for steps in (self._graph.settle(), self._expire(), self._leave_when_shared_memory_is_lost()):
            loop.start(steps, log_failure)

    def start(self, request: Request) -> None:
        """Begin to work on a request; it is answered when that is done."""
        was_coming = request in self._stops.coming
        self._stops.coming.pop(request, None)
        try:
            if request.op not in self._table:
                raise OperationError("bad_request", f"There is no operation {request.op!r}.")
            request.check_accepted()
            result = self._table[request.op](request)
        except Exception as error:  # noqa: BLE001 - whatever it is, it answers this request
            if was_coming and isinstance(error, Cancelled) and error.ended_by == "stop":
                self._stops.overtaken.append(request)
            self._finish(request, None, error)
            return
        if isinstance(result, Generator):
            self._requests[request.id] = request
            request.task = self._loop.start(result, partial(self._finish, request))
        else:
            self._finish(request, result, None)

    def end(self, executor: Executor) -> None:
        """Stop everything, sending what must be sent last."""
        pending = [*self.failsafes.carry_out(), *self._publishers.pool.entities().values(), *self._relays.publishers()]
        deadline = time.monotonic() + ARRIVAL_S
        while time.monotonic() < deadline and not all(arrival.done() for arrival in pending):
            executor.spin_once(timeout_sec=ARRIVAL_POLL_S)
        for kind in (self._publishers.pool, self._relays, self._subscriptions, self._clients.pool, self._clock):
            kind.clear()

    def lapse(self) -> None:
        """The server is silent for longer than its link lease: end what it moves, after the fail-safes."""
        for acting in self._acting():
            acting.end("lease")

    def _finish(self, request: Request, result: Answer, error: Exception | None) -> None:
        self._requests.pop(request.id, None)
        if error is not None:
            self._outbox.reply_error(request.id, error)
        elif isinstance(result, tuple):
            self._outbox.reply(request.id, *result)
        elif result is not None:  # unsubscribe leaves its answer to the queue of samples
            self._outbox.reply(request.id, result)

    def _services(self, request: Request) -> Steps[ServicesReply]:
        """Without what is in the graph only because we have called it."""
        found, unserved = (yield from self._graph.services(request)), self._clients.unserved()
        served = [
            (name, [type_name for type_name in types if (name, type_name) not in unserved])
            for name, types in found["services"]
        ]
        return {"services": [(name, types) for name, types in served if types], "settled": found["settled"]}

    def _cancel(self, request: Request) -> Empty:
        target = self._requests.get(int(request.number("request")))
        if target is not None and target.op != "unsubscribe":
            target.end("cancel")
        return {}

    def _acting(self) -> list[Request]:
        """What publishes until it is ended, or acts and has not left yet."""
        return [
            request
            for request in self._requests.values()
            if request.op in LASTING or (request.acceptance and request.op in LEAVING and not request.has_left)
        ]

    def _stop(self, request: Request) -> Steps[StopReply]:
        """End all that was accepted before and has not left, then zeros on every topic that is driven."""
        overtaken = self._stops.take_overtaken()
        ended = list(dict.fromkeys([*overtaken, *(acting for acting in self._acting() if acting.end("stop"))]))
        return self._stop_topics(request, ended)

    def _stop_topics(self, request: Request, ended: list[Overtaken]) -> Steps[StopReply]:
        ops = [found.op for found in ended]
        wait_match_s, wait_ack_s = request.number("wait_match_s", 0.0), request.number("wait_ack_s", 0.0)
        topics = yield from self._velocities.stop(self._velocities.driven(), wait_match_s, wait_ack_s)
        return {
            "repeats": ops.count("repeat"),
            "relays": ops.count("relay"),
            "dropped": [
                (found.op, found.text(LEAVING[found.op], default="?")) for found in ended if found.op in LEAVING
            ],
            "topics": topics,
        }

    def _zero(self, request: Request) -> Steps[ZeroReply]:
        """Zeros on some of the topics that are driven."""
        chosen = self._chosen(request)
        wait_match_s, wait_ack_s = request.number("wait_match_s", 0.0), request.number("wait_ack_s", 0.0)
        return {"topics": (yield from self._velocities.stop(chosen, wait_match_s, wait_ack_s))}

    def _chosen(self, request: Request) -> list[VelocityTopic]:
        return [topic for topic in self._velocities.driven() if topic.name in request.texts("topics")]

    def end_at_once(self, request: Request) -> None:
        """What ends something does not wait for the imports of others; it is done again, and answered, in its turn.

        Then it also ends what was accepted before it and comes only now.
        """
        with suppress(OperationError):  # that is answered in its turn
            if request.op == "zero":
                for topic in self._chosen(request):
                    topic.send_zero()
            else:
                self._table[request.op](request)

    def _repeat_stop(self, request: Request) -> Empty:
        """End one repeat by its name."""
        name = request.text("name")
        for found in list(self._requests.values()):
            if found.op == "repeat" and found.has("name") and found.text("name") == name:
                found.end("cancel")
        return {}

    def _relay_stop(self, request: Request) -> RelayStopReply:
        """End one relay by its name."""
        name = request.text("name")
        relays = [found for found in self._requests.values() if found.op == "relay" and found.text("name") == name]
        request.ended += sum(relay.end("cancel") for relay in relays)
        return {"relays": request.ended}

    def _stats(self, _request: Request) -> StatsReply:
        return {
            "publishers": len(self._publishers.pool),
            "subscriptions": len(self._subscriptions),
            "clients": len(self._clients.pool),
            "threads": _count("/proc/self/task"),
            "open_files": _count("/proc/self/fd") - 1,
            "rss_bytes": int(Path("/proc/self/statm").read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE"),
            "repeats": sum(found.op == "repeat" and found.has_left for found in self._requests.values()),
            "uptime_s": round(time.monotonic() - self._started, 3),
        }

    def _expire(self) -> Steps[None]:
        while True:
            yield EXPIRE_EVERY_S
            self._publishers.pool.expire()
            self._clients.pool.expire()

    def _leave_when_shared_memory_is_lost(self) -> Steps[None]:
        """The server then starts another bridge, which receives again."""
        while not shared_memory.is_lost(self._node.context.get_domain_id()):
            yield SHARED_MEMORY_CHECKED_EVERY_S
        sys.stderr.write("Other processes have replaced the shared memory that this bridge receives through.\n")
        os.kill(os.getpid(), signal.SIGTERM)


def _count(folder: str) -> int:
    return sum(1 for _ in Path(folder).iterdir())
