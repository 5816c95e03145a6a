"""200 hostile requests over real sockets to a real `ros2-mcp view`, and connections that never finish theirs."""

from __future__ import annotations

import json
import os
import re
import select
import socket
import sys
from collections.abc import Iterator
from contextlib import ExitStack

import pytest

from support.processes import python_path, running
from support.room_bag import room_bag

ANSWERED_S = 30.0
"""On a machine that is busy with other tests."""
SLOW = 200
"""Connections that send their request a byte at a time."""
BODY = json.dumps({"name": "ros2_view_frame", "arguments": {"panels": {"values": ""}}})


@pytest.fixture(scope="module")
def view(tmp_path_factory: pytest.TempPathFactory) -> Iterator[tuple[int, str]]:
    """Port and token of a page; its state folder is that test's alone."""
    folder = tmp_path_factory.mktemp("view")
    environment = {**os.environ, "XDG_STATE_HOME": str(folder / "state"), "PYTHONPATH": python_path()}
    command = [sys.executable, "-m", "ros2_mcp", "view", "--bag", str(room_bag(folder / "room"))]
    with running(environment, *command) as process:
        assert process.stdout
        found = re.search(r":(\d+)/#(\S+)", process.stdout.readline())
        assert found
        yield int(found[1]), found[2]
        assert not list((folder / "state").rglob("latch*"))  # no hostile request has stopped anything


def connected(port: int) -> socket.socket:
    return socket.create_connection(("127.0.0.1", port), timeout=ANSWERED_S)


def asked(port: int, request: bytes) -> bytes:
    """What is answered until it is closed, or nothing more comes."""
    answer = b""
    with connected(port) as connection:
        try:
            connection.sendall(request)  # a server that refuses early may have closed before it has read all
            connection.shutdown(socket.SHUT_WR)
            while more := connection.recv(65536):
                answer += more
        except OSError:
            pass
    return answer


def request(method: str, path: str, headers: dict[str, str], body: str = BODY) -> bytes:
    lines = [f"{method} {path} HTTP/1.1", *(f"{name}: {value}" for name, value in headers.items())]
    return ("\r\n".join([*lines, f"content-length: {len(body.encode())}", "connection: close", "", ""]) + body).encode()


def good(port: int, token: str) -> dict[str, str]:
    at = f"127.0.0.1:{port}"
    return {"host": at, "origin": f"http://{at}", "content-type": "application/json", "x-ros2-mcp-token": token}


def hostile(port: int, token: str) -> Iterator[bytes]:
    """Requests that are no page's. The good token is in those whose fault is another one."""
    well = good(port, token)
    hosts = [
        "",
        "evil.example",
        f"evil.example:{port}",
        "127.0.0.1",
        f"127.0.0.1:{port + 1}",
        f"[::1]:{port}",
        "0.0.0.0",
    ]
    hosts += [
        f"127.0.0.1:{port}.evil.example",
        f"evil@127.0.0.1:{port}",
        f"127.1:{port}",
        f"LOCALHOST:{port}",
        f"127.0.0.1:0{port}",
    ]
    origins = ["null", "http://evil.example", f"https://127.0.0.1:{port}", f"http://localhost:{port}", "file://", ""]
    origins += [
        f"http://127.0.0.1:{port + 1}",
        f"http://127.0.0.1:{port}/",
        f"http://127.0.0.1:{port} http://evil.example",
        "chrome-extension://x",
    ]
    tokens = [
        "",
        token[:-1],
        f"{token}x",
        token.swapcase(),
        f"Bearer {token}",
        "0" * 43,
        "x" * 5000,
        token[::-1],
        f"{token},{token}",
        "%00",
        "null",
        "undefined",
        token[:8],
        f"{token}====",
    ]
    kinds = [
        "",
        "text/plain",
        "application/x-www-form-urlencoded",
        "multipart/form-data; boundary=x",
        "application/json;x=1",
        "text/json",
    ]
    sites = (("host", hosts), ("origin", origins), ("x-ros2-mcp-token", tokens), ("content-type", kinds))
    for value in hosts:
        yield request("GET", "/", {"host": value}, "")
    for value in origins[:-1]:
        yield request("GET", "/", {"host": well["host"], "origin": value}, "")
    for path in ("/call", "/stop"):
        for name, values in sites:
            for value in values:
                yield request("POST", path, {**well, name: value})
            yield request("POST", path, {key: value for key, value in well.items() if key != name})
        for method in ("GET", "PUT", "DELETE", "OPTIONS", "HEAD", "PATCH", "TRACE", "CONNECT", "PROPFIND", "post"):
            yield request(method, path, well)
        yield request(
            "OPTIONS", path, {**well, "access-control-request-method": "POST", "origin": "http://evil.example"}
        )
        yield request(
            "GET", path, {**well, "upgrade": "websocket", "connection": "Upgrade", "sec-websocket-key": "AAAA"}
        )
        yield request("POST", path, well, "x" * 30_000)
        for name in ("host", "origin", "x-ros2-mcp-token"):  # twice, the second one good
            yield request("POST", path, well).replace(f"{name}:".encode(), f"{name}: x\r\n{name}:".encode(), 1)
    for path in (
        "/CALL",
        "//call",
        "/call/",
        "/call%00",
        "/./call",
        "/x/../call",
        "/%63all",
        "/call;x",
        "/stop/",
        "/STOP",
        "/mcp",
        "/page.html",
    ):
        yield request("POST", path.replace("%63", "%2563"), well)
    for path in (
        "/.git/config",
        "/../../etc/passwd",
        "/%2e%2e/%2e%2e/etc/passwd",
        "/favicon.ico",
        "/token",
        "/state",
        "/index.html",
        "/robots.txt",
        "/..",
        "/call",
        "/stop",
    ):
        yield request("GET", path, well)
    for name in ("ros2_topic_publish", "ros2_stop", "__class__", "", "ros2_view_frame\\u0000", "../ros2_view_ask"):
        yield request("POST", "/call", well, f'{{"name": "{name}", "arguments": {{}}}}')
    for body in (
        "",
        "{",
        "null",
        "[]",
        "1e999",
        '"x"',
        "[" * 15_000,
        '{"name": 5}',
        '{"name": "ros2_view_frame"}',
        "\ufeff{}",
    ):
        yield request("POST", "/call", well, body)
    for arguments in (
        "null",
        "[]",
        "{}",
        '{"panels": 5}',
        '{"panels": [1]}',
        '{"panels": {}, "at_s": "x"}',
        '{"panels": {}, "at_s": 1e300}',
    ):
        yield request("POST", "/call", well, f'{{"name": "ros2_view_frame", "arguments": {arguments}}}')
    yield from broken(well)


