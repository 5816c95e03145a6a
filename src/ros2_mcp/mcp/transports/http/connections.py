"""The connections of HTTP clients: their number, the time limit for a request to arrive, and which clients are alive.

On Linux the kernel reports when the peer of a connection last acknowledged or sent anything (TCP_INFO). Elsewhere an
open connection counts as a live client.
"""

from __future__ import annotations

import asyncio
import logging
import socket
import struct
import sys
from collections import Counter
from contextlib import suppress
from time import monotonic
from typing import TYPE_CHECKING, Any

import anyio
from uvicorn.protocols.http.auto import AutoHTTPProtocol

from ros2_mcp.mcp.scopes import login_name
from ros2_mcp.model.errors import BadInput

if TYPE_CHECKING:
    from collections.abc import Callable

    from starlette.types import Scope

MOST_CONNECTIONS = 256
"""A quarter of the files that a process may usually open; 16 clients need about 64 connections."""
RECEIVE_S = 15.0
"""The time for TLS and one request, to its last byte: enough for 1 MB at 70 kB/s, and far more than the headers need.
"""
_LOOK_S = 1.0
_CONNECTION = "ros2_mcp.connection"
"""The key of a connection in the state of a request."""
_TCP_INFO_BYTES = 60
_SINCE_HEARD = struct.Struct("=52xII")
"""In `struct tcp_info` of linux/tcp.h: `tcpi_last_data_recv` and `tcpi_last_ack_recv`, both an age in ms."""
_logger = logging.getLogger(__name__)


class Connections:
    """The connections of all clients.

    If there are too many, the oldest connection without an accepted request is closed; if there is none, one of the
    login that has the most. So a client that holds connections open does not keep out the others, with or without a
    login.
    """

    def __init__(self) -> None:
        self._open: dict[Any, None] = {}  # in order of arrival
        self._arriving: dict[int, tuple[socket.socket, float]] = {}  # by file descriptor, with its arrival time

    async def listen(self, host: str, port: int) -> list[socket.socket]:
        """Return sockets that listen at the addresses of a host, and that record each connection.

        Raises:
            BadInput: if this host and port cannot be used.
        """
        try:
            bound = await asyncio.get_running_loop().create_server(asyncio.Protocol, host, port, start_serving=False)
        except OSError as error:
            # asyncio prefixes the reason with its own text, and in some versions of Python with the error number.
            why = str(error.strerror).rpartition(": ")[2].rpartition("] ")[2]
            raise BadInput(
                f"This server cannot listen at {host}, port {port}: {why}.",
                "--host and --port say where it listens.",
            ) from error
        listeners: list[socket.socket] = [_Listener(each.dup().detach(), self._arrive) for each in bound.sockets]
        bound.close()
        return listeners

    def protocol(self) -> type[asyncio.Protocol]:
        """Return uvicorn's HTTP protocol class, extended to record each open connection here."""
        connections = self

        class NotedProtocol(AutoHTTPProtocol):
            transport: Any
            cycle: Any
            app_state: dict[str, Any]
            is_trusted = False
            login = ""
            receiving_since: float | None = None

            def connection_made(self, transport: asyncio.BaseTransport) -> None:
                self.receiving_since = monotonic()
                self.app_state = {**self.app_state, _CONNECTION: self}  # uvicorn copies it into each request's scope
                super().connection_made(transport)
                connections._arriving.pop(transport.get_extra_info("socket").fileno(), None)
                connections._admit(self)

            def data_received(self, data: bytes) -> None:
                super().data_received(data)
                self.note_received()

            def note_received(self) -> None:
                cycle = self.cycle
                if cycle is not None and not cycle.more_body and not cycle.response_complete:
                    self.receiving_since = None  # all of the request has arrived
                elif self.receiving_since is None:
                    self.receiving_since = monotonic()

            def is_at_rest(self) -> bool:
                return self.cycle is None or self.cycle.response_complete

            def connection_lost(self, exc: Exception | None) -> None:
                connections._open.pop(self, None)
                super().connection_lost(exc)

        return NotedProtocol

    async def keep(self) -> None:
        """Close connections whose request takes too long to arrive, until cancelled."""
        while True:
            await anyio.sleep(_LOOK_S)
            late = monotonic() - RECEIVE_S
            for each in list(self._open):
                each.note_received()  # the beginning of a second request may have arrived with the first
                if each.receiving_since and each.receiving_since < late:
                    self._end(each, "its request took too long to come")
            for descriptor in [each for each, (_, since) in self._arriving.items() if since < late]:
                self._turn_away(descriptor)

    def trust(self, scope: Scope) -> None:
        """Record that a request was accepted, so that its connection belongs to a client."""
        if connection := _of(scope):
            connection.is_trusted = True
            connection.login = login_name(scope)

    def heard_at(self, scope: Scope) -> float:
        """Return when the client of a request last acknowledged or sent anything (monotonic clock, s): the current time
        except on Linux; 0 if the connection is closed.
        """
        if sys.platform != "linux":
            return monotonic()
        connection = _of(scope)
        if connection not in self._open:
            return 0.0  # it is closed
        try:
            info = connection.transport.get_extra_info("socket").getsockopt(
                socket.IPPROTO_TCP, socket.TCP_INFO, _TCP_INFO_BYTES
            )
        except OSError:
            return 0.0
        return monotonic() - min(_SINCE_HEARD.unpack(info)) / 1000

    def _admit(self, connection: Any) -> None:
        self._open[connection] = None
        if len(self._open) > MOST_CONNECTIONS:
            strangers = (each for each in self._open if not each.is_trusted and each is not connection)
            self._end(next(strangers, None) or self._of_the_most(connection), "there are too many connections")

    def _of_the_most(self, newest: Any) -> Any:
        """Return the oldest connection of the login that has the most, preferably a connection without a running
        request.
        """
        number = Counter(each.login for each in self._open if each is not newest)
        most = max(number, key=lambda login: number[login])
        own = [each for each in self._open if each.login == most and each is not newest]
        return next((each for each in own if each.is_at_rest()), own[0])

    def _arrive(self, connection: socket.socket) -> None:
        """Record a connection before its TLS handshake; if there are too many, close the oldest."""
        self._arriving.pop(connection.fileno(), None)  # the earlier connection with this descriptor was closed
        self._arriving[connection.fileno()] = connection, monotonic()
        if len(self._arriving) > MOST_CONNECTIONS:
            self._turn_away(next(iter(self._arriving)))

    def _turn_away(self, descriptor: int) -> None:
        connection, _ = self._arriving.pop(descriptor)
        with suppress(OSError):  # it is closed already
            connection.shutdown(socket.SHUT_RDWR)

    def _end(self, connection: Any, reason: str) -> None:
        _logger.info("a connection was ended: %s", reason)
        self._open.pop(connection, None)
        connection.transport.abort()


class _Listener(socket.socket):
    """A listening socket that records each connection at once: asyncio shows one only after the TLS handshake."""

    def __init__(self, descriptor: int, arrive: Callable[[socket.socket], None]) -> None:
        super().__init__(fileno=descriptor)
        self._arrive = arrive

    def accept(self) -> tuple[socket.socket, Any]:
        """Accept and record the next connection."""
        connection, address = super().accept()
        self._arrive(connection)
        return connection, address


def _of(scope: Scope) -> Any:
    return scope.get("state", {}).get(_CONNECTION)
