"""Fail-safes: what is done when the server is gone, or silent: zeros on driven topics, and what the server has left."""

from __future__ import annotations

import sys
from collections.abc import Callable, Generator
from contextlib import contextmanager
from typing import Protocol

from ros2_mcp_bridge.request import Cancelled, Request, Steps
from ros2_mcp_common.wire import protocol

# A request that only keeps a fail-safe has nothing to wake up for: cancelling ends this sleep. Any long time would do.
HOLD_S = 3600.0


class Arrival(Protocol):
    """What tells whether something sent has arrived: a future of rclpy, or a `Publisher`."""

    def done(self) -> bool:
        """Whether there is nothing more to wait for."""
        ...


Action = Callable[[], "Arrival | None"]
"""Sends something at the end; returns what is to be waited for, if anything."""


class FailSafes:
    """The zeros of the topics that are driven, which `send_zeros` sends, and what requests have left to be done."""

    def __init__(self, send_zeros: Callable[[], None]) -> None:
        self._send_zeros = send_zeros
        self._actions: dict[Request, Action] = {}

    @contextmanager
    def in_force(self, request: Request, action: Action) -> Generator[None, None, None]:
        """The action is in force inside of this context."""
        self._actions[request] = action
        try:
            yield
        finally:
            self._actions.pop(request, None)

    def until_cancelled(self, request: Request, action: Action) -> Steps[protocol.Cancelled]:
        """Steps that keep the action in force until the request is cancelled."""
        with self.in_force(request, action):
            try:
                while True:
                    yield HOLD_S
            except Cancelled:
                return {"cancelled": True}

    @property
    def has_goals(self) -> bool:
        """Whether something is left to be done besides zeros: a goal runs that is to be cancelled."""
        return bool(self._actions)

    def carry_out(self) -> list[Arrival]:
        """Carry all of them out, zeros first, because calls can block; returns what to wait for.

        Another thread does this when the ROS thread hangs. If the ROS thread comes to it later, it does it once more:
        it may have published something after the zeros.
        """
        self._send_zeros()
        pending: list[Arrival] = []
        for request, action in list(self._actions.items()):
            try:
                arrival = action()
            except Exception as error:  # noqa: BLE001 - one that fails must not keep the others from being done
                sys.stderr.write(f"the fail-safe of {request.op} could not be carried out: {error}\n")
            else:
                pending += [] if arrival is None else [arrival]
        return pending
