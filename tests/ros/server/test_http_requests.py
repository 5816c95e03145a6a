"""What a server over HTTP refuses: foreign Host and Origin headers on every path, and bodies that are no requests."""

from __future__ import annotations

import json
import re
import socket
import time
from collections.abc import Iterator
from contextlib import closing
from http.client import HTTPConnection, HTTPResponse
from typing import Any

import pytest

from support.ports import listening
from support.tokens import BEARER, HEADERS

PATIENCE_S = 30.0
MODERN, HANDSHAKE = "2026-07-28", "2025-11-25"
CLIENT = {"name": "requests by hand", "version": "1"}
INITIALIZE = {"protocolVersion": HANDSHAKE, "capabilities": {}, "clientInfo": CLIENT}
PREFIX = "io.modelcontextprotocol/"
META = {f"{PREFIX}protocolVersion": MODERN, f"{PREFIX}clientInfo": CLIENT, f"{PREFIX}clientCapabilities": {}}
PATHS = (("POST", "/mcp"), ("GET", "/mcp"), ("DELETE", "/mcp"), ("GET", "/"), ("GET", "/nothing"))
TOO_LARGE = 1_000_001


@pytest.fixture(scope="module")
def port(ros_environment: dict[str, str]) -> Iterator[int]:
    """The server's."""
    with listening(ros_environment, "streamable-http") as (port, _):
        yield port


def answer(port: int, method: str, path: str, headers: list[tuple[str, str]], body: bytes = b"") -> tuple[int, bytes]:
    """Status and first bytes of the answer to a request whose headers are sent as they are; of JSON all of it."""
    lines = [f"{method} {path} HTTP/1.1", *(f"{name}: {value}" for name, value in headers)]
    with socket.create_connection(("127.0.0.1", port), PATIENCE_S) as connection:
        connection.sendall("\r\n".join([*lines, "", ""]).encode("latin-1"))
        for start in range(0, len(body), 1 << 16):
            try:
                connection.sendall(body[start : start + (1 << 16)])
            except (BrokenPipeError, ConnectionResetError):
                break  # it has refused the rest
        received = b""
        while b"\r\n\r\n" not in received:
            part = connection.recv(65536)
            assert part, "closed without an answer"
            received += part
        head, _, rest = received.partition(b"\r\n\r\n")
        if b"application/json" in head:  # its body may come some time after its head
            while not is_whole(head, rest) and (part := connection.recv(65536)):
                rest += part
    return int(head.split()[1]), rest


def is_whole(head: bytes, body: bytes) -> bool:
    """Whether the body of an answer with this head has come."""
    length = re.search(rb"(?i)^content-length: *(\d+)", head, re.MULTILINE)
    return len(body) >= int(length[1]) if length else body.endswith(b"0\r\n\r\n")


def usual(port: int, method: str = "POST", **more: str) -> list[tuple[str, str]]:
    """The headers of an honest client."""
    kind = [("Content-Type", "application/json")] if method == "POST" else []
    return [
        ("Host", f"127.0.0.1:{port}"),
        ("Authorization", BEARER),
        ("Accept", "application/json, text/event-stream"),
        *kind,
        *((name.replace("_", "-"), value) for name, value in more.items()),
    ]


def with_host(headers: list[tuple[str, str]], *hosts: str) -> list[tuple[str, str]]:
    return [*(("Host", host) for host in hosts), *headers[1:]]


def request(method: str, params: dict[str, Any]) -> bytes:
    return json.dumps({"jsonrpc": "2.0", "id": 1, "method": method, "params": params}).encode()


def sized(headers: list[tuple[str, str]], body: bytes) -> list[tuple[str, str]]:
    return [*headers, ("Content-Length", str(len(body)))]


def is_well(port: int) -> bool:
    """Whether an honest client of the modern era is served."""
    body = request("tools/list", {"_meta": META})
    headers = sized(usual(port, Mcp_Protocol_Version=MODERN, Mcp_Method="tools/list"), body)
    status, text = answer(port, "POST", "/mcp", headers, body)
    return status == 200 and b"ros2_topic_list" in text


