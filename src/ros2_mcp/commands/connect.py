"""The client's end of a server at a Unix socket: forwards stdin to the server, and the server's messages to stdout."""

from __future__ import annotations

import os
import socket
import sys
import threading
from pathlib import Path

from ros2_mcp.model.errors import LinkError

_READ_BYTES = 1 << 16
"""The usual capacity of a pipe."""


def connect(path: Path) -> int:
    """Connect stdin and stdout with the server at that socket until either side ends. Return 1 if the server ended
    first.

    Raises:
        LinkError: if no server listens there, or this user may not connect.
    """
    if sys.platform == "win32":
        raise LinkError(
            "Python does not support Unix sockets on Windows.",
            "Start one that serves over HTTP: ros2-mcp --transport streamable-http.",
        )
    connection = socket.socket(socket.AF_UNIX)
    try:
        connection.connect(str(path.expanduser()))
    except OSError as error:
        raise LinkError(
            f"No server can be reached at {path}: {error.strerror or error}.",
            "Its socket admits only its own user and the members of its group: connect as one of these users."
            if isinstance(error, PermissionError)
            else f"Start a server there: ros2-mcp --socket {path}",
        ) from error
    client_has_ended = threading.Event()
    threading.Thread(target=_carry_out, args=(connection, client_has_ended), daemon=True).start()
    while data := _received(connection):
        _write(data)
    if not client_has_ended.is_set():
        print(f"ros2-mcp: the server at {path} has ended the connection.", file=sys.stderr, flush=True)  # noqa: T201
        os._exit(1)  # a read from stdin cannot be interrupted
    return 0


def _carry_out(connection: socket.socket, client_has_ended: threading.Event) -> None:
    try:
        while data := os.read(0, _READ_BYTES):
            connection.sendall(data)
        client_has_ended.set()
        connection.shutdown(socket.SHUT_WR)  # the client has ended; answers to it may still come
    except OSError:
        return  # the server has gone, which the other direction notices


def _received(connection: socket.socket) -> bytes:
    try:
        return connection.recv(_READ_BYTES)
    except ConnectionError:
        return b""


def _write(data: bytes) -> None:
    while data:
        data = data[os.write(1, data) :]
