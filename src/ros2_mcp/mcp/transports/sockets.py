"""MCP at a Unix socket: each connection is one client, with the protocol of stdio. `ros2-mcp connect` is the client's
end.

The permissions of the socket decide who may connect, so no token is needed. The end of a connection is the end of its
client: motion that the client commanded is stopped, as over HTTP.
"""

from __future__ import annotations

import asyncio
import json
import logging
import os
import socket
import stat
import sys
from collections.abc import AsyncIterator, Callable, Generator
from contextlib import contextmanager, suppress
from itertools import count
from pathlib import Path
from time import monotonic
from typing import TYPE_CHECKING, Any

import anyio
from mcp.types import INVALID_REQUEST

from ros2_mcp.guard.operators import uid_of
from ros2_mcp.mcp.leases import Leases
from ros2_mcp.mcp.transports.http.sessions import MOST_SESSIONS
from ros2_mcp.mcp.transports.jsonrpc import Refusal
from ros2_mcp.mcp.transports.stdio import Lines, serve_lines
from ros2_mcp.model.commands import Principal
from ros2_mcp.model.errors import BadInput

if TYPE_CHECKING:
    from mcp.server.lowlevel import Server

if sys.platform != "win32":
    import fcntl

_MODE = 0o660
"""For the user and the group of the socket: the agent's user has to be in that group."""
_MOST_LINE_BYTES = 8_000_000
"""The longest message: a picture as an argument, several times over. It is held in memory until it is complete."""
_LISTENED_S = 2.0
"""How long another server at that socket may take to accept a connection: it does so within milliseconds, or hangs."""
NO_SOCKETS = BadInput(
    "Python does not support Unix sockets on Windows.",
    "Serve over HTTP: --transport streamable-http.",
)
_logger = logging.getLogger(__name__)


async def serve_socket(server: Server[Any], leases: Leases, path: Path, announce: Callable[[], None]) -> None:
    """Serve every client that connects to the socket, until cancelled.

    Raises:
        BadInput: if the socket cannot be made there, or another server listens there.
    """
    if sys.platform == "win32":
        raise NO_SOCKETS
    numbers, peers = count(1), set[SocketPeer]()

    async def serve(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        peer = SocketPeer(writer.get_extra_info("socket"), next(numbers))
        lines = _lines(reader, writer, at_end=lambda: peer.leave(leases))
        try:
            if sum(other.principal.login == peer.principal.login for other in peers) >= MOST_SESSIONS:
                await lines.write(json.dumps(Refusal(None, INVALID_REQUEST, "Too many clients are connected").answer))
                return
            peers.add(peer)
            await serve_lines(server, lines, peer)
        finally:
            peers.discard(peer)
            writer.close()

    listener = await asyncio.start_unix_server(serve, sock=_bound(path), limit=_MOST_LINE_BYTES)
    announce()
    async with listener, anyio.create_task_group() as tasks:
        tasks.start_soon(leases.keep)
        await listener.serve_forever()


class SocketPeer:
    """The client at one connection. To the leases it is a response that is open as long as the connection is."""

    listens = True
    was_closed = False

    def __init__(self, connection: socket.socket, number: int) -> None:
        who = f"uid{uid_of(connection)}"
        self.principal = Principal(name=f"{who}_{number}", transport="socket", login=who)
        self.is_open = True

    def heard_at(self) -> float:
        """Return the current time while the connection is open: the kernel closes it when the client process ends."""
        return monotonic() if self.is_open else 0.0

    async def show_alive(self) -> None:
        """Do nothing: a local socket has no network that could fail."""

    def leave(self, leases: Leases) -> None:
        """Record the end of the connection."""
        self.is_open, self.was_closed = False, True
        leases.closed(self)


def _lines(reader: asyncio.StreamReader, writer: asyncio.StreamWriter, at_end: Callable[[], None]) -> Lines:
    async def incoming() -> AsyncIterator[bytes]:
        while line := await _line(reader):
            yield line
        at_end()  # at once: running calls end with it

    async def write(line: str) -> None:
        with suppress(ConnectionError):  # the reader notices that the client has gone
            writer.write(line.encode() + b"\n")
            await writer.drain()

    return Lines(incoming(), write)


async def _line(reader: asyncio.StreamReader) -> bytes:
    """Return the next line; an empty line at the end, or after a line that is too long."""
    try:
        return await reader.readline()
    except ConnectionError:
        return b""
    except ValueError:
        _logger.warning("a client was disconnected: it sent more than %d bytes in one line", _MOST_LINE_BYTES)
        return b""


def _bound(path: Path) -> socket.socket:
    """Return a socket that listens at the path. From the beginning, only its user and group can connect."""
    try:
        with _alone_in(path.parent):  # another server would take a socket that does not listen yet for a dead one
            _clear(path)
            return _listening(path)
    except OSError as error:
        raise BadInput(f"No socket can be made at {path}: {error.strerror or error}.") from error


def _listening(path: Path) -> socket.socket:
    assert sys.platform != "win32"
    listener = socket.socket(socket.AF_UNIX)
    before = os.umask(0o777 & ~_MODE)
    try:
        listener.bind(str(path))
        listener.listen()
    except OSError:
        listener.close()
        raise
    finally:
        os.umask(before)
    return listener


@contextmanager
def _alone_in(folder: Path) -> Generator[None]:
    """Keep other servers from making a socket in that folder while the block runs."""
    assert sys.platform != "win32"
    descriptor = os.open(folder, os.O_RDONLY | os.O_DIRECTORY)
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX)
        yield
    finally:
        os.close(descriptor)


def _clear(path: Path) -> None:
    """Remove the socket of a server that has ended. Raises `BadInput` if a server listens there, or if it is not a
    socket.
    """
    if not os.path.lexists(path):
        return
    if not stat.S_ISSOCK(path.lstat().st_mode):
        raise BadInput(f"{path} exists and is not a socket.", "Choose another path, or delete it.")
    assert sys.platform != "win32"
    with socket.socket(socket.AF_UNIX) as probe:
        probe.settimeout(_LISTENED_S)
        try:
            probe.connect(str(path))
        except ConnectionRefusedError:
            path.unlink()
            return
    raise BadInput(f"Another server listens at {path}.", "End it first, or choose another path.")
