"""Who comes in over HTTP: with a token that is known, for what its scopes allow, on every path; and how many."""

from __future__ import annotations

import itertools
import json
import socket
import ssl
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import ExitStack, closing, suppress
from dataclasses import dataclass
from http.client import HTTPConnection, HTTPException, HTTPResponse, HTTPSConnection
from pathlib import Path
from typing import Any

import pytest

from ros2_mcp.guard.tokens import add_token
from support.certificates import self_signed
from support.ports import listening
from support.tokens import TOKEN, client_at

PATIENCE_S = 60.0
HANDSHAKE, MODERN = "2025-11-25", "2026-07-28"
CLIENT = {"name": "logs in by hand", "version": "1"}
PREFIX = "io.modelcontextprotocol/"
META = {f"{PREFIX}protocolVersion": MODERN, f"{PREFIX}clientInfo": CLIENT, f"{PREFIX}clientCapabilities": {}}
PATHS = (("POST", "/mcp"), ("GET", "/mcp"), ("DELETE", "/mcp"), ("OPTIONS", "/mcp"), ("GET", "/x"))
READ, ACT, STOP = "ros2_topic_list", "ros2_topic_publish", "ros2_stop"
TWIST = "geometry_msgs/msg/Twist"
_ids = itertools.count(100)
MOVE = {"topic_name": "/never/cmd_vel", "message_type": TWIST, "data": {"linear": {"x": 1.0}}}


@dataclass(frozen=True)
class Served:
    """The server of these tests: its port, and tokens by the scopes that they are named by."""

    port: int
    tokens: dict[str, str]

    def open(self) -> closing[HTTPConnection]:
        """A connection."""
        return closing(HTTPConnection("127.0.0.1", self.port, timeout=PATIENCE_S))


@pytest.fixture(scope="module")
def served(ros_environment: dict[str, str], tmp_path_factory: pytest.TempPathFactory) -> Iterator[Served]:
    path = tmp_path_factory.mktemp("login") / "tokens"
    kinds = ("observe,act,stop", "observe", "act", "stop", "observe,stop")
    tokens = {kind: add_token(path, kind.replace(",", "-"), kind.split(",")) for kind in kinds}
    with listening(ros_environment, "streamable-http", "--token-file", str(path)) as (port, _):
        yield Served(port, tokens)


def headers(token: str, **more: str) -> dict[str, str]:
    usual = {"Accept": "application/json, text/event-stream", "Content-Type": "application/json"}
    return {**usual, "Authorization": f"Bearer {token}", **{key.replace("_", "-"): more[key] for key in more}}


def begun(connection: HTTPConnection, token: str) -> str:
    """The session of a client that has introduced itself."""
    deadline = time.monotonic() + PATIENCE_S
    while not (session := greeted(connection, token)):  # those of other tests make room when silent for a lease
        assert time.monotonic() < deadline
        time.sleep(0.2)
    post(connection, {"method": "notifications/initialized"}, headers(token, Mcp_Session_Id=session)).read()
    return session


def greeted(connection: HTTPConnection, token: str) -> str:
    """The session that a client is given who introduces himself; none where all are in use."""
    params = {"protocolVersion": HANDSHAKE, "capabilities": {}, "clientInfo": CLIENT}
    answer = post(connection, {"id": 0, "method": "initialize", "params": params}, headers(token))
    assert answer.status == 200 and '"serverInfo"' in answer.read().decode()
    return answer.headers["Mcp-Session-Id"] or ""


def post(connection: HTTPConnection, message: dict[str, Any], named: dict[str, str]) -> HTTPResponse:
    connection.request("POST", "/mcp", json.dumps({"jsonrpc": "2.0", **message}), named)
    return connection.getresponse()


def call(
    connection: HTTPConnection,
    token: str,
    tool: str,
    arguments: dict[str, Any] | None = None,
    *,
    session: str = "",
    host: str = "",
) -> HTTPResponse:
    """A call of a tool, in a session or, without one, in the modern era."""
    params: dict[str, Any] = {"name": tool, "arguments": arguments or {}}
    if session:
        return post(
            connection,
            {"id": next(_ids), "method": "tools/call", "params": params},
            headers(token, Mcp_Session_Id=session),
        )
    modern = headers(token, Mcp_Protocol_Version=MODERN, Mcp_Method="tools/call", Mcp_Name=tool)
    if host:
        modern["Host"] = host
    return post(connection, {"id": 1, "method": "tools/call", "params": {**params, "_meta": META}}, modern)