def broken(well: dict[str, str]) -> Iterator[bytes]:
    """What is hardly HTTP."""
    whole = request("POST", "/call", well)
    yield from (
        b"",
        b"\0" * 1000,
        b"\x16\x03\x01\x02\x00\x01\x00\x01\xfc\x03\x03",
        b"PRI * HTTP/2.0\r\n\r\nSM\r\n\r\n",
        b"GET /\r\n\r\n",
    )
    yield whole.replace(b"host:", b"ho st:", 1)
    yield whole.replace(b"\r\n", b"\n").replace(b"x-ros2-mcp-token", b"x-ros2-mcp-tokex")
    yield whole.replace(b"content-length: ", b"content-length: -")
    yield whole.replace(b"content-length: ", b"content-length: 9999999999999999999999")
    yield whole.replace(b"content-length:", b"content-length: 5\r\ncontent-length:")
    yield whole.replace(b"content-length:", b"transfer-encoding: chunked\r\ncontent-length:")
    yield whole.replace(b"/call", b"/" + b"a" * 100_000)
    yield whole.replace(b"origin:", b"x-long: " + b"a" * 200_000 + b"\r\norigin:")[:150_000]
    yield whole.replace(b"/call", "/cöll".encode())
    yield whole.replace(b"POST /call", b"POST http://evil.example/call")


def test_no_hostile_request_is_answered(view: tuple[int, str]) -> None:
    port, token = view
    sent_all = [*hostile(port, token)]
    assert len(sent_all) >= 200
    for sent in sent_all:
        answer = asked(port, sent)
        assert not answer or re.match(rb"HTTP/1\.1 4\d\d ", answer), (sent[:300], answer[:300])
        assert b"access-control" not in answer.lower() and b'"panels"' not in answer, sent[:300]
    assert b'"panels"' in asked(port, request("POST", "/call", good(port, token)))  # and the page still is


def test_connections_that_never_finish_their_request_hold_nobody_up(view: tuple[int, str]) -> None:
    port, token = view
    whole = request("POST", "/call", good(port, token))
    with ExitStack() as open_ones:
        slow = [open_ones.enter_context(connected(port)) for _ in range(SLOW)]
        for at in range(3):
            for number, connection in enumerate(slow):
                connection.sendall(whole[at : at + 1] if number % 2 or at else whole[:-5])
            assert b'"panels"' in asked(port, whole)
            assert not select.select(slow, [], [], 0)[0], "it was answered when those had been given up"
