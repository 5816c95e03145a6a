"""Hostile requests over HTTP: none is carried out, the server stays as it is, and an honest client is served meanwhile.

All of them ask for the same publication; an observer in another process subscribes to it.
"""

from __future__ import annotations

import json
import random
import re
import socket
import statistics
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from http.client import HTTPConnection
from pathlib import Path
from typing import Any

import pytest

from support.agent import until
from support.observer import TWIST, Observer
from support.ports import listening
from support.tokens import TOKEN

ROUNDS = 500
MODERN, HANDSHAKE = "2026-07-28", "2025-11-25"
TOPIC = "/hostile/cmd_vel"
MOVE = {"topic_name": TOPIC, "message_type": TWIST, "data": {"linear": {"x": 1.0}}}
PREFIX = "io.modelcontextprotocol/"
CLIENT = {"name": "hostile", "version": "1"}
META = {f"{PREFIX}protocolVersion": MODERN, f"{PREFIX}clientInfo": CLIENT, f"{PREFIX}clientCapabilities": {}}
BODY = json.dumps(
    {
        "jsonrpc": "2.0",
        "id": 1,
        "method": "tools/call",
        "params": {"name": "ros2_topic_publish", "arguments": MOVE, "_meta": META},
    }
)
GOOD = f"Authorization: Bearer {TOKEN}"
GROWTH_BYTES = 20_000_000
ANSWERED_S = 0.1
"""What is promised of 99 of 100 calls of an honest client on a quiet machine."""
PATIENCE_S = 60.0
"""The first call of all waits for the bridge, too."""

Attack = Callable[[int], list[bytes]]
"""The pieces in which one request is sent to a port; none of these may be carried out."""


def request(
    port: int, *more: str, target: str = "/mcp", host: str = "", body: str = BODY, length: int = -1
) -> list[bytes]:
    """A call of the modern era, but for what is hostile in it."""
    lines = [
        f"POST {target} HTTP/1.1",
        *([] if host == "none" else [f"Host: {host or f'127.0.0.1:{port}'}"]),
        "Accept: application/json, text/event-stream",
        "Content-Type: application/json",
        f"Mcp-Protocol-Version: {MODERN}",
        "Mcp-Method: tools/call",
        "Mcp-Name: ros2_topic_publish",
        *([f"Content-Length: {len(body) if length < 0 else length}"] if length else []),
        *more,
    ]
    return [("\r\n".join(lines) + "\r\n\r\n").encode("latin-1"), body.encode()]


def split(pieces: list[bytes]) -> list[bytes]:
    whole = b"".join(pieces)
    return [whole[start : start + 7] for start in range(0, len(whole), 7)]


CHUNK = f"10000\r\n{' ' * 0x10000}\r\n"
ATTACKS: dict[str, Attack] = {
    "no token": request,
    "wrong token": lambda port: request(port, f"Authorization: Bearer {TOKEN[:-1]}x"),
    "token of another kind": lambda port: request(port, f"Authorization: Basic {TOKEN}"),
    "token cut by a zero": lambda port: request(port, f"Authorization: Bearer {TOKEN}\0"),
    "token in the address": lambda port: request(port, target=f"/mcp?access_token={TOKEN}"),
    "token in both": lambda port: request(port, GOOD, target=f"/mcp?token={TOKEN}"),
    "token twice": lambda port: request(port, GOOD, "Authorization: Bearer x"),
    "token in a cookie": lambda port: request(port, f"Cookie: Authorization=Bearer {TOKEN}"),
    "token in the body": lambda port: request(port, body=BODY[:-1] + f', "Authorization": "Bearer {TOKEN}"}}'),
    "token on a continued line": lambda port: request(port, f"X: y\r\n Authorization: Bearer {TOKEN}"),
    "no session's id": lambda port: request(port, "Mcp-Session-Id: 0123456789abcdef0123456789abcdef"),
    "origin null": lambda port: request(port, GOOD, "Origin: null"),
    "foreign origin": lambda port: request(port, GOOD, "Origin: https://robot.example"),
    "origin twice": lambda port: request(port, GOOD, f"Origin: http://127.0.0.1:{port}", "Origin: null"),
    "rebound name": lambda port: request(port, GOOD, host=f"robot.example:{port}"),
    "rebound name of ours": lambda port: request(port, GOOD, host=f"localhost.robot.example:{port}"),
    "no host": lambda port: request(port, GOOD, host="none"),
    "host twice": lambda port: request(port, GOOD, "Host: robot.example"),
    "absolute target": lambda port: request(port, GOOD, target="http://robot.example/mcp", host="robot.example"),
    "lengths that differ": lambda port: request(port, GOOD, "Content-Length: 3"),
    "length and chunks": lambda port: request(port, GOOD, "Transfer-Encoding: chunked", body=f"0\r\n\r\n{BODY}"),
    "huge, declared": lambda port: request(port, GOOD, length=10**12),
    "huge, in chunks": lambda port: request(port, GOOD, "Transfer-Encoding: chunked", length=0, body=CHUNK * 40),
    "huge, without a token": lambda port: request(port, "Transfer-Encoding: chunked", length=0, body=CHUNK * 40),
    "huge head": lambda port: request(port, GOOD, *(f"X-{number}: {'x' * 1000}" for number in range(300))),
    "split, without a token": lambda port: split(request(port)),
    "split, foreign origin": lambda port: split(request(port, GOOD, "Origin: null")),
    "less than declared": lambda port: request(port, GOOD, length=len(BODY) + 50),
    "a simple request of a page": lambda port: [
        piece.replace(b"application/json\r\nMcp", b"text/plain\r\nMcp")
        for piece in request(port, "Origin: https://x.example")
    ],
    "no HTTP": lambda _: [b"\x16\x03\x01\x02\x00\x01\x00\x01\xfc\x03\x03", BODY.encode()],
    "another version": lambda port: [piece.replace(b"HTTP/1.1", b"HTTP/9.9") for piece in request(port)],
    "an upgrade": lambda port: request(port, "Connection: Upgrade", "Upgrade: websocket", target="/mcp"),
    "nested": lambda port: request(port, GOOD, body="[" * 100_000),
    "a path of the SSE transport": lambda port: request(port, target="/messages/?session_id=" + "0" * 32),
}