@pytest.mark.promise("README", "every request without a token that the server knows, on loopback, too")
@pytest.mark.parametrize(("method", "path"), PATHS)
def test_without_a_known_token_nothing_is_answered_on_any_path(served: Served, method: str, path: str) -> None:
    good = served.tokens["observe,act,stop"]
    wrong = (
        None,
        "Bearer",
        "Bearer ",
        f"Basic {good}",
        good,
        f"Bearer {good[:-1]}",
        f"Bearer {good}x",
        f"Bearer {good.swapcase()}",
        f"Bearer {TOKEN}",  # the server's own, where a file stands in its place
        "Bearer " + "x" * 60_000,
        "Bearer \xff\xfe",
    )
    for value in wrong:
        with served.open() as connection:
            connection.putrequest(method, path)
            if value is not None:
                connection.putheader("Authorization", value.encode("latin-1"))
            connection.putheader("Content-Length", "0")
            connection.endheaders()
            answer = connection.getresponse()
            assert answer.status == 401, value
            assert answer.headers["WWW-Authenticate"].startswith('Bearer realm="ros2-mcp"')
            assert good.encode() not in answer.read()


@pytest.mark.parametrize("name", ["access_token", "token", "Access_Token", "%61ccess_token", "x=1&token"])
def test_a_token_in_the_address_is_refused_also_beside_a_good_one(served: Served, name: str) -> None:
    good = served.tokens["observe,act,stop"]
    for named in ({}, headers(good)):
        with served.open() as connection:
            connection.request("POST", f"/mcp?{name}={good}", "{}", named)
            answer = connection.getresponse()
            assert answer.status == 400 and 'error="invalid_request"' in answer.headers["WWW-Authenticate"]
            assert b"never in the address" in answer.read()


@pytest.mark.parametrize("level", ["info", "debug"])
def test_what_is_written_into_an_address_stands_in_no_log(
    ros_environment: dict[str, str], tmp_path: Path, level: str
) -> None:
    """Whoever reads the log could use a token that was refused there, for it is a good one."""
    secrets = [f"secret-{number}" for number in range(4)]
    with (tmp_path / "log").open("wb") as log:
        with listening(ros_environment, "streamable-http", "--log-level", level, log=log) as (port, _):
            own, foreign = f"127.0.0.1:{port}", "robot.example"
            for host, query in itertools.product((own, foreign), ("access_token={}", "key={}", "{}", "a=%2e&b={}#c")):
                for secret, named in zip(secrets, ({}, headers(TOKEN)) * 2, strict=True):
                    with closing(HTTPConnection("127.0.0.1", port, timeout=PATIENCE_S)) as connection:
                        connection.request("GET", f"/mcp?{query.format(secret)}", headers={**named, "Host": host})
                        assert connection.getresponse().status >= 400
        said = (tmp_path / "log").read_text()
    assert "GET /mcp HTTP/1.1" in said
    assert [secret for secret in (*secrets, TOKEN) if secret in said] == []


def test_a_doubled_authorization_is_refused_whichever_is_right(served: Served) -> None:
    good = f"Bearer {served.tokens['observe,act,stop']}"
    for first, second in ((good, good), (good, "Bearer x"), ("Bearer x", good)):
        with served.open() as connection:
            connection.putrequest("GET", "/mcp")
            connection.putheader("Authorization", first)
            connection.putheader("Authorization", second)
            connection.endheaders()
            assert connection.getresponse().status == 400


@pytest.mark.parametrize("era", ["handshake", "modern"])
@pytest.mark.parametrize(
    ("scopes", "allowed"),
    [
        ("observe,act,stop", {READ, ACT, STOP}),
        ("observe", {READ}),
        ("act", {ACT, STOP}),
        ("stop", {STOP}),
        ("observe,stop", {READ, STOP}),
    ],
)
def test_a_token_may_call_what_its_scopes_allow(served: Served, era: str, scopes: str, allowed: set[str]) -> None:
    token = served.tokens[scopes]
    with served.open() as connection:
        session = begun(connection, token) if era == "handshake" else ""
        for tool, lacks in ((READ, "observe"), (ACT, "act"), (STOP, "stop")):
            answer = call(connection, token, tool, {"data": 7} if tool == ACT else {}, session=session)
            said = answer.read().decode()
            if tool in allowed:
                assert answer.status == 200 and "lacks the scope" not in said, said
            else:
                assert answer.status == 403 and f"lacks the scope '{lacks}'" in said
                assert f'error="insufficient_scope", scope="{lacks}"' in answer.headers["WWW-Authenticate"]
        read = {"id": 2, "method": "resources/read", "params": {"uri": "ros2://topics"}}
        if session:
            refused = post(connection, read, headers(token, Mcp_Session_Id=session))
            assert (refused.status == 403) == (READ not in allowed)
            refused.read()
            post(connection, {"id": 3, "method": "tools/list"}, headers(token, Mcp_Session_Id=session)).read()


