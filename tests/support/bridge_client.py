"""A minimal client of the stream for the tests of the bridge: raw packets to and from a real bridge process."""

from __future__ import annotations

import os
import select
import struct
import subprocess
import time
from collections import deque
from collections.abc import Callable
from typing import Any

from ros2_mcp_common.wire.packets import Packet, PacketReader, pack

RELIABLE = {"reliability": "reliable", "durability": "volatile", "history": "keep_last", "depth": 10}
BEST_EFFORT = {**RELIABLE, "reliability": "best_effort"}
STRING = "std_msgs/msg/String"
PATIENCE_S = 30.0
"""How long something may take that takes no time, or 4 s of discovery, where the machine is not held up."""


def cdr_string(text: str) -> bytes:
    """A std_msgs/msg/String in CDR."""
    data = text.encode() + b"\0"
    return b"\0\1\0\0" + struct.pack("<I", len(data)) + data


def line(process: subprocess.Popen[bytes]) -> str:
    """The next line that a peer prints."""
    assert process.stdout
    return process.stdout.readline().decode().strip()


def says(process: subprocess.Popen[bytes]) -> bool:
    """Whether a peer has printed something."""
    return bool(select.select([process.stdout], [], [], 0)[0])


class Client:
    """Sends requests and sorts what comes back; single-threaded."""

    def __init__(
        self, process: subprocess.Popen[bytes], stream_of: Callable[[bytes], bytes] = lambda piece: piece
    ) -> None:
        """`stream_of` gives what of a piece belongs to the stream, where something else comes before it."""
        self.process = process
        self._stream_of = stream_of
        self.samples: list[tuple[dict[str, Any], bytes]] = []
        self._answers: dict[int, tuple[dict[str, Any], bytes]] = {}
        self._last_id = 0
        self._reader = PacketReader()
        self._arrived: deque[Packet] = deque()
        self.hello = self.next_packet()[0]

    def next_packet(self) -> Packet:
        """The next packet; EOFError at the end of the stream."""
        assert self.process.stdout
        while not self._arrived:
            piece = os.read(self.process.stdout.fileno(), 1024 * 1024)
            if not piece:
                raise EOFError
            self._arrived += self._reader.feed(self._stream_of(piece))
        return self._arrived.popleft()

    def send(self, op: str, body: bytes = b"", **arguments: Any) -> int:
        """Send a request; returns its id."""
        assert self.process.stdin
        self._last_id += 1
        self.process.stdin.write(pack({"id": self._last_id, "op": op, **arguments}, body))
        self.process.stdin.flush()
        return self._last_id

    def answer(self, request_id: int) -> tuple[dict[str, Any], bytes]:
        """Wait for the answer to a request: the whole header, and the body."""
        while request_id not in self._answers:
            header, body = self.next_packet()
            if "id" in header:
                self._answers[header["id"]] = header, body
            else:
                self.samples.append((header, body))
        return self._answers.pop(request_id)

    def ok(self, op: str, body: bytes = b"", **arguments: Any) -> dict[str, Any]:
        """Send a request that must succeed; returns the `ok` part."""
        header, _ = self.answer(self.send(op, body, **arguments))
        assert "ok" in header, header
        return header["ok"]

    def error(self, op: str, body: bytes = b"", **arguments: Any) -> dict[str, Any]:
        """Send a request that must fail; returns the `error` part."""
        header, _ = self.answer(self.send(op, body, **arguments))
        assert "error" in header, header
        return header["error"]

    def close(self) -> float:
        """End the stream; returns how long the bridge took to leave, in seconds."""
        assert self.process.stdin
        started = time.monotonic()
        self.process.stdin.close()
        self.process.wait(PATIENCE_S)
        return time.monotonic() - started
