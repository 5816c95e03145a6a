# pyright: basic
"""What the server can ask for: one name for each operation, and how each request gets its one answer."""

from __future__ import annotations

import inspect
import os
import sys
import time
import traceback
from pathlib import Path

from . import shared_memory
from .clients import Clients
from .graph import Graph
from .publishers import Publishers
from .relay import Relays
from .request import OperationError
from .subscriptions import Subscriptions
from .wills import Wills

EXPIRE_EVERY_S = 5.0
HEARING_CHECKED_EVERY_S = 2.0
LAST_DEEDS_S = 0.3


class Operations:
    """All that needs ROS; lives on the ROS thread. `node` is the bridge's own node."""

    def __init__(self, node, loop, outbox):
        self._node = node
        self._loop = loop
        self._outbox = outbox
        self._started = time.monotonic()
        self._requests = {}
        self._graph = Graph(node)
        self._subscriptions = Subscriptions(node, self._graph, loop, outbox)
        self._clients = Clients(node)
        self.publishers = Publishers(node, self._graph)
        self._relays = Relays(node, self._graph, loop)
        self._wills = Wills(self.publishers, self._clients)
        self._table = {
            "cancel": self._cancel,
            "topics": self._graph.topics,
            "services": self._services,
            "nodes": self._graph.nodes,
            "node": self._graph.node,
            "endpoints": self._graph.endpoints,
            "wait_endpoints": self._graph.wait_endpoints,
            "subscribe": self._subscriptions.subscribe,
            "unsubscribe": self._subscriptions.unsubscribe,
            "publish": self.publishers.publish,
            "repeat": self.publishers.repeat,
            "relay": self._relays.relay,
            "relay_feed": self._relays.feed,
            "relay_stop": self._relay_stop,
            "relays": self._relays.counts,
            "call": self._clients.call,
            "will_publish": self._wills.publish,
            "will_call": self._wills.call,
            "stop": self._stop,
            "stats": self._stats,
        }
        loop.start(self._graph.settle(), _log_failure)
        loop.start(self._expire(), _log_failure)
        loop.start(self._leave_when_deaf(), _log_failure)

    def start(self, request):
        """Begin to work on a request; it is answered when that is done."""
        try:
            if request.op not in self._table:
                raise OperationError("bad_request", f"There is no operation {request.op!r}.")
            if request.id in self._requests:
                raise OperationError("bad_request", f"A request with the id {request.id} is still open.")
            result = self._table[request.op](request)
        except Exception as error:  # noqa: BLE001 - whatever it is, it answers this request
            self._answer_error(request, error)
            return
        if inspect.isgenerator(result):
            self._start_steps(request, result)
        else:
            self._answer(request, result)

    def last_deeds(self):
        """Send all that must be sent last; returns the futures of the calls. Any thread may call it."""
        self.publishers.send_finals()
        self._relays.send_finals()
        return self._wills.carry_out()

    def end(self, executor):
        """Stop everything, sending what must be sent last."""
        futures, deadline = self.last_deeds(), time.monotonic() + LAST_DEEDS_S
        while time.monotonic() < deadline and not self._are_done(futures):
            executor.spin_once(timeout_sec=0.005)
        self.publishers.pool.clear()
        self._relays.clear()
        self._subscriptions.clear()
        self._clients.pool.clear()

    def _are_done(self, futures):
        acknowledged = self.publishers.are_acknowledged() and self._relays.are_acknowledged()
        return acknowledged and all(future.done() for future in futures)

    def _start_steps(self, request, steps):
        def finished(result, error):
            self._requests.pop(request.id, None)
            if error is not None:
                self._answer_error(request, error)
            else:
                self._answer(request, result)

        self._requests[request.id] = request
        request.task = self._loop.start(steps, finished)

    def _answer(self, request, result):
        if isinstance(result, tuple):
            self._outbox.reply(request.id, *result)
        elif result is not None:  # unsubscribe leaves its answer to the queue of samples
            self._outbox.reply(request.id, result)

    def _answer_error(self, request, error):
        if not isinstance(error, OperationError):
            traceback.print_exception(type(error), error, error.__traceback__, file=sys.stderr)
            error = OperationError("ros_error", f"{type(error).__name__}: {error}")
        self._outbox.reply_error(request.id, error)

    def _services(self, request):
        """Without what is in the graph only because we have called it."""
        found, unserved = (yield from self._graph.services(request)), self._clients.unserved()
        served = [[name, [each for each in types if (name, each) not in unserved]] for name, types in found["services"]]
        return {**found, "services": [[name, types] for name, types in served if types]}

    def _cancel(self, request):
        target = self._requests.get(request.number("request"))
        if target is not None and target.op != "unsubscribe":
            target.cancel()
        return {}

    def _stop(self, _request):
        return {"repeats": self._cancel_all("repeat"), "relays": self._cancel_all("relay")}

    def _relay_stop(self, request):
        name = request.text("name")
        return {"relays": self._cancel_all("relay", lambda relay: relay.text("name") == name)}

    def _cancel_all(self, op, is_meant=lambda _: True):
        meant = [request for request in self._requests.values() if request.op == op and is_meant(request)]
        for request in meant:
            request.cancel()
        return len(meant)

    def _stats(self, _request):
        return {
            "publishers": len(self.publishers.pool),
            "subscriptions": len(self._subscriptions),
            "clients": len(self._clients.pool),
            "threads": _count("/proc/self/task"),
            "open_files": _count("/proc/self/fd") - 1,
            "rss_bytes": int(Path("/proc/self/statm").read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE"),
            "repeats": self.publishers.repeats,
            "relays": len(self._relays),
            "wills": len(self._wills),
            "uptime_s": round(time.monotonic() - self._started, 3),
        }

    def _expire(self):
        while True:
            yield EXPIRE_EVERY_S
            self.publishers.pool.expire()
            self._clients.pool.expire()

    def _leave_when_deaf(self):
        """The server then starts another bridge, which hears again."""
        while not shared_memory.is_lost(self._node.context.get_domain_id()):
            yield HEARING_CHECKED_EVERY_S
        sys.stderr.write("Other processes have replaced the shared memory that this bridge receives through.\n")
        self._loop.end()


def _count(folder):
    return sum(1 for _ in Path(folder).iterdir())


def _log_failure(_result, error):
    if error is not None:
        traceback.print_exception(type(error), error, error.__traceback__, file=sys.stderr)
