# pyright: basic
"""What is done last when the stream ends, whatever ends it: final messages, and the wills that the server left."""

from __future__ import annotations

import sys
from contextlib import contextmanager

from .request import Cancelled

HOLD_S = 3600.0


class Wills:
    """The last deed of each open request that has one. It returns what is `done()` when it has arrived, or None."""

    def __init__(self):
        self._deeds = {}

    def count(self, op):
        """How many requests of that kind have a deed in force."""
        return sum(request.op == op for request in self._deeds)

    @contextmanager
    def held(self, request, deed):
        """The deed is in force inside of this context."""
        self._deeds[request] = deed
        try:
            yield
        finally:
            self._deeds.pop(request, None)

    def hold(self, request, deed):
        """Steps that keep the deed in force until the request is cancelled."""
        with self.held(request, deed):
            try:
                while True:
                    yield HOLD_S
            except Cancelled:
                return {"cancelled": True}

    def carry_out(self):
        """Do it all, calls after messages, because they can block; returns what to wait for.

        Another thread does it when the ROS thread does not come to it. The ROS thread then does it once more, for what
        it was about to publish may have followed.
        """
        pending = []
        for request, deed in sorted(self._deeds.items(), key=lambda entry: entry[0].op == "will_call"):
            try:
                pending.append(deed())
            except Exception as error:  # noqa: BLE001 - one that fails must not keep the others from being done
                sys.stderr.write(f"the last deed of {request.op} could not be done: {error}\n")
        return [each for each in pending if each is not None]
