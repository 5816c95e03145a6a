"""The stop epoch: what was accepted before a stop is not sent after it."""

from __future__ import annotations

from collections.abc import Generator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import TYPE_CHECKING

import anyio

from ros2_mcp.model.commands import Principal
from ros2_mcp.model.errors import Stopped
from ros2_mcp.robot.no_known_stop import NoKnownStop

if TYPE_CHECKING:
    from ros2_mcp.link.client import Bridge

_MOST_ENDED = 1000
"""Clients whose ends are remembered: more than can have a call under way that was accepted before their end."""
_STOPPED = "ros2_stop came after this call was accepted: nothing was sent."
_DEPARTURE = "the end of its client"
_CLIENT_GONE = "Ended: the client that asked for it has gone."


@dataclass(frozen=True, slots=True)
class Accepted:
    """When a call was accepted: the stop epoch of that time, and how many ends of clients there had been."""

    epoch: int
    ends: int


class Stops:
    """How often all work, and that of each client, has been ended. The bridge keeps the epoch, too: it is told of it
    with every request that acts and with every ping, and refuses what is older where it would leave.

    `unknown` names what was sent whose stop is not known.
    """

    def __init__(self, bridge: Bridge) -> None:
        self._bridge = bridge
        self._ended_at: dict[Principal, int] = {}
        self._ends = 0
        self._leaving: set[tuple[Principal, anyio.CancelScope]] = set()
        self.epoch = 0
        self.unknown = NoKnownStop()

    def raise_epoch(self) -> None:
        """A stop of everything begins: from now on nothing leaves that was accepted before."""
        self.epoch += 1
        self._bridge.stop_epoch = self.epoch

    def end_of(self, principal: Principal) -> None:
        """Ends what one client has under way: what was accepted before and has not left, nor been answered."""
        self._ends += 1
        self._ended_at.pop(principal, None)
        self._ended_at[principal] = self._ends
        if len(self._ended_at) > _MOST_ENDED:
            del self._ended_at[next(iter(self._ended_at))]
        for owner, scope in [*self._leaving]:
            if owner == principal:
                scope.cancel()

    def is_leaving(self, principal: Principal) -> bool:
        """Whether a request of that client that acts has not been answered."""
        return any(owner == principal for owner, _ in self._leaving)

    def now(self) -> Accepted:
        """What a call is accepted with at this time."""
        return Accepted(self.epoch, self._ends)

    def check(self, principal: Principal, accepted: Accepted) -> None:
        """Raises `Stopped` if what was accepted then must not be sent any more."""
        if accepted.epoch != self.epoch:
            raise Stopped(_STOPPED)
        if accepted.ends < self._ended_at.get(principal, 0):
            raise Stopped(_CLIENT_GONE, reason=_DEPARTURE)

    @contextmanager
    def leaving(self, principal: Principal) -> Generator[None, None, None]:
        """Around a request that acts, until it is answered; raises `Stopped` if `end_of` its client ends it."""
        with anyio.CancelScope() as scope:
            self._leaving.add((principal, scope))
            try:
                yield
                return
            finally:
                self._leaving.discard((principal, scope))
        raise Stopped(_CLIENT_GONE, reason=_DEPARTURE, may_have_left=True)