@pytest.mark.promise("README", "requests with a foreign or doubled Host or Origin header are refused on every path")
@pytest.mark.parametrize(("method", "path"), PATHS)
def test_a_foreign_host_is_refused_on_every_path(port: int, method: str, path: str) -> None:
    foreign = (
        f"robot.example:{port}",
        f"127.0.0.1.robot.example:{port}",
        f"localhost.robot.example:{port}",
        f"localhost.:{port}",
        f"127.0.0.2:{port}",
        f"0.0.0.0:{port}",
        f"localhost:{port + 1}",
        f"localhost:{port}@robot.example",
        "localhost",
        "",
    )
    for host in foreign:
        body = request("initialize", INITIALIZE) if method == "POST" else b""
        headers = sized(with_host(usual(port, method), host), body)
        assert answer(port, method, path, headers, body)[0] == 421, host


@pytest.mark.promise("README", "requests with a foreign or doubled Host or Origin header are refused on every path")
@pytest.mark.parametrize(("method", "path"), PATHS)
def test_a_foreign_origin_is_refused_on_every_path(port: int, method: str, path: str) -> None:
    foreign = (
        "null",
        "http://robot.example",
        f"http://robot.example:{port}",
        f"https://localhost:{port}",
        f"http://localhost:{port + 1}",
        f"http://localhost:{port}.robot.example",
        f"http://localhost:{port}/",
        "http://localhost",
        "file://",
    )
    for origin in foreign:
        body = request("initialize", INITIALIZE) if method == "POST" else b""
        headers = sized(usual(port, method, Origin=origin), body)
        assert answer(port, method, path, headers, body)[0] == 403, origin


@pytest.mark.promise("README", "requests with a foreign or doubled Host or Origin header are refused on every path")
@pytest.mark.parametrize(("method", "path"), PATHS)
def test_a_doubled_host_or_origin_is_refused_on_every_path(port: int, method: str, path: str) -> None:
    """Also if one of them, or the first, is ours."""
    own, foreign = f"127.0.0.1:{port}", f"robot.example:{port}"
    for first, second in ((own, foreign), (foreign, own), (own, own)):
        assert answer(port, method, path, sized(with_host(usual(port, method), first, second), b""))[0] == 400
        origins = [("Origin", f"http://{first}"), ("Origin", f"http://{second}")]
        assert answer(port, method, path, sized([*usual(port, method), *origins], b""))[0] == 400


def test_own_names_and_a_missing_origin_are_accepted(port: int) -> None:
    body = request("initialize", INITIALIZE)
    for name in ("127.0.0.1", "localhost", "[::1]"):
        own = with_host(usual(port), f"{name}:{port}")
        assert answer(port, "POST", "/mcp", sized(own, body), body)[0] == 200
        assert answer(port, "POST", "/mcp", sized([*own, ("Origin", f"http://{name}:{port}")], body), body)[0] == 200


DEEP = b"[" * 100_000
BAD_BODIES = {
    "empty": b"",
    "no JSON": b"{",
    "no UTF-8": b'{"jsonrpc": "2.0", "id": 1, "method": "\xff"}',
    "deep": DEEP,
    "a number": b"7",
    "a batch": b'[{"jsonrpc": "2.0", "id": 1, "method": "ping"}]',
    "no method": b'{"jsonrpc": "2.0", "id": 1}',
    "another version": b'{"jsonrpc": "1.0", "id": 1, "method": "ping"}',
    "an id that is none": b'{"jsonrpc": "2.0", "id": {}, "method": "ping"}',
    "a long number": b'{"jsonrpc": "2.0", "id": ' + b"9" * 5000 + b', "method": "ping"}',
}


@pytest.mark.parametrize("what", BAD_BODIES)
def test_a_body_that_is_no_request_is_refused(port: int, what: str) -> None:
    """In both eras; and the server goes on."""
    body = BAD_BODIES[what]
    for era in ({}, {"Mcp_Protocol_Version": HANDSHAKE}, {"Mcp_Protocol_Version": MODERN, "Mcp_Method": "ping"}):
        assert answer(port, "POST", "/mcp", sized(usual(port, **era), body), body)[0] == 400
    assert is_well(port)


REFUSED = {
    b'{"jsonrpc": "2.0", "id": 5, "method": "ping", "params": []}': (5, -32602),
    b'{"jsonrpc": "2.0", "id": "a", "method": "ping", "params": {"name": "\\ud800"}}': ("a", -32600),
    b'{"jsonrpc": "2.0", "id": 1.5, "method": "ping"}': (1.5, -32600),
    b'{"jsonrpc": "2.0", "id": 8, "method": "ping"': (8, -32600),
    b'{"jsonrpc": "2.0", "id"': (None, -32700),
}


