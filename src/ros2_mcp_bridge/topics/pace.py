"""Pacing of requests to one service: a server loses requests when its queue, usually of 10, is full."""

from __future__ import annotations

import time
from collections import deque

from ros2_mcp_bridge.request import OperationError, Request, Steps

# How many of the 10 places in a server's default queue are used; two are left for its other clients.
ROOM = 8
# The presumed time in which a server takes one request while it answers none: some take all at once and answer late.
# With two places left, a server that does not run for twice this time loses nothing.
TAKEN_EVERY_S = 0.2
NOT_SENT = "The call was not sent in time: too many other calls wait for answers."


class Pace:
    """Paces requests to a server, assuming that it takes them in order, and one every 0.2 s while it answers none.

    So the first requests are sent at once, the others as fast as they are answered, and at least 5 a second.
    """

    def __init__(self) -> None:
        self.has_answered = False
        self._queue: deque[Request] = deque()
        self._untaken: dict[Request, None] = {}  # in the order of sending
        self._taken_at = time.monotonic()

    def wait_turn(self, request: Request, latest: float) -> Steps[None]:
        """Steps that end when the request may be sent.

        Raises:
            OperationError: of kind `timeout`, if that is not so by `latest` (monotonic, s).
        """
        if not self._queue:
            self._take(int((time.monotonic() - self._taken_at) / TAKEN_EVERY_S))
        self._queue.append(request)
        try:
            while self._queue[0] is not request or not self._has_room():
                if time.monotonic() >= latest:
                    raise OperationError("timeout", NOT_SENT, "Make fewer calls at once, or wait for longer.")
                yield TAKEN_EVERY_S
            self._untaken[request] = None
        finally:
            self._queue.remove(request)
            self._wake_next()

    def answered(self, request: Request) -> None:
        """Record that the request was answered: so the server has taken it, and all requests sent before it."""
        self.has_answered = True
        if request in self._untaken:
            self._take(list(self._untaken).index(request) + 1)
        self._wake_next()

    def _has_room(self) -> bool:
        # Only one each time, however long it has been: while this process did not run, the server may not have run,
        # either.
        if time.monotonic() - self._taken_at >= TAKEN_EVERY_S:
            self._take(1)
        return len(self._untaken) < ROOM

    def _take(self, count: int) -> None:
        if count:
            self._taken_at = time.monotonic()
            for request in list(self._untaken)[:count]:
                del self._untaken[request]

    def _wake_next(self) -> None:
        if self._queue:
            self._queue[0].wake()
