"""MCP over stdio: one message per line, and an answer to each request, even to a request that cannot be read."""

from __future__ import annotations

import json
import logging
import os
import select
import stat
import sys
from collections.abc import AsyncIterable, AsyncIterator, Awaitable, Callable
from contextlib import suppress
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import anyio
from anyio import to_thread
from mcp.shared.message import ServerMessageMetadata, SessionMessage
from mcp.types import INTERNAL_ERROR, JSONRPCMessage, JSONRPCNotification, JSONRPCRequest
from pydantic_core import PydanticSerializationError

from ros2_mcp.mcp.server import ANNOUNCED
from ros2_mcp.mcp.transports.jsonrpc import Refusal, read_message
from ros2_mcp.model.aside import LARGE, READING, aside

if TYPE_CHECKING:
    from anyio.streams.memory import MemoryObjectReceiveStream, MemoryObjectSendStream
    from mcp.server.lowlevel import Server

_READ_BYTES = 65_536
"""The usual capacity of a pipe."""
_logger = logging.getLogger(__name__)


async def serve_stdio(server: Server[Any], read_fd: int, write_fd: int) -> None:
    """Serve one client over two file descriptors that carry only MCP, until the client closes its side."""
    take_at_once = _taker(write_fd)

    async def write(line: str) -> None:
        rest = line.encode() + b"\n"
        if len(rest) <= LARGE:  # a thread costs more than the call
            rest = take_at_once(rest)
        if rest:
            await to_thread.run_sync(_write_all, write_fd, rest)

    await serve_lines(server, Lines(_lines_of(read_fd), write))


def _taker(write_fd: int) -> Callable[[bytes], bytes]:
    """Return a function that writes as much as fits without blocking, and returns the rest.

    If it cannot know how much fits, it writes nothing.
    """
    if sys.platform == "win32" or stat.S_IFMT(os.fstat(write_fd).st_mode) not in (stat.S_IFIFO, stat.S_IFSOCK):
        return lambda data: data
    room = select.poll()
    room.register(write_fd, select.POLLOUT)

    def take(rest: bytes) -> bytes:
        while rest and room.poll(0):  # then PIPE_BUF bytes fit without blocking
            rest = rest[os.write(write_fd, rest[: select.PIPE_BUF]) :]
        return rest

    return take


async def _lines_of(read_fd: int) -> AsyncIterator[bytes]:
    begun = bytearray()
    while piece := await _piece_of(read_fd):
        begun += piece
        if b"\n" in piece:
            *whole, begun = begun.split(b"\n")
            for line in whole:
                yield bytes(line)
    yield bytes(begun)


async def _piece_of(read_fd: int) -> bytes:
    """Return the bytes that have arrived, as soon as there are any; empty at the end. It needs no thread, which costs
    more than reading, except on Windows, where a pipe can only be awaited in a thread.
    """
    if sys.platform == "win32":
        return await to_thread.run_sync(os.read, read_fd, _READ_BYTES, abandon_on_cancel=True)
    with suppress(PermissionError):  # a file can always be read
        await anyio.wait_readable(read_fd)
    return os.read(read_fd, _READ_BYTES)


def _write_all(write_fd: int, data: bytes) -> None:
    rest = memoryview(data)
    while rest:
        rest = rest[os.write(write_fd, rest) :]


@dataclass(frozen=True, slots=True)
class Lines:
    """The lines of one client: an iterator of incoming lines, and a function that writes one line."""

    incoming: AsyncIterable[bytes]
    write: Callable[[str], Awaitable[None]]


async def serve_lines(server: Server[Any], lines: Lines, peer: object = None) -> None:
    """Serve one client until its lines end. `peer` is attached to each of its requests as their origin."""
    to_server, incoming = anyio.create_memory_object_stream[SessionMessage | Exception]()
    outgoing, from_server = anyio.create_memory_object_stream[SessionMessage]()
    wire = _Wire(lines, ServerMessageMetadata(request_context=peer) if peer else None)
    async with anyio.create_task_group() as tasks:
        tasks.start_soon(wire.read_all, to_server)
        tasks.start_soon(wire.write_all, from_server)
        await server.run(incoming, outgoing, server.create_initialization_options(ANNOUNCED))


class _Wire:
    """The lines of one client, in both directions."""

    def __init__(self, lines: Lines, metadata: ServerMessageMetadata | None) -> None:
        self._lines = lines
        self._metadata = metadata
        self._writing = anyio.Lock()

    async def read_all(self, to_server: MemoryObjectSendStream[SessionMessage | Exception]) -> None:
        """Pass each message to the server, and answer lines that are not messages."""
        async with to_server:
            async for line in self._lines.incoming:
                if not line.strip():
                    continue
                message = await aside(len(line), read_message, line, turn=READING)
                if not isinstance(message, list):
                    await to_server.send(SessionMessage(message, self._metadata))
                    continue
                for refusal in message:
                    _logger.info("refused %r: %s", refusal.id, refusal.message)
                    await self._write(json.dumps(refusal.answer))

    async def write_all(self, from_server: MemoryObjectReceiveStream[SessionMessage]) -> None:
        """Write what the server sends."""
        async with from_server:
            async for sent in from_server:
                if line := _as_line(sent.message):
                    await self._write(line)

    async def _write(self, line: str) -> None:
        async with self._writing:
            await self._lines.write(line)


def _as_line(message: JSONRPCMessage) -> str:
    """Return a message as JSON; if it cannot be written, an error instead, or "" if no answer is expected."""
    try:
        return message.model_dump_json(by_alias=True, exclude_unset=True)
    except (PydanticSerializationError, ValueError) as error:  # a fault of ours; its client must not wait for ever
        _logger.exception("a message cannot be written")
        if isinstance(message, (JSONRPCRequest, JSONRPCNotification)):
            return ""
        return json.dumps(Refusal(message.id, INTERNAL_ERROR, f"The answer cannot be written: {error}").answer)
