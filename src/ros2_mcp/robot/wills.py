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

if TYPE_CHECKING:
    from ros2_mcp.robot.graph import Graph

MOST = 64
_FOREVER_S = 1e9
_logger = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True)
class Will:
    """A message to publish (`will_publish`), or a request to send (`will_call`), as CDR."""

    op: str
    body: bytes
    arguments: Mapping[str, Any]


class Wills:
    """The wills that are in force, by key; the oldest gives way where there are too many."""

    def __init__(self, graph: Graph) -> None:
        self._graph = graph
        self._held: dict[str, asyncio.Task[None]] = {}

    def leave(self, key: str, will: Will) -> None:
        """Puts a will in force, unless one of that key is."""
        if key in self._held:
            return
        if len(self._held) >= MOST:
            self.withdraw(next(iter(self._held)))
        held = asyncio.create_task(self._hold(will))
        self._held[key] = held
        held.add_done_callback(lambda _: self._held.pop(key, None) if self._held.get(key) is held else None)

    def withdraw(self, key: str) -> None:
        """Takes a will back; without effect where there is none."""
        held = self._held.pop(key, None)
        if held is not None:
            held.cancel()

    async def _hold(self, will: Will) -> None:
        try:
            while True:
                try:
                    await self._graph.ask(will.op, will.body, timeout_s=_FOREVER_S, **will.arguments)
                except BridgeLost:
                    await self._after_loss(will)
        except RobotError as error:
            if not self._graph.is_closed:
                _logger.warning("a last will is not in force: %s", error)

    async def _after_loss(self, will: Will) -> None:
        """A bridge that was killed could not stop what it kept moving: its successor does it at once."""
        if will.op == "will_publish":
            await self._graph.ask("publish", will.body, wait_match_s=1.0, wait_ack_s=0.5, **will.arguments)