@pytest.mark.parametrize(
    "body",
    [
        '{"jsonrpc":"2.0","id":1,"method":"ping","method":"tools/call","params":%s}',
        '{"jsonrpc":"2.0","id":1,"method":"tools/call","method":"ping","params":%s}',
        '{"jsonrpc":"2.0","id":1,"method":"tools/call","params":{"name":"ros2_stop"},"params":%s}',
        '{"jsonrpc":"2.0","id":1,"method":"tools/call","params":%s,"params":{"name":"ros2_topic_list"}}',
        '{"jsonrpc":"2.0","id":1,"m\\u0065thod":"tools/call","params":%s}',
        '\ufeff{"jsonrpc":"2.0","id":1,"method":"tools/call","params":%s}',
        '[{"jsonrpc":"2.0","id":1,"method":"tools/call","params":%s}]',
    ],
)
def test_a_call_that_is_written_so_that_it_could_be_read_in_two_ways_does_not_get_past_the_scopes(
    served: Served, body: str
) -> None:
    token = served.tokens["observe"]
    params = json.dumps({"name": ACT, "arguments": MOVE})
    with served.open() as connection:
        session = begun(connection, token)
        connection.request("POST", "/mcp", (body % params).encode(), headers(token, Mcp_Session_Id=session))
        said = connection.getresponse().read().decode()
        assert '"status"' not in said, said  # which what was published has


def test_a_session_is_of_no_use_with_another_token(served: Served) -> None:
    own, other = served.tokens["observe,act,stop"], served.tokens["act"]
    with served.open() as connection:
        session = begun(connection, own)
        for method in ("POST", "GET", "DELETE"):
            body = json.dumps({"jsonrpc": "2.0", "id": 1, "method": "ping"}) if method == "POST" else None
            connection.request(method, "/mcp", body, headers(other, Mcp_Session_Id=session))
            answer = connection.getresponse()
            assert answer.status == 404, method
            answer.read()
        assert call(connection, own, READ, session=session).status == 200


def test_a_session_that_was_silent_for_the_longest_makes_room_for_the_seventeenth(served: Served) -> None:
    token = served.tokens["observe"]
    with served.open() as connection, served.open() as listening_to:
        listens = begun(connection, token)
        listening_to.request("GET", "/mcp", headers=headers(token, Mcp_Session_Id=listens))
        assert listening_to.getresponse().status == 200
        silent = [begun(connection, token) for _ in range(15)]
        newer = [begun(connection, token) for _ in range(15)]  # as soon as the others were silent for a lease
        ping = {"id": 1, "method": "ping"}
        for session, status in (*((one, 404) for one in silent), (newer[-1], 200), (listens, 200)):
            answer = post(connection, ping, headers(token, Mcp_Session_Id=session))
            answer.read()
            assert answer.status == status


def stops(connection: HTTPConnection, token: str, session: str = "") -> bool:
    """Whether a stop of the handshake era is carried out, in a session or without one."""
    named = headers(token, **({"Mcp_Session_Id": session} if session else {}))
    answer = post(connection, {"id": next(_ids), "method": "tools/call", "params": {"name": STOP}}, named)
    said = answer.read().decode()
    return answer.status == 200 and '"isError":false' in said


def test_a_login_whose_sessions_are_all_in_use_keeps_no_other_out_and_can_still_stop(served: Served) -> None:
    token, other = served.tokens["observe,act,stop"], served.tokens["observe,stop"]
    with served.open() as connection, served.open() as others, ExitStack() as streams:
        before = begun(others, other)
        for _ in range(16):
            listens = streams.enter_context(served.open())
            session = begun(connection, token)
            listens.request("GET", "/mcp", headers=headers(token, Mcp_Session_Id=session))
            assert listens.getresponse().status == 200
        assert not greeted(connection, token)
        post(connection, {"method": "notifications/initialized"}, headers(token)).read()
        for method, status in (("ping", 200), ("tools/list", 200), ("resources/list", 503)):
            answer = post(connection, {"id": next(_ids), "method": method}, headers(token))
            said = answer.read().decode()
            assert answer.status == status and ("ros2_stop alone" in said) == (status == 503), method
        read: dict[str, Any] = {"id": 1, "method": "tools/call", "params": {"name": READ, "arguments": {}}}
        answer = post(connection, read, headers(token))
        assert answer.status == 503 and answer.read()
        assert stops(connection, token)
        assert stops(others, other, before) and greeted(others, other)


