"""Fail-safes: what is done when the server is gone, or silent: zeros on driven topics, and what the server has left."""

from __future__ import annotations

import sys
from collections.abc import Callable, Generator
from contextlib import contextmanager
from typing import Any, NamedTuple, Protocol

from ros2_mcp_bridge.request import Cancelled, OperationError, Request, Steps
from ros2_mcp_common.policy.flight import brakes, only_asks, vehicle_of
from ros2_mcp_common.policy.verbs import meaning
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


class Motion(NamedTuple):
    """What a call sets in motion, and a fail-safe ends: a goal of an action by its id, or a vehicle (`goal_id` "")."""

    name: str
    goal_id: str = ""

    def __str__(self) -> str:
        return f"goal {self.goal_id} of {self.name}" if self.goal_id else f"the vehicle {self.name}"


def begun_by(service: str, type_name: str, message: Any) -> Motion | None:
    """What a call with this decoded request sets in motion that a fail-safe has to end; None where there is nothing."""
    meant = meaning(service, type_name)
    if meant.verb == "goal":
        return Motion(meant.name, bytes(message.goal_id.uuid).hex())
    vehicle = vehicle_of(service, type_name)
    if vehicle and not only_asks(type_name, message) and not brakes(service, type_name, message):
        return Motion(vehicle)
    return None


def ended_by(service: str, type_name: str, message: Any) -> Motion | None:
    """What a call with this decoded request ends; None where it cancels no goal and makes no vehicle stand."""
    meant = meaning(service, type_name)
    if meant.verb == "cancel":
        return Motion(meant.name, bytes(message.goal_info.goal_id.uuid).hex())
    return Motion(vehicle_of(service, type_name)) if brakes(service, type_name, message) else None


class FailSafes:
    """The zeros of the topics that are driven, which `send_zeros` sends, and what requests have left to be done."""

    def __init__(self, send_zeros: Callable[[], None]) -> None:
        self._send_zeros = send_zeros
        self._actions: dict[Request, Action] = {}
        self._ends: dict[Request, Motion] = {}

    @contextmanager
    def in_force(self, request: Request, action: Action, ends: Motion | None = None) -> Generator[None, None, None]:
        """The action, which `ends` this motion, is in force inside of this context."""
        self._actions[request] = action
        if ends:
            self._ends[request] = ends
        try:
            yield
        finally:
            self._actions.pop(request, None)
            self._ends.pop(request, None)

    def check_held(self, motion: Motion) -> None:
        """Raise `OperationError` of kind `bad_request` where no fail-safe that ends this motion is in force."""
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
