"""Who operates, and where: at a Unix socket in the state folder; on Windows at a port of this machine.

Who connects at a Unix socket is known by the kernel, not by what they say. Windows tells that of nobody: there a file
stands in the place of the socket, with the port and a secret, and who can read it is the user of the server.
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
"""Where this group exists, its members operate, and root; elsewhere the user of the server does."""
SHOWN_S = 1.0
"""How long somebody may take for their secret, or for their request where they are no operator: they must not keep
operators out."""
STRANGER = -1
"""In place of the number of a user: somebody who has shown no secret, or a wrong one."""
_ANSWERED_S = 30.0
"""For an answer: a stop takes some seconds; everything else is answered at once."""
_LOOPBACK = "127.0.0.1"
_CREDENTIALS = struct.Struct("3i")
"""pid, uid and gid, as Linux gives them."""
_XUCRED = struct.Struct("=II")
"""Of `struct xucred` of macOS: its version, and the user."""
_LOCAL_PEERCRED, _XUCRED_BYTES = 1, 128
"""The option of `SOL_LOCAL`, 0, that gives it, and room for it."""


@dataclass(frozen=True, slots=True)
class OperatorSocket:
    """Where operators reach a server. `secret` is what they show where the kernel does not tell who they are."""

    listener: socket.socket
    secret: str = ""

    async def user(self, reader: asyncio.StreamReader, connection: socket.socket) -> int:
        """The user who has connected, by number; with a secret 0, or `STRANGER`."""
        if not self.secret:
            return uid_of(connection)
        shown = b""
        with suppress(asyncio.TimeoutError):
            shown = await asyncio.wait_for(reader.readline(), SHOWN_S)
        return 0 if hmac.compare_digest(shown.strip(), self.secret.encode()) else STRANGER


def listen_at(path: Path, warn: Callable[[str], None], *, by_secret: bool = sys.platform == "win32") -> OperatorSocket:
    """A socket at that path, which is not there yet. Raises `OSError`.

    Args:
        path: of the socket, or of the file in its place.
        warn: is told why the group of operators cannot come in.
        by_secret: whether it is a port, as on Windows.
    """
    if by_secret:
        return _port(path)
    if sys.platform == "win32":
        raise OSError("Python knows no Unix sockets on Windows")
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
        hidden.replace(path)  # by its name it always listens: another server takes one that does not for left behind
        if (group := _group()) is not None:
            os.chown(path, -1, group.gr_gid)
            os.chown(path.parent, -1, group.gr_gid)
            path.parent.chmod(0o750)  # to find the socket; what else is there only its owner can read
            path.chmod(0o660)
    except OSError as error:
        if error.filename is None or not path.exists():
            listener.close()
            raise
        warn(f"the group {GROUP} cannot operate: {error}")
    return OperatorSocket(listener)


def is_left_behind(path: Path) -> bool:
    """Whether the server has ended that made this socket, or what this link leads to. It is not waited for."""
    try:
        if stat.S_ISREG(path.stat().st_mode):
            connected(path).close()
            return False
        if sys.platform == "win32":
            return False
        with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as probe, _Short(path) as short:
            probe.setblocking(False)  # one that hangs has no room for connections, and is not left behind
            probe.connect(short)
    except (ConnectionRefusedError, FileNotFoundError):
        return True
    except (OSError, ValueError):
        return False
    return False


def connected(path: Path) -> socket.socket:
    """A connection to the server that listens there. Raises `OSError`."""
    if stat.S_ISREG(path.stat().st_mode):
        port, secret = path.read_text("ascii").split()
        connection = socket.create_connection((_LOOPBACK, int(port)), timeout=_ANSWERED_S)
        connection.sendall(secret.encode() + b"\n")
        return connection
    if sys.platform == "win32":
        raise OSError("Python knows no Unix sockets on Windows")
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
    """The user of this process; 0 on Windows, which has no numbers for users."""
    return 0 if sys.platform == "win32" else os.geteuid()


def uid_of(connection: socket.socket) -> int:
    """The user at the other end of a Unix socket, as the kernel tells."""
    if sys.platform == "linux":
        return _CREDENTIALS.unpack(connection.getsockopt(socket.SOL_SOCKET, socket.SO_PEERCRED, _CREDENTIALS.size))[1]
    return _XUCRED.unpack_from(connection.getsockopt(0, _LOCAL_PEERCRED, _XUCRED_BYTES))[1]


def may_operate(uid: int) -> bool:
    """Whether this user is an operator."""
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
    """The name of a user, or the number of one without a name."""
    if sys.platform == "win32":
        return getpass.getuser() if uid == 0 else "somebody without the secret"
    with suppress(KeyError, OverflowError):
        return pwd.getpwuid(uid).pw_name
    return f"uid {uid}"


class _Short:
    """A path to a socket that fits into an address, which has 108 bytes: through its open folder, where Linux is."""

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
        written.replace(path)  # whole: who looks there connects at once
    except OSError:
        listener.close()
        raise
    return OperatorSocket(listener, secret)


if sys.platform != "win32":

    def _group() -> grp.struct_group | None:
        with suppress(KeyError):
            return grp.getgrnam(GROUP)
        return None