async def test_a_client_that_gets_no_session_stops_as_it_would_in_one(served: Served) -> None:
    token = served.tokens["act"]
    with served.open() as connection, ExitStack() as streams:
        for _ in range(16):
            listens = streams.enter_context(served.open())
            listens.request("GET", "/mcp", headers=headers(token, Mcp_Session_Id=begun(connection, token)))
            assert listens.getresponse().status == 200
        url = f"http://127.0.0.1:{served.port}/mcp"
        async with client_at(url, mode="legacy", token=token) as client:
            assert not (await client.call_tool(STOP, {})).is_error


def test_a_stop_in_a_session_that_has_ended_is_carried_out_and_nothing_else_is(served: Served) -> None:
    token = served.tokens["observe,act,stop"]
    with served.open() as connection:
        session = begun(connection, token)
        connection.request("DELETE", "/mcp", headers=headers(token, Mcp_Session_Id=session))
        assert connection.getresponse().read() is not None
        answer = call(connection, token, READ, session=session)
        assert answer.status == 404 and answer.read()
        assert stops(connection, token, session)
        assert stops(connection, token, "never-begun")
        refused = call(connection, served.tokens["observe"], STOP, session=session)
        assert refused.status == 403 and b"lacks the scope" in refused.read()


def test_of_forty_calls_at_once_eight_are_refused_and_a_stop_is_not(served: Served) -> None:
    token = served.tokens["observe,act,stop"]
    wait = {"topic_name": "/never_there", "timeout": 120}
    answers: list[str] = []
    open_ones: list[HTTPConnection] = []

    def waits() -> None:
        with served.open() as connection, suppress(OSError, HTTPException):  # it is closed while it waits
            open_ones.append(connection)
            answers.append(call(connection, token, "ros2_topic_echo_wait", wait).read().decode())

    threads = [threading.Thread(target=waits) for _ in range(40)]
    for thread in threads:
        thread.start()
    deadline = time.monotonic() + PATIENCE_S
    while sum("the most at once" in answer for answer in answers) < 8:
        assert time.monotonic() < deadline, answers
        time.sleep(0.01)
    with served.open() as connection:
        assert "the most at once" not in call(connection, token, STOP).read().decode()
    for connection in open_ones:
        if connection.sock:  # it was not refused
            connection.sock.shutdown(socket.SHUT_RDWR)
    for thread in threads:
        thread.join()
    assert sum("the most at once" in answer for answer in answers) == 8


def test_a_request_that_does_not_come_is_given_up(served: Served) -> None:
    seconds_until_given_up(served)


@pytest.mark.full
def test_a_request_that_does_not_come_within_fifteen_seconds_is_given_up(served: Served) -> None:
    assert 10.0 < seconds_until_given_up(served) < 25.0


def seconds_until_given_up(served: Served) -> float:
    """Of the head of a request, of its body, of one that was refused already; of connections that say nothing; and of
    a second request.
    """
    port, good = served.port, f"Authorization: Bearer {served.tokens['observe']}\r\n"
    head = f"POST /mcp HTTP/1.1\r\nHost: 127.0.0.1:{port}\r\n"
    kind = "Content-Type: application/json\r\nContent-Length: 500\r\n\r\n{"
    refused = f"{head}Content-Length: 0\r\n\r\n"
    begins = ("", head, head + good + kind, head + kind, refused + head + good + kind)
    connections = [socket.create_connection(("127.0.0.1", port)) for _ in begins]
    started = time.monotonic()
    for connection, text in zip(connections, begins, strict=True):
        connection.sendall(text.encode())
        connection.settimeout(1.0)
    still = dict.fromkeys(connections, True)
    while any(still.values()):
        assert time.monotonic() < started + PATIENCE_S, still
        for connection in [connection for connection in connections if still[connection]]:
            try:
                if connection is not connections[-1]:  # a second request came with the first, and nothing follows
                    connection.sendall(b" ")
                still[connection] = connection.recv(65536) != b""
            except TimeoutError:
                pass
            except OSError:
                still[connection] = False
    took_s = time.monotonic() - started
    for connection in connections:
        connection.close()
    return took_s


