# pyright: basic
"""Fail-safes: what is done when the stream ends, whatever ends it: final messages, and what the server has left."""

from __future__ import annotations

import sys
from contextlib import contextmanager

from .request import Cancelled

HOLD_S = 3600.0


class FailSafes:
    """The fail-safe of each open request that has one: what is called at the end.

    It returns what is `done()` when it has arrived, or None.
    """

    def __init__(self):
        self._actions = {}

    def count(self, op):
        """How many requests of that kind have a fail-safe in force."""
        return sum(request.op == op for request in self._actions)

    @contextmanager
    def in_force(self, request, action):
        """The action is in force inside of this context."""
        self._actions[request] = action
        try:
            yield
        finally:
            self._actions.pop(request, None)

    def until_cancelled(self, request, action):
        """Steps that keep the action in force until the request is cancelled."""
        with self.in_force(request, action):
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
        for request, action in sorted(self._actions.items(), key=lambda entry: entry[0].op == "failsafe_call"):
            try:
                pending.append(action())
            except Exception as error:  # noqa: BLE001 - one that fails must not keep the others from being done
                sys.stderr.write(f"the fail-safe of {request.op} could not be carried out: {error}\n")
        return [future for future in pending if future is not None]
