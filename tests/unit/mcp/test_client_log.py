"""Who asked for the server's log is sent it, bounded and visible; nobody else is, and who has gone is forgotten."""

from __future__ import annotations

import asyncio
import logging
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from typing import Any

import pytest
from mcp import Client
from mcp.shared.exceptions import MCPDeprecationWarning
from mcp.types import LoggingMessageNotificationParams

from ros2_mcp.compose.server import assemble
from ros2_mcp.mcp.client_log import MAX_TEXT, MAX_WAITING
from ros2_mcp.settings import Settings
from support.tasks import soon

OURS = logging.getLogger("ros2_mcp")
A_PART = logging.getLogger("ros2_mcp.robot.jobs")
pytestmark = pytest.mark.filterwarnings(f"ignore::{MCPDeprecationWarning.__module__}.{MCPDeprecationWarning.__name__}")


class Told(list[LoggingMessageNotificationParams]):
    """What one client was sent."""

    async def take(self, params: LoggingMessageNotificationParams) -> None:
        self.append(params)

    def texts(self) -> list[Any]:
        return [params.data for params in self]


@asynccontextmanager
async def connected(server: Any, level: Any = None) -> AsyncIterator[tuple[Client, Told]]:
    """A client of the handshake era that follows the log from a level on, if one is given."""
    told = Told()
    async with Client(server, mode="legacy", logging_callback=told.take) as client:
        if level:
            await client.set_logging_level(level)
        yield client, told


@pytest.fixture
def server(anyio_backend: str) -> Any:
    """One whose robot is never asked for."""
    return assemble(Settings()).server


async def test_who_asked_is_sent_the_level_or_above_and_nobody_else_is_sent_anything(server: Any) -> None:
    async with connected(server, "info") as (client, told), connected(server) as (_, silent):
        for number in (logging.DEBUG, logging.INFO, logging.WARNING):
            A_PART.log(number, "line of %d", number)
        logging.getLogger("asyncio").error("none of ours")
        await soon(lambda: told.texts() == ["line of 20", "line of 30"])
        assert [(params.level, params.logger) for params in told] == [("info", A_PART.name), ("warning", A_PART.name)]
        await client.set_logging_level("error")
        A_PART.warning("not any more")
        A_PART.error("an error")
        await soon(lambda: told.texts()[2:] == ["an error"])
    assert silent == []


async def test_who_has_gone_is_forgotten(server: Any) -> None:
    before = OURS.handlers[:], OURS.level
    async with connected(server, "debug"), connected(server, "alert"):
        assert OURS.level == logging.DEBUG and len(OURS.handlers) == len(before[0]) + 2
    assert (OURS.handlers, OURS.level) == before


async def test_lines_are_visible_short_and_without_a_traceback(server: Any) -> None:
    async with connected(server, "debug") as (_, told):
        A_PART.warning("one\ntwo\u202e%s", "x" * 10_000)
        try:
            raise ZeroDivisionError("not foreseen")
        except ZeroDivisionError:
            A_PART.exception("it failed")
        await soon(lambda: len(told) == 2)
    assert told[0].data.startswith("one⟦U+000A⟧two⟦U+202E⟧xxx") and len(told[0].data) < MAX_TEXT + 20
    assert told[1].data == "it failed: ZeroDivisionError('not foreseen')"


async def test_who_logs_too_much_is_not_held_up_and_what_is_left_out_is_counted(server: Any) -> None:
    def flood() -> None:
        for number in range(MAX_WAITING + 50):
            A_PART.info("line %d", number)

    async with connected(server, "info") as (client, told):
        flood()
        assert not told
        await client.list_tools()  # is answered meanwhile
        assert len(told) < MAX_WAITING
        await soon(lambda: len(told) == MAX_WAITING)
        assert told[-1].data == f"line {MAX_WAITING - 1} (50 lines were left out meanwhile)"
        await asyncio.to_thread(A_PART.info, "from a thread")
        await soon(lambda: told[-1].data == "from a thread")


async def test_logging_is_offered_in_the_era_that_has_the_request(server: Any) -> None:
    async with Client(server, mode="legacy") as client:
        assert client.server_capabilities.logging is not None
    async with Client(server, mode="auto") as client:
        assert client.server_capabilities.logging is None and client.server_capabilities.tools is not None