def test_connections_without_a_login_keep_no_client_out(served: Served) -> None:
    port, token = served.port, served.tokens["observe"]
    with served.open() as known:
        assert call(known, token, READ).status == 200
        idle = [socket.create_connection(("127.0.0.1", port)) for _ in range(400)]
        with served.open() as comes:
            assert call(comes, token, READ).status == 200
        for connection in idle:
            connection.close()


def test_connections_of_one_login_keep_no_other_out(served: Served) -> None:
    token, other = served.tokens["observe"], served.tokens["observe,stop"]
    with ExitStack() as held, served.open() as known:
        assert call(known, other, READ).read()
        known.auto_open = 0  # it has to be the same connection
        for number in range(260):
            connection = held.enter_context(served.open())
            assert call(connection, token, "no_tool").status == 200
            if number % 20 == 0:  # else it would be given up where all of this takes 15 s
                assert call(known, other, "no_tool").read()
        with served.open() as comes:
            assert call(comes, other, READ).status == 200
        assert call(known, other, READ).status == 200


def test_with_tls_it_is_reached_under_its_public_name_and_no_other(
    ros_environment: dict[str, str], tmp_path: Path
) -> None:
    certificate, key = self_signed(tmp_path, "127.0.0.2")
    options = ("--tls-cert", str(certificate), "--tls-key", str(key), "--public-url", "https://robot.example")
    with listening(ros_environment, "streamable-http", *options, "--host", "0.0.0.0") as (port, _):
        context = ssl.create_default_context(cafile=str(certificate))
        for host, status in (("robot.example", 200), (f"127.0.0.1:{port}", 200), (f"127.0.0.2:{port}", 421)):
            with closing(HTTPSConnection("127.0.0.2", port, timeout=PATIENCE_S, context=context)) as connection:
                assert call(connection, TOKEN, READ, host=host).status == status
        with closing(HTTPConnection("127.0.0.2", port, timeout=PATIENCE_S)) as plain, pytest.raises(OSError):
            call(plain, TOKEN, READ)
        stalled = [socket.create_connection(("127.0.0.1", port), PATIENCE_S) for _ in range(300)]
        assert [connection.recv(1) for connection in stalled[:44]] == [b""] * 44  # of more than 256 the oldest ended
        with closing(HTTPSConnection("127.0.0.2", port, timeout=PATIENCE_S, context=context)) as comes:
            assert call(comes, TOKEN, READ, host="robot.example").status == 200
        for connection in stalled:
            connection.close()


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (("--host", "0.0.0.0"), "the token would cross the network in the open"),
        (("--host", "0.0.0.0", "--no-login"), "--no-login would give access to anyone"),
        (("--transport", "sse"), "Write --transport streamable-http instead"),
        (("--tls-cert", __file__), "belong together"),
        (("--tls-cert", __file__, "--tls-key", __file__), f"TLS cannot use {__file__}"),
    ],
)
def test_a_server_with_such_options_does_not_start_and_says_why(
    ros_environment: dict[str, str], options: tuple[str, ...], said: str
) -> None:
    command = [sys.executable, "-m", "ros2_mcp", "--transport", "streamable-http", *options]
    ended = subprocess.run(command, env=ros_environment, capture_output=True, text=True, timeout=60, check=False)
    assert ended.returncode == 1 and said in ended.stderr and "Traceback" not in ended.stderr


def test_a_server_that_cannot_listen_says_so_and_fails(ros_environment: dict[str, str], served: Served) -> None:
    port = str(served.port)
    command = [sys.executable, "-m", "ros2_mcp", "--transport", "streamable-http", "--port", port]
    ended = subprocess.run(command, env=ros_environment, capture_output=True, text=True, timeout=60, check=False)
    assert ended.returncode == 1 and "Traceback" not in ended.stderr
    assert f"cannot listen at 127.0.0.1, port {port}: address already in use." in ended.stderr


def test_without_a_login_every_client_is_told_so(ros_environment: dict[str, str]) -> None:
    with (
        listening(ros_environment, "streamable-http", "--no-login") as (port, _),
        closing(HTTPConnection("127.0.0.1", port, timeout=PATIENCE_S)) as connection,
    ):
        answer = call(connection, "", "ros2_status")
        assert answer.status == 200 and "No login is asked for" in answer.read().decode()
