"""Identify operators, and open the socket for them: a Unix socket in the state folder, or a local port on Windows.

The kernel reports the user at the other end of a Unix socket, so no login is needed. Windows does not: there a file in
place of the socket has the port and a secret, and only the user of the server can read it.
"""

from __future__ import annotations

import asyncio
import getpass
import hmac
import os
import secrets
import socket
import stat
import struct
import sys
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

if sys.platform != "win32":
    import grp
    import pwd

GROUP = "ros2-operators"
"""If this group exists, its members and root are operators; otherwise the user of the server is."""
SHOWN_S = 1.0
"""The time limit for a client to send its secret, or, if it is no operator, its request, in s: such a client must not
keep operators out."""
STRANGER = -1
"""The user id of a connection that sent no secret, or a wrong secret."""
_ANSWERED_S = 30.0
"""The time limit for an answer, in s: a stop takes some seconds; everything else is answered at once."""
_LOOPBACK = "127.0.0.1"
_CREDENTIALS = struct.Struct("3i")
"""pid, uid and gid, as Linux returns them."""
_XUCRED = struct.Struct("=II")
"""The first two fields of macOS's `struct xucred`: version and user id."""
_LOCAL_PEERCRED, _XUCRED_BYTES = 1, 128
"""The macOS socket option (at the level `SOL_LOCAL`, which is 0) that returns it, and the size of the buffer."""


@dataclass(frozen=True, slots=True)
class OperatorSocket:
    """The listening socket for operators. `secret` is required from clients where the kernel does not identify them."""

    listener: socket.socket
    secret: str = ""

    async def user(self, reader: asyncio.StreamReader, connection: socket.socket) -> int:
        """Return the user id of the client. On sockets with a secret: 0 if the client sent it, otherwise `STRANGER`."""
        if not self.secret:
            return uid_of(connection)
        shown = b""
        with suppress(asyncio.TimeoutError):
            shown = await asyncio.wait_for(reader.readline(), SHOWN_S)
        return 0 if hmac.compare_digest(shown.strip(), self.secret.encode()) else STRANGER


def listen_at(path: Path, warn: Callable[[str], None], *, by_secret: bool = sys.platform == "win32") -> OperatorSocket:
    """Open a socket at this path, which must not exist yet. Raises `OSError`.

    Args:
        path: the path of the socket, or of the file in its place.
        warn: called with the reason if the operators' group cannot be given access.
        by_secret: whether to use a local port and a secret, as on Windows.
    """
    if by_secret:
        return _port(path)
    if sys.platform == "win32":
        raise OSError("Python does not support Unix sockets on Windows")
    listener = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
    hidden = path.with_name(f".{path.name}")
    try:
        before = os.umask(0o177)
        try:
            with _Short(hidden) as short:
                listener.bind(short)
        finally:
            os.umask(before)
        listener.listen()
        hidden.replace(path)  # renamed once it listens: another server removes a socket that does not
        if (group := _group()) is not None:
            os.chown(path, -1, group.gr_gid)
            os.chown(path.parent, -1, group.gr_gid)
            path.parent.chmod(0o750)  # lets the group find the socket; all other files are readable by their owner only
            path.chmod(0o660)
    except OSError as error:
        if error.filename is None or not path.exists():
            listener.close()
            raise
        warn(f"the group {GROUP} cannot operate: {error}")
    return OperatorSocket(listener)


def is_left_behind(path: Path) -> bool:
    """Return whether the server of this socket, or of the socket that this link leads to, has ended. Does not block."""
    try:
        if stat.S_ISREG(path.stat().st_mode):
            connected(path).close()
            return False
        if sys.platform == "win32":
            return False
        with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as probe, _Short(path) as short:
            probe.setblocking(False)  # a hung server has no room for connections, but still runs
            probe.connect(short)
    except (ConnectionRefusedError, FileNotFoundError):
        return True
    except (OSError, ValueError):
        return False
    return False


def connected(path: Path) -> socket.socket:
    """Connect to the server that listens at this path. Raises `OSError`."""
    if stat.S_ISREG(path.stat().st_mode):
        port, secret = path.read_text("ascii").split()
        connection = socket.create_connection((_LOOPBACK, int(port)), timeout=_ANSWERED_S)
        connection.sendall(secret.encode() + b"\n")
        return connection
    if sys.platform == "win32":
        raise OSError("Python does not support Unix sockets on Windows")
    connection = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
    try:
        connection.settimeout(_ANSWERED_S)
        with _Short(path) as short:
            connection.connect(short)
    except OSError:
        connection.close()
        raise
    return connection


def own_uid() -> int:
    """Return the user id of this process; 0 on Windows, which has no numeric ids."""
    return 0 if sys.platform == "win32" else os.geteuid()


def uid_of(connection: socket.socket) -> int:
    """Return the user id of the process at the other end of a Unix socket, as the kernel reports it."""
    if sys.platform == "linux":
        return _CREDENTIALS.unpack(connection.getsockopt(socket.SOL_SOCKET, socket.SO_PEERCRED, _CREDENTIALS.size))[1]
    return _XUCRED.unpack_from(connection.getsockopt(0, _LOCAL_PEERCRED, _XUCRED_BYTES))[1]


def may_operate(uid: int) -> bool:
    """Return whether this user is an operator."""
    if uid == 0:
        return True
    if sys.platform == "win32":
        return False
    group = _group()
    if group is None:
        return uid == os.geteuid()
    with suppress(KeyError, OverflowError):
        user = pwd.getpwuid(uid)
        return group.gr_gid in os.getgrouplist(user.pw_name, user.pw_gid)
    return False


def name_of(uid: int) -> str:
    """Return the name of a user, or the number if there is no name."""
    if sys.platform == "win32":
        return getpass.getuser() if uid == 0 else "somebody without the secret"
    with suppress(KeyError, OverflowError):
        return pwd.getpwuid(uid).pw_name
    return f"uid {uid}"


class _Short:
    """A path to a socket that fits into a socket address of 108 bytes: on Linux by way of the opened folder."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self._folder = -1

    def __enter__(self) -> str:
        if sys.platform != "linux":
            return str(self._path)
        self._folder = os.open(self._path.parent, os.O_PATH | os.O_DIRECTORY | os.O_CLOEXEC)
        return f"/proc/self/fd/{self._folder}/{self._path.name}"

    def __exit__(self, *_: object) -> None:
        if self._folder >= 0:
            os.close(self._folder)


def _port(path: Path) -> OperatorSocket:
    listener = socket.create_server((_LOOPBACK, 0))
    secret = secrets.token_hex(16)
    written = path.with_name(f".{path.name}")
    try:
        descriptor = os.open(written, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600)
        with os.fdopen(descriptor, "w", encoding="ascii") as file:
            file.write(f"{listener.getsockname()[1]} {secret}\n")
        written.replace(path)  # a complete file: a reader connects at once
    except OSError:
        listener.close()
        raise
    return OperatorSocket(listener, secret)


if sys.platform != "win32":

    def _group() -> grp.struct_group | None:
        with suppress(KeyError):
            return grp.getgrnam(GROUP)
        return None
