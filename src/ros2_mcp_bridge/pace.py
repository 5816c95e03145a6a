# pyright: basic
"""How fast requests go to one service: its server loses those for which its queue, usually of 10, has no room."""

from __future__ import annotations

import time
from collections import deque

from .request import OperationError

ROOM = 8
TAKEN_EVERY_S = 0.05
LONGEST_STALL_S = 4.0
NOT_SENT = "It was not sent in time: too many others wait for their answers."


class Pace:
    """Presumes that a server takes a request every 50 ms, and has taken those that it has answered.

    So the first requests go out at once, the others as fast as they are answered, and at least 20 a second.
    """

    def __init__(self):
        self._queue = deque()
        self._untaken = {}  # by request: when it is presumed to be taken, on the clock of `_now`
        self._clock = self._looked_at = time.monotonic()

    def wait_turn(self, request, latest):
        """Steps that end when the request may be sent; `latest` is the time to give up, on the steady clock."""
        self._now()  # where nobody has waited, time has passed
        self._queue.append(request)
        try:
            while self._queue[0] is not request or not self._has_room():
                if time.monotonic() >= latest:
                    raise OperationError("timeout", NOT_SENT, "Make fewer calls at once, or wait for longer.")
                yield TAKEN_EVERY_S
            self._untaken[request] = max([self._now(), *self._untaken.values()]) + TAKEN_EVERY_S
        finally:
            self._queue.remove(request)
            self._wake_next()

    def answered(self, request):
        """Its answer has come."""
        self._untaken.pop(request, None)
        self._wake_next()

    def _has_room(self):
        now = self._now()
        self._untaken = {request: taken_at for request, taken_at in self._untaken.items() if taken_at > now}
        return len(self._untaken) < ROOM

    def _now(self):
        """A clock that stands still where this process is not run while requests wait: the server may not be either."""
        now = time.monotonic()
        passed_s, self._looked_at = now - self._looked_at, now
        is_stall = self._queue and 2 * TAKEN_EVERY_S < passed_s < LONGEST_STALL_S
        self._clock += TAKEN_EVERY_S if is_stall else passed_s
        return self._clock

    def _wake_next(self):
        if self._queue:
            self._queue[0].wake()
