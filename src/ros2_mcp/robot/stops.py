"""The stop epoch: commands that were accepted before a stop are not sent after it."""

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
"""The most disconnected clients that are remembered: more than can have a call in progress that was accepted before."""
_STOPPED = "ros2_stop came after this call was accepted: nothing was sent."
_DEPARTURE = "the end of its client"
_CLIENT_GONE = "Ended: the client that asked for it has gone."


@dataclass(frozen=True, slots=True)
class Accepted:
    """The time at which a call was accepted: the stop epoch, and the number of disconnected clients so far."""

    epoch: int
    ends: int


class Stops:
    """Counters of stops and of disconnected clients. The bridge has the epoch as well: it gets it with every request
    that acts and with every ping, and refuses to send anything older.

    `unknown` has the names of what was sent without a known way to stop it.
    """

    def __init__(self, bridge: Bridge) -> None:
        self._bridge = bridge
        self._ended_at: dict[Principal, int] = {}
        self._ends = 0
        self._leaving: set[tuple[Principal, anyio.CancelScope]] = set()
        self.epoch = 0
        self.unknown = NoKnownStop()

    def raise_epoch(self) -> None:
        """Begin a stop of everything: from now on nothing is sent that was accepted before."""
        self.epoch += 1
        self._bridge.stop_epoch = self.epoch

    def end_of(self, principal: Principal) -> None:
        """End the work of a client that was accepted before now and has not been sent, or not been answered."""
        self._ends += 1
        self._ended_at.pop(principal, None)
        self._ended_at[principal] = self._ends
        if len(self._ended_at) > _MOST_ENDED:
            del self._ended_at[next(iter(self._ended_at))]
        for owner, scope in [*self._leaving]:
            if owner == principal:
                scope.cancel()

    def is_leaving(self, principal: Principal) -> bool:
        """Return whether a request that acts, of this client, has not been answered."""
        return any(owner == principal for owner, _ in self._leaving)

    def now(self) -> Accepted:
        """Return the acceptance of a call at this time."""
        return Accepted(self.epoch, self._ends)

    def check(self, principal: Principal, accepted: Accepted) -> None:
        """Raise `Stopped` if work with this acceptance must no longer be sent."""
        if accepted.epoch != self.epoch:
            raise Stopped(_STOPPED)
        if accepted.ends < self._ended_at.get(principal, 0):
            raise Stopped(_CLIENT_GONE, reason=_DEPARTURE)

    @contextmanager
    def leaving(self, principal: Principal) -> Generator[None, None, None]:
        """A context manager around a request that acts; raises `Stopped` if `end_of` ends it for its client."""
        with anyio.CancelScope() as scope:
            self._leaving.add((principal, scope))
            try:
                yield
                return
            finally:
                self._leaving.discard((principal, scope))
        raise Stopped(_CLIENT_GONE, reason=_DEPARTURE, may_have_left=True)
