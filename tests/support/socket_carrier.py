"""A second carrier, and the least there can be: the stream on a bare socket, with nothing to look at behind it."""

from __future__ import annotations

import asyncio
import socket
import subprocess
from collections.abc import Callable, Sequence

from ros2_mcp.link.carrier import Vitality
from ros2_mcp.link.installation import RosInstallation
from ros2_mcp.model.errors import LinkError


class FarBridge:
    """A bridge process whose stdin and stdout are one socket. Only a test knows the process.

    `through` is a command that runs the bridge's command and carries its stdin and stdout.
    """

    def __init__(self, installation: RosInstallation, through: Sequence[str] = ()) -> None:
        self.near, far = socket.socketpair()
        command = installation.command("ros2_mcp_bridge")
        with far:
            self.process = subprocess.Popen(
                [*through, *command.argv],
                env=command.env,
                stdin=far.fileno(),
                stdout=far.fileno(),
                stderr=subprocess.DEVNULL,
                start_new_session=True,
            )


class SocketCarrier(asyncio.Protocol):
    """Carries the stream over a connected socket."""

    origin = "behind a socket"
    is_remote = True
    start_s = 20.0
    lease_s = 2.0

    def __init__(self, connected: socket.socket) -> None:
        self._socket = connected
        self._transport: asyncio.Transport | None = None
        self._received: Callable[[bytes], None] = lambda _: None
        self._ended: Callable[[], None] = lambda: None
        self._free = asyncio.Event()
        self._free.set()
        self._gone = asyncio.Event()
        self.received_bytes = self.written_bytes = 0

    # ── a carrier ──────────────────────────────────────────────────────────────────────────────────────────────

    async def open(self, received: Callable[[bytes], None], ended: Callable[[], None]) -> None:
        self._received, self._ended = received, ended
        loop = asyncio.get_running_loop()
        self._transport, _ = await loop.create_connection(lambda: self, sock=self._socket)

    def write(self, data: bytes) -> None:
        if self._transport and not self._transport.is_closing():
            self.written_bytes += len(data)
            self._transport.write(data)

    async def writable(self) -> None:
        await self._free.wait()

    def alive(self) -> Vitality:
        return "unknown"

    async def ending(self) -> str:
        return "closed its stream"

    async def failure(self) -> LinkError | None:
        return None

    def log_tail(self) -> list[str]:
        return []

    def kill(self) -> None:
        if self._transport:
            self._transport.abort()

    async def close(self, grace_s: float) -> None:
        if not self._transport:
            self._socket.close()
            return
        if self._transport.is_closing():
            return
        self._transport.write_eof()
        try:
            await asyncio.wait_for(self._gone.wait(), grace_s)
        except asyncio.TimeoutError:
            self._transport.abort()

    def describe(self) -> str:
        return "behind a socket"

    # ── what asyncio says of the socket ────────────────────────────────────────────────────────────────────────

    def data_received(self, data: bytes) -> None:
        self.received_bytes += len(data)
        self._received(data)

    def pause_writing(self) -> None:
        self._free.clear()

    def resume_writing(self) -> None:
        self._free.set()

    def connection_lost(self, exc: Exception | None) -> None:
        del exc
        self._free.set()
        self._gone.set()
        self._ended()