@pytest.mark.parametrize("path", ["/mcp", "/mcp%0A"])
@pytest.mark.parametrize("padding", [b"", b" " * 25_000], ids=["small", "large"])
@pytest.mark.parametrize("body", REFUSED)
def test_a_refusal_has_the_id_of_its_request(port: int, body: bytes, padding: bytes, path: str) -> None:
    padded = padding + body
    for era in ({}, {"Mcp_Protocol_Version": HANDSHAKE}, {"Mcp_Protocol_Version": MODERN, "Mcp_Method": "ping"}):
        status, text = answer(port, "POST", path, sized(usual(port, **era), padded), padded)
        said = json.loads(text)
        assert (status, said["id"], said["error"]["code"]) == (400, *REFUSED[body])


def post(connection: HTTPConnection, session: str, message: dict[str, Any]) -> HTTPResponse:
    """The answer, as far as it has begun."""
    headers = {"Accept": "application/json, text/event-stream", "Content-Type": "application/json"}
    named = {"Mcp-Session-Id": session} if session else {}
    connection.request("POST", "/mcp", json.dumps({"jsonrpc": "2.0", **message}), {**headers, **HEADERS, **named})
    return connection.getresponse()


def test_of_two_requests_with_one_id_in_a_session_the_second_is_refused(port: int) -> None:
    slow, other = (HTTPConnection("127.0.0.1", port, timeout=PATIENCE_S) for _ in range(2))
    with closing(slow), closing(other):
        begun = post(other, "", {"id": 1, "method": "initialize", "params": INITIALIZE})
        session = begun.headers["Mcp-Session-Id"]
        begun.read()
        post(other, session, {"method": "notifications/initialized"}).read()
        wait = {"name": "ros2_topic_echo_wait", "arguments": {"topic_name": "/never_there", "timeout": 60}}
        post(slow, session, {"id": 7, "method": "tools/call", "params": wait})
        for same in (7, "7"):
            refused = post(other, session, {"id": same, "method": "ping"})
            said = json.loads(refused.read())
            assert (refused.status, said["id"], said["error"]["code"]) == (400, same, -32600)
            assert "has not been answered yet" in said["error"]["message"]
        assert b'"result":{}' in post(other, session, {"id": 8, "method": "ping"}).read()


