"""Fail-safes: the actions of the bridge when the server is gone or silent.

It publishes zeros on driven topics, cancels goals and stops vehicles.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Generator
from contextlib import contextmanager
from typing import Any, NamedTuple, Protocol

from ros2_mcp_bridge.request import Cancelled, OperationError, Request, Steps
from ros2_mcp_common.policy.flight import brakes, only_asks, vehicle_of
from ros2_mcp_common.policy.verbs import meaning
from ros2_mcp_common.wire import protocol

# The sleep of a request that only keeps a fail-safe in force. Cancelling the request ends the sleep, so the length does
# not matter.
HOLD_S = 3600.0


class Arrival(Protocol):
    """A message or call in transit, with whether it has arrived: a future of rclpy, or a `Publisher`."""

    def done(self) -> bool:
        """Return whether there is nothing more to wait for."""
        ...


Action = Callable[[], "Arrival | None"]
"""Performs one fail-safe. Returns what to wait for, or None."""


class Motion(NamedTuple):
    """A motion that a fail-safe ends: an action goal, by its id in hex, or a vehicle (`goal_id` is "")."""

    name: str
    goal_id: str = ""

    def __str__(self) -> str:
        return f"goal {self.goal_id} of {self.name}" if self.goal_id else f"the vehicle {self.name}"


def begun_by(service: str, type_name: str, message: Any) -> Motion | None:
    """Return the motion that this call starts, or None if it starts none that a fail-safe has to end.

    `message` is the decoded request of the service call.
    """
    meant = meaning(service, type_name)
    if meant.verb == "goal":
        return Motion(meant.name, bytes(message.goal_id.uuid).hex())
    vehicle = vehicle_of(service, type_name)
    if vehicle and not only_asks(type_name, message) and not brakes(service, type_name, message):
        return Motion(vehicle)
    return None


def ended_by(service: str, type_name: str, message: Any) -> Motion | None:
    """Return the motion that this call ends, or None if it neither cancels a goal nor stops a vehicle.

    `message` is the decoded request of the service call.
    """
    meant = meaning(service, type_name)
    if meant.verb == "cancel":
        return Motion(meant.name, bytes(message.goal_info.goal_id.uuid).hex())
    return Motion(vehicle_of(service, type_name)) if brakes(service, type_name, message) else None


class FailSafes:
    """The fail-safes in force: the zeros of driven topics (`send_zeros` publishes them), and one action per request."""

    def __init__(self, send_zeros: Callable[[], None]) -> None:
        self._send_zeros = send_zeros
        self._actions: dict[Request, Action] = {}
        self._ends: dict[Request, Motion] = {}

    @contextmanager
    def in_force(self, request: Request, action: Action, ends: Motion | None = None) -> Generator[None, None, None]:
        """A context manager in which the action that ends the motion `ends` is in force for the request."""
        self._actions[request] = action
        if ends:
            self._ends[request] = ends
        try:
            yield
        finally:
            self._actions.pop(request, None)
            self._ends.pop(request, None)

    def check_held(self, motion: Motion) -> None:
        """Raise `OperationError` of kind `bad_request` if no fail-safe in force ends this motion."""
        if motion not in self._ends.values():
            problem = f"No fail-safe is in force that ends {motion}: nothing was sent."
            raise OperationError("bad_request", problem)

    def until_cancelled(
        self, request: Request, action: Action, ends: Motion | None = None
    ) -> Steps[protocol.Cancelled]:
        """Steps that keep the action in force until the request is cancelled."""
        with self.in_force(request, action, ends):
            try:
                while True:
                    yield HOLD_S
            except Cancelled:
                return {"cancelled": True}

    @property
    def has_goals(self) -> bool:
        """Whether an action, such as cancelling a goal, is in force besides the zeros."""
        return bool(self._actions)

    def carry_out(self) -> list[Arrival]:
        """Publish all zeros, then perform all actions, and return what to wait for. Zeros go first,
        because a call can block.

        Another thread calls this when the ROS thread hangs. If the ROS thread recovers, it calls this again, because it
        may have published something after the zeros.
        """
        self._send_zeros()
        pending: list[Arrival] = []
        for request, action in list(self._actions.items()):
            try:
                arrival = action()
            except Exception as error:  # noqa: BLE001 - a failed action must not prevent the others
                sys.stderr.write(f"the fail-safe of {request.op} could not be carried out: {error}\n")
            else:
                pending += [] if arrival is None else [arrival]
        return pending
