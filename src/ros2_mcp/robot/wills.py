"""Last wills: what the bridge does for us when this process dies, however it dies.

A will is a request that stays open. The bridge carries it out when the stream ends; withdrawing it cancels the request.
"""

from __future__ import annotations

import asyncio
import logging
from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from ros2_mcp.model.errors import BridgeLost, RobotError
from ros2_mcp_bridge.limits import MAX_FAILSAFES

if TYPE_CHECKING:
    from ros2_mcp.robot.graph import Graph

_FOREVER_S = 1e9
_DISCOVERED_S = 10.0
_logger = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True)
class Will:
    """A message to publish (`failsafe_publish`), or a request to send (`failsafe_call`), as CDR."""

    op: str
    body: bytes
    arguments: Mapping[str, Any]


class Wills:
    """The wills that are in force, by key. Where there are too many of one kind, its oldest gives way: goals that
    nobody followed to their end never displace a zero command.
    """

    def __init__(self, graph: Graph) -> None:
        self._graph = graph
        self._held: dict[str, tuple[str, asyncio.Task[None]]] = {}
        self._being_done: dict[str, asyncio.Task[None]] = {}

    def leave(self, key: str, will: Will) -> None:
        """Puts a will in force, unless one of that key is. The robot is moved anew, so that an old one is past."""
        if key in self._being_done:
            self._being_done.pop(key).cancel()
        if key in self._held:
            return
        of_this_kind = [other for other, (op, _) in self._held.items() if op == will.op]
        if len(of_this_kind) >= MAX_FAILSAFES:
            self.withdraw(of_this_kind[0])
        self._held[key] = will.op, asyncio.create_task(self._hold(key, will))

    def withdraw(self, key: str) -> None:
        """Takes a will back; without effect where there is none."""
        if key in self._held:
            self._held.pop(key)[1].cancel()

    async def _hold(self, key: str, will: Will) -> None:
        try:
            await self._keep_in_force(key, will)
        except RobotError as error:
            self._held.pop(key, None)
            if not self._graph.is_closed:
                _logger.warning("a last will is not in force: %s", error)

    async def _keep_in_force(self, key: str, will: Will) -> None:
        """A bridge that was killed could not stop what it kept moving: its successor does it at once."""
        while True:
            try:
                await self._graph.ask(will.op, will.body, timeout_s=_FOREVER_S, **will.arguments)
            except BridgeLost:
                if will.op == "failsafe_publish":
                    self._being_done[key] = asyncio.create_task(self._publish(key, will))

    async def _publish(self, key: str, will: Will) -> None:
        """The new bridge has yet to discover the robot: the message waits for it."""
        patience = {"wait_match_s": _DISCOVERED_S, "wait_ack_s": 0.5, "timeout_s": 2 * _DISCOVERED_S}
        try:
            await self._graph.ask("publish", will.body, **patience, **will.arguments)
        except RobotError as error:
            if not self._graph.is_closed:
                _logger.warning("%s could not be stopped after the bridge was lost: %s", key, error)
        finally:
            if self._being_done.get(key) is asyncio.current_task():
                del self._being_done[key]