@pytest.mark.parametrize("path", ["/mcp", "/mcp%0A"])
def test_a_body_that_is_too_large_is_refused(port: int, path: str) -> None:
    """Whether its size is declared or not, long before all of it has come, and however its path is written."""
    for era in ({}, {"Mcp_Protocol_Version": MODERN}):
        declared = [*usual(port, **era), ("Content-Length", str(10**12))]
        assert answer(port, "POST", path, declared, b"[")[0] == 413
        chunk = b"10000\r\n" + b" " * 0x10000 + b"\r\n"
        chunked = [*usual(port, **era), ("Transfer-Encoding", "chunked")]
        assert answer(port, "POST", path, chunked, chunk * (TOO_LARGE // 0x10000 + 1))[0] == 413
    assert is_well(port)


@pytest.mark.parametrize("length", [0, 5, 10**6])
@pytest.mark.parametrize("path", ["/mcp", "/x"])
def test_a_request_with_a_length_and_chunks_is_refused_and_its_connection_ends(
    port: int, path: str, length: int
) -> None:
    """What stands behind the chunks would else be a second request, which a proxy before us took for a body."""
    lengths = [("Content-Length", str(length)), ("Transfer-Encoding", "chunked")]
    for more in (lengths, lengths[::-1]):
        hidden = f"GET {path} HTTP/1.1\r\nHost: 127.0.0.1:{port}\r\nAuthorization: {BEARER}\r\n\r\n"
        lines = [f"POST {path} HTTP/1.1", *(f"{name}: {value}" for name, value in [*usual(port), *more])]
        with socket.create_connection(("127.0.0.1", port), PATIENCE_S) as connection:
            connection.sendall("\r\n".join([*lines, "", f"0\r\n\r\n{hidden}"]).encode())
            received = b""
            while part := connection.recv(65536):
                received += part
        head = received.partition(b"\r\n\r\n")[0].lower()
        assert head.startswith(b"http/1.1 400 ") and b"connection: close" in head
        assert received.count(b"HTTP/1.1 ") == 1
    assert is_well(port)


def calling(arguments: bytes) -> bytes:
    """A call of the modern era with these arguments, in JSON."""
    call = request("tools/call", {"name": "ros2_topic_publish", "arguments": "here", "_meta": META})
    return call.replace(b'"here"', arguments)


MANY_BYTES = 800_000
NESTED = {
    "deep": b"[" * 100 + b"]" * 100,
    "empty lists": b"[]",
    "deep objects": b'{"a":' * 100 + b"1" + b"}" * 100,
}
"""What lists are made of that hold a process up for as long as nothing else of that size does."""


def nested(of: bytes) -> bytes:
    return calling(b'{"data": [' + b",".join([of] * (MANY_BYTES // (len(of) + 1))) + b"]}")


@pytest.mark.parametrize("what", NESTED)
def test_a_body_of_too_many_lists_and_objects_is_refused_unread(port: int, what: str) -> None:
    body = nested(NESTED[what])
    for era in ({}, {"Mcp_Protocol_Version": MODERN, "Mcp_Method": "tools/call"}):
        with closing(HTTPConnection("127.0.0.1", port, timeout=PATIENCE_S)) as connection:
            connection.request("POST", "/mcp", body, dict(usual(port, **era)))
            refused = connection.getresponse()
            assert refused.status == 400 and b"at most 50,000 objects and lists" in refused.read()
    assert is_well(port)


@pytest.mark.parametrize(
    "part", [b'{"x":0.12,"y":-1.5,"z":0.0}', b"0", b'"\xe2\x9c\x93 text"'], ids=["points", "numbers", "texts"]
)
def test_a_large_body_of_an_honest_client_is_read(port: int, part: bytes) -> None:
    body = nested(part)
    headers = usual(port, Mcp_Protocol_Version=MODERN, Mcp_Method="tools/call", Mcp_Name="ros2_topic_publish")
    with closing(HTTPConnection("127.0.0.1", port, timeout=PATIENCE_S)) as connection:
        connection.request("POST", "/mcp", body, dict(headers))
        answered = connection.getresponse()
        assert answered.status == 200 and b"needs the argument 'topic_name'" in answered.read()


STOPS_S = 0.25
"""For a stop beside twelve such bodies, on a quiet machine; it took 3 s."""


@pytest.mark.full
@pytest.mark.parametrize("what", [*NESTED, "points"])
def test_a_stop_does_not_wait_behind_large_bodies_of_others(port: int, what: str) -> None:
    body = nested(NESTED.get(what, b'{"x":0.12,"y":-1.5,"z":0.0}'))
    headers = {name: value for name, value in usual(port) if name != "Host"} | {"Mcp-Protocol-Version": MODERN}
    large = {**headers, "Mcp-Method": "tools/call", "Mcp-Name": "ros2_topic_publish"}
    stop = request("tools/call", {"name": "ros2_stop", "arguments": {}, "_meta": META})
    taken: list[float] = []
    for _ in range(2):  # the first stop imports what it needs
        others = [HTTPConnection("127.0.0.1", port, timeout=PATIENCE_S) for _ in range(12)]
        stopping = HTTPConnection("127.0.0.1", port, timeout=PATIENCE_S)
        for other in others:
            other.putrequest("POST", "/mcp")
            for name, value in {**large, "Content-Length": str(len(body))}.items():
                other.putheader(name, value)
            other.endheaders(body[:-1])
        for other in others:
            other.send(body[-1:])
        began = time.monotonic()
        stopping.request("POST", "/mcp", stop, {**large, "Mcp-Name": "ros2_stop"})
        assert stopping.getresponse().read()
        taken.append(time.monotonic() - began)
        for connection in (*others, stopping):
            connection.close()
    print(f"{what}: a stop took {taken[-1]:.3f} s")
    assert taken[-1] < STOPS_S


def test_a_page_cannot_post_without_asking_first(port: int) -> None:
    """What browsers send to foreign servers unasked has one of these types, and nothing allows them more."""
    body = request("initialize", INITIALIZE)
    for kind in (
        "text/plain",
        "application/x-www-form-urlencoded",
        "multipart/form-data",
        "text/plain;application/json",
    ):
        headers = [line for line in usual(port) if line[0] != "Content-Type"]
        refused, _ = answer(port, "POST", "/mcp", sized([*headers, ("Content-Type", kind)], body), body)
        assert refused == 400, kind
    asked = [("Access-Control-Request-Method", "POST"), ("Origin", "http://robot.example")]
    assert answer(port, "OPTIONS", "/mcp", [*usual(port, "OPTIONS"), *asked])[0] == 403
