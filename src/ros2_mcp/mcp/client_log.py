"""MCP's logging of the handshake era: a client that asks by `logging/setLevel` is sent the server's own log.

Nothing is sent to who did not ask. The modern era has no such request, and its deprecated logging is not offered. The
log of the robot's nodes is something else: `ros2_log_read` and `ros2://log`.
"""

from __future__ import annotations

import asyncio
import logging
from collections import deque
from contextlib import suppress
from typing import TYPE_CHECKING, Any, cast

import anyio
from mcp.shared.exceptions import MCPError
from mcp.types import (
    INVALID_REQUEST,
    EmptyResult,
    LoggingLevel,
    LoggingMessageNotification,
    LoggingMessageNotificationParams,
    SetLevelRequestParams,
)
from mcp_types.version import HANDSHAKE_PROTOCOL_VERSIONS

from ros2_mcp.model.text import visible

if TYPE_CHECKING:
    from mcp.server.context import CallNext, ServerRequestContext
    from mcp.server.session import ServerSession

MAX_TEXT = 2000
"""Characters of a line, before what is hidden becomes codes: as much as `ros2_log_read` shows of one."""
MAX_WAITING = 100
"""Lines that wait for a client: 5 s of the rate, and more than one failure of ours writes."""
BETWEEN_S = 0.05
"""Between two lines: 20 a second are more than a person reads, and leave the wire to the answers."""
LEVELS: dict[LoggingLevel, int] = {
    **{"debug": 10, "info": 20, "notice": 25, "warning": 30, "error": 40, "critical": 50, "alert": 55, "emergency": 60}
}
"""MCP's levels as numbers of Python's `logging`, whose own five have the same names."""
_OURS = logging.getLogger("ros2_mcp")


class Follower(logging.Handler):
    """The lines that wait for one client; never blocks who logs. What is beyond its bounds is counted, and told."""

    def __init__(self) -> None:
        super().__init__()
        self._waiting = deque[tuple[LoggingLevel, str, str]]()
        self._left_out = 0
        self._arrived = asyncio.Event()
        self._loop = asyncio.get_running_loop()

    def emit(self, record: logging.LogRecord) -> None:
        """Takes a line in, from any thread."""
        if len(self._waiting) >= MAX_WAITING:
            self._left_out += 1
            return
        text = record.getMessage()
        if record.exc_info:
            text += f": {record.exc_info[1]!r}"  # the traceback stands on stderr
        self._waiting.append((cast("LoggingLevel", record.levelname.lower()), record.name, text[:MAX_TEXT]))
        with suppress(RuntimeError):  # the loop has ended, and with it the client
            self._loop.call_soon_threadsafe(self._arrived.set)

    async def send(self, session: ServerSession) -> None:
        """Sends the client what it asked for, until cancelled."""
        while True:
            await self._arrived.wait()
            self._arrived.clear()
            while self._waiting:
                level, name, text = self._waiting.popleft()
                if not self._waiting and self._left_out:
                    text, self._left_out = f"{text} ({self._left_out} lines were left out meanwhile)", 0
                params = LoggingMessageNotificationParams(level=level, logger=name, data=visible(text))
                await session.send_notification(LoggingMessageNotification(params=params))
                await anyio.sleep(BETWEEN_S)


class Following:
    """The clients of the handshake era, and which of them follow the log; recognised as in `resources/push.py`."""

    def __init__(self) -> None:
        self._followers: dict[int, Follower] = {}

    async def attend(self, ctx: ServerRequestContext[Any, Any], call_next: CallNext) -> Any:
        """As a middleware of the server: `notifications/initialized` lasts as long as its client is connected."""
        client = id(ctx.session.client_params)
        has_come = ctx.method == "notifications/initialized" and ctx.session.client_params
        if not has_come or client in self._followers or ctx.protocol_version not in HANDSHAKE_PROTOCOL_VERSIONS:
            return await call_next(ctx)
        follower = self._followers[client] = Follower()
        try:
            async with anyio.create_task_group() as tasks:
                tasks.start_soon(follower.send, ctx.session)
                await call_next(ctx)
        finally:
            del self._followers[client]
            _OURS.removeHandler(follower)
            _log_what_is_followed()

    async def set_level(self, ctx: ServerRequestContext[Any, Any], params: SetLevelRequestParams) -> EmptyResult:
        """From now on the client is sent what is of this level or above.

        Raises:
            MCPError: for a client that has not said that it is initialized.
        """
        follower = self._followers.get(id(ctx.session.client_params))
        if follower is None:
            raise MCPError(INVALID_REQUEST, "Send notifications/initialized before you set the level of the log.")
        follower.setLevel(LEVELS[params.level])
        _OURS.addHandler(follower)
        _log_what_is_followed()
        return EmptyResult()


def _log_what_is_followed() -> None:
    """What stderr shows has a level of its own (`show_log`): ours is the lowest that anybody wants."""
    levels = [follower.level for follower in _OURS.handlers]
    _OURS.setLevel(min(logging.getLogger().level, *levels) if levels else logging.NOTSET)