@pytest.fixture(scope="module")
def observer(observer: Observer) -> Observer:
    observer.join(by="recorder", topic=TOPIC, kind=TWIST, best_effort=False)
    return observer


def memory_bytes(pid: int) -> int:
    """What a process and its children hold."""
    found = re.search(r"VmRSS:\s+(\d+)", Path(f"/proc/{pid}/status").read_text())
    assert found
    return int(found[1]) * 1000


def attack(port: int, pieces: list[bytes], meanwhile: Callable[[], Any] = lambda: None) -> None:
    """Sends one request, and reads what is answered to it for a while; something may be done between."""
    with socket.create_connection(("127.0.0.1", port), PATIENCE_S) as connection:
        try:
            for piece in pieces:
                connection.sendall(piece)
        except OSError:
            pass  # refused before all of it was sent
        meanwhile()
        try:
            connection.settimeout(0.05)
            connection.recv(65536)
        except OSError:
            pass  # nothing was answered


class Honest:
    """A client that has a token, and calls all the time: how long each call took, in s."""

    def __init__(self, port: int) -> None:
        self.connection = HTTPConnection("127.0.0.1", port, timeout=PATIENCE_S)
        self.taken: list[float] = []
        self.ends = threading.Event()
        self.thread = threading.Thread(target=self._run)

    def call(self, tool: str, arguments: dict[str, Any] | None = None) -> str:
        """What the server answers to a call."""
        params = {"name": tool, "arguments": arguments or {}, "_meta": META}
        body = json.dumps({"jsonrpc": "2.0", "id": 1, "method": "tools/call", "params": params})
        headers = {"Accept": "application/json, text/event-stream", "Content-Type": "application/json"}
        headers |= {"Authorization": f"Bearer {TOKEN}", "Mcp-Protocol-Version": MODERN, "Mcp-Method": "tools/call"}
        self.connection.request("POST", "/mcp", body, {**headers, "Mcp-Name": tool})
        answer = self.connection.getresponse()
        assert answer.status == 200, answer.read()
        return answer.read().decode()

    def _run(self) -> None:
        while not self.ends.is_set():
            began = time.monotonic()
            self.call("ros2_relay_list")
            self.taken.append(time.monotonic() - began)
            time.sleep(0.005)


def moves(honest: Honest) -> bool:
    """Whether the publication is carried out for a client that may: it could be carried out for others."""
    return '"isError":false' in honest.call("ros2_topic_publish", MOVE)


@dataclass
class Attacked:
    """A server, its honest client, and connections that never say a whole word."""

    port: int
    honest: Honest
    drips: list[socket.socket]

    def drip(self, number: int) -> None:
        with suppress(OSError):  # after 15 s they are closed
            self.drips[number % len(self.drips)].sendall(b"X" if number % 3 else b"\r")


@contextmanager
def attacked(environment: dict[str, str], observer: Observer) -> Iterator[Attacked]:
    """A server that has been attacked in every way, so that what is imported for them is no growth. What the block does
    to it is not carried out, and lets it grow by no more than its bound.
    """
    with listening(environment, "streamable-http") as (port, process):
        honest = Honest(port)
        until(lambda: moves(honest) and any(observer.driven(topic=TOPIC).values()))
        honest.call("ros2_stop")
        for make in ATTACKS.values():
            attack(port, make(port))
        drips = [socket.create_connection(("127.0.0.1", port)) for _ in range(40)]
        observer.forget()
        before = memory_bytes(process.pid)
        yield Attacked(port, honest, drips)
        assert '"isError":false' in honest.call("ros2_topic_list") and process.poll() is None
        grown = memory_bytes(process.pid) - before
        for connection in (*drips, honest.connection):
            connection.close()
        assert observer.moved(sent_after=0, topic=TOPIC) == []
    print(f"{grown / 1e6:.1f} MB more")
    assert grown < GROWTH_BYTES


def test_no_hostile_request_is_carried_out_and_an_honest_client_is_answered_while_each_is_open(
    ros_environment: dict[str, str], observer: Observer
) -> None:
    with attacked(ros_environment, observer) as server:
        for number, make in enumerate(ATTACKS.values()):
            attack(server.port, make(server.port), lambda: server.honest.call("ros2_relay_list"))
            server.drip(number)


@pytest.mark.full
@pytest.mark.timeout(600)
def test_many_hostile_requests_keep_no_honest_client_waiting(
    ros_environment: dict[str, str], observer: Observer
) -> None:
    kinds, chosen = list(ATTACKS.values()), random.Random(8)
    with attacked(ros_environment, observer) as server:
        honest = server.honest
        honest.thread.start()
        for number in range(ROUNDS):
            make = chosen.choice(kinds) if number >= len(kinds) else kinds[number]
            attack(server.port, make(server.port))
            server.drip(number)
        honest.ends.set()
        honest.thread.join()
    worst = statistics.quantiles(honest.taken, n=100)[-1]
    print(f"{ROUNDS} hostile requests; {len(honest.taken)} honest calls, p99 {worst:.3f} s")
    assert statistics.median(honest.taken) < ANSWERED_S
    assert worst < ANSWERED_S
