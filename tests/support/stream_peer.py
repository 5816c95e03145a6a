"""The other end of the stream, in memory: takes apart what the client writes, says what a test wants it to say."""

import asyncio
import time
from collections.abc import Callable
from typing import Any

from ros2_mcp.link.carrier import Vitality
from ros2_mcp.link.connection import Connection
from ros2_mcp.model.errors import LinkError
from ros2_mcp_common.wire.packets import Packet, PacketReader, pack

HELLO = {
    "event": "hello",
    "protocol": 5,
    "python": "3.12.3",
    "distro": "jazzy",
    "rmw": "rmw_fastrtps_cpp",
    "domain_id": 0,
    "node": "/ros2_mcp_1",
    "pid": 1,
    "executor": "EventsExecutor",
}


class Peer:
    """A carrier to nowhere."""

    origin = ""
    start_s = 20.0
    lease_s = 1.0

    def __init__(self, vitality: Vitality = "unknown", *, is_remote: bool = False) -> None:
        self.is_remote = is_remote
        self.is_open = False
        self.log: list[str] = []
        self.heard: list[Packet] = []
        self.pings: list[dict[str, Any]] = []
        self._vitality: Vitality = vitality
        self._how = "closed its stream"
        self._reader = PacketReader()
        self._received: Callable[[bytes], None] = lambda _: None
        self._ended: Callable[[], None] = lambda: None

    # ── a carrier ──────────────────────────────────────────────────────────────────────────────────────────────

    async def open(self, received: Callable[[bytes], None], ended: Callable[[], None]) -> None:
        self._received, self._ended = received, ended
        self.is_open = True

    def write(self, data: bytes) -> None:
        for packet in self._reader.feed(data):
            if packet.header["op"] == "ping":
                self.pings.append(packet.header)
            else:
                self.heard.append(packet)

    async def writable(self) -> None:
        return

    def alive(self) -> Vitality:
        return self._vitality

    async def ending(self) -> str:
        return self._how

    async def failure(self) -> LinkError | None:
        return None

    def log_tail(self) -> list[str]:
        return self.log

    def kill(self) -> None:
        return

    async def close(self, grace_s: float) -> None:
        del grace_s

    def describe(self) -> str:
        return "in memory"

    # ── what a test does ───────────────────────────────────────────────────────────────────────────────────────

    def end(self, how: str = "exited with code 0") -> None:
        self._how = how
        self._ended()

    def say(self, header: dict[str, Any], body: bytes = b"") -> None:
        self._received(pack(header, body))

    def say_at_once(self, *packets: tuple[dict[str, Any], bytes]) -> None:
        self._received(b"".join(pack(header, body) for header, body in packets))

    def say_raw(self, data: bytes) -> None:
        self._received(data)

    async def next(self, op: str) -> dict[str, Any]:
        """The first request of that kind, as soon as it is there."""
        deadline = time.monotonic() + 20
        while time.monotonic() < deadline:
            for packet in self.heard:
                if packet.header["op"] == op:
                    self.heard.remove(packet)
                    return packet.header
            await asyncio.sleep(0.001)
        raise AssertionError(f"no {op} came")


async def connected(vitality: Vitality = "unknown", *, is_remote: bool = False, **told: Any) -> tuple[Connection, Peer]:
    """A connection whose peer has said hello; one elsewhere has answered a ping, too."""
    peer = Peer(vitality, is_remote=is_remote)
    connection = Connection(peer, **told)
    greeting = asyncio.ensure_future(connection.greet())
    await asyncio.sleep(0)
    peer.say(HELLO)
    if is_remote:
        now_ns = peer.pings[-1]["sent_ns"]
        peer.say({"id": 0, "ok": {"ros_idle_s": 0.0, "now_ns": now_ns, "sent_ns": now_ns, "steady_s": 1.0}})
    assert await greeting is None
    return connection, peer
