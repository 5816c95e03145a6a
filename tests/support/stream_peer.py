"""The other end of the stream, in memory: takes apart what the client writes, says what a test wants it to say."""

import asyncio
import time
from collections.abc import Callable
from typing import Any

from ros2_mcp.link.connection import Connection
from ros2_mcp.link.framing import Frame, FrameReader, pack
from ros2_mcp.link.process import ErrorLines

HELLO = {
    "event": "hello",
    "protocol": 1,
    "python": "3.12.3",
    "distro": "jazzy",
    "rmw": "rmw_fastrtps_cpp",
    "domain_id": 0,
    "node": "/ros2_mcp_1",
    "pid": 1,
    "executor": "EventsExecutor",
}


class Peer:
    """Stands where a `Child` stands."""

    def __init__(self) -> None:
        self.pid = 0  # no such process: nothing can be learnt from /proc
        self.started_at = time.monotonic()
        self.stderr = ErrorLines(pass_on=False)
        self.exit_code: int | None = None
        self.heard: list[Frame] = []
        self._reader = FrameReader()
        self._on_bytes: Callable[[bytes], None] = lambda _: None
        self._on_end: Callable[[], None] = lambda: None

    async def attach(self, on_bytes: Callable[[bytes], None], on_end: Callable[[], None]) -> None:
        self._on_bytes, self._on_end = on_bytes, on_end

    def write(self, data: bytes) -> None:
        self.heard += [frame for frame in self._reader.feed(data) if frame.header["op"] != "ping"]

    async def writable(self) -> None:
        return

    async def wait(self, _timeout_s: float) -> int | None:
        return self.exit_code

    def die(self, code: int) -> None:
        self.exit_code = code
        self._on_end()

    def say(self, header: dict[str, Any], body: bytes = b"") -> None:
        self._on_bytes(pack(header, body))

    def say_at_once(self, *frames: tuple[dict[str, Any], bytes]) -> None:
        self._on_bytes(b"".join(pack(header, body) for header, body in frames))

    def say_raw(self, data: bytes) -> None:
        self._on_bytes(data)

    async def next(self, op: str) -> dict[str, Any]:
        """The first request of that kind, as soon as it is there."""
        deadline = time.monotonic() + 20
        while time.monotonic() < deadline:
            for frame in self.heard:
                if frame.header["op"] == op:
                    self.heard.remove(frame)
                    return frame.header
            await asyncio.sleep(0.001)
        raise AssertionError(f"no {op} came")


async def connected(pid: int = 0) -> tuple[Connection, Peer]:
    """A connection whose peer has said hello."""
    peer = Peer()
    peer.pid = pid
    connection = Connection(peer)  # type: ignore[arg-type]
    greeting = asyncio.ensure_future(connection.greet())
    await asyncio.sleep(0)
    peer.say(HELLO)
    assert await greeting is None
    return connection, peer
