"""Whatever a client sends over real stdio, each request gets exactly one answer, and the next good one is answered.

The server has a recording for its robot: nothing waits, and ROS is not needed. `ROS2_MCP_FULL=1` sends 200,000 lines.
"""

from __future__ import annotations

import os
import threading
from collections import Counter
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from support.agent import FULL
from support.fuzz import HANDSHAKE, INITIALIZE, META, PREFIX, Fuzzer, Sent, balance, key_of
from support.hostile_bag import write_hostile_bag
from support.raw_server import MODERN, RawServer

REQUESTS = 100_000 if FULL else 1_500
"""For each era of the protocol."""
AT_A_TIME = 250
ANSWER_S = 60.0
"""For all of those that are sent at a time."""


@pytest.fixture(scope="module")
def bag(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_hostile_bag(tmp_path_factory.mktemp("fuzz") / "bag")


def started(bag: Path) -> RawServer:
    return RawServer({**os.environ}, "--tools", "all", "--log-level", "error", "--bag", str(bag))


@pytest.fixture
def start(bag: Path) -> Iterator[Callable[[], RawServer]]:
    servers: list[RawServer] = []

    def begin() -> RawServer:
        servers.append(started(bag))
        return servers[-1]

    yield begin
    for server in servers:
        server.end()


@pytest.fixture(scope="module")
def shared(bag: Path) -> Iterator[RawServer]:
    """A server of several tests, begun in the handshake era."""
    server = started(bag)
    server.begin(HANDSHAKE)
    yield server
    server.end()


@pytest.fixture
def server(shared: RawServer) -> RawServer:
    shared.forget()
    return shared


def unanswered(server: RawServer, fuzzer: Fuzzer, number: int) -> tuple[int, list[Sent]]:
    """How many of so many lines have no answer, or more than one; some of them."""
    wrong, examples = 0, list[Sent]()
    for _ in range(0, number, AT_A_TIME):
        server.forget()
        sent = list(fuzzer.requests(AT_A_TIME))
        writing = threading.Thread(target=server.write, args=(b"".join(each.line for each in sent),))
        writing.start()
        server.wait_for_answers(sum(bool(each.answers) for each in sent), ANSWER_S)
        writing.join()
        assert "result" in server.ask("tools/list"), "a good request afterwards"
        answers = Counter(map(key_of, server.answers()))
        answers[str(server.last_id)] -= 1
        found, some = balance(sent, answers)
        wrong += found
        examples += some
    return wrong, examples[:10]


@pytest.mark.timeout(3600)
@pytest.mark.parametrize("version", [HANDSHAKE, MODERN])
def test_every_request_gets_exactly_one_answer(start: Callable[[], RawServer], version: str) -> None:
    server = start()
    server.begin(version)
    tools: list[dict[str, Any]] = server.ask("tools/list")["result"]["tools"]
    assert unanswered(server, Fuzzer(7, tools, version=version), REQUESTS) == (0, [])


ODD_OPENINGS: list[Any] = [
    [],
    {**INITIALIZE, "protocolVersion": 5},
    {**INITIALIZE, "clientInfo": {"name": "\ud800", "version": None}},
    {"_meta": {**META, f"{PREFIX}clientInfo": []}},
]
"""Parameters of the first request of all, which decides about the era of the protocol."""


@pytest.mark.parametrize("number", range(len(ODD_OPENINGS)))
def test_an_odd_beginning_is_answered_and_a_good_one_after_it_too(start: Callable[[], RawServer], number: int) -> None:
    server = start()
    server.write(b"\n\xff\n")
    server.wait_for_answers(1)
    assert [(line["id"], line["error"]["code"]) for line in server.answers()] == [(None, -32700)]
    assert server.answer(server.send_params("initialize", ODD_OPENINGS[number]))["error"]["code"] in (-32600, -32602)
    assert server.begin(HANDSHAKE)["protocolVersion"] == HANDSHAKE


def test_two_requests_with_the_same_id_are_both_answered(server: RawServer) -> None:
    server.write(b'{"jsonrpc": "2.0", "id": "twice", "method": "tools/list"}\n' * 2)
    server.wait_for_answers(2)
    assert [(line["id"], "result" in line) for line in server.answers()] == [("twice", True)] * 2


REFUSED = {
    b'{"jsonrpc": "2.0", "id": 5, "method": "tools/call", "params": {"name": "x", "arguments": []}}': (5, -32602),
    b'{"jsonrpc": "2.0", "id": 5, "method": "ping", "params": []}': (5, -32602),
    b'{"method": "ping", "params": {"name": "\\ud800"}, "jsonrpc": "2.0", "id": "a"}': ("a", -32600),
    b'{"jsonrpc": "2.0", "id": 1.5, "method": "ping"}': (1.5, -32600),
    b'{"jsonrpc": "2.0", "id": true, "method": "ping"}': (None, -32600),
    b'{"jsonrpc": "2.0", "id": null, "method": "ping"}': (None, -32600),
    b'{"jsonrpc": "2.0", "id": "\\udfff", "method": "ping"}': (None, -32600),
    b'{"params": {"id": 9, "x": "}"}, "jsonrpc": "2.0", "id": 8, "method": "pi\xffng"}': (8, -32600),
    b'{"jsonrpc": "2.0", "id": 8, "params": {': (8, -32600),
    b'{"jsonrpc": "2.0", "id": 8': (None, -32700),
    b'[{"jsonrpc": "2.0", "id": 3, "method": "ping"}]': (3, -32600),
    b"[]": (None, -32600),
    b"7": (None, -32600),
    b"nonsense": (None, -32700),
}


def test_a_refusal_has_the_id_of_its_request_and_says_what_is_wrong(server: RawServer) -> None:
    for line, (own_id, code) in REFUSED.items():
        server.forget()
        server.write(line + b"\n")
        server.wait_for_answers(1)
        [said] = server.answers()
        assert (said["id"], said["error"]["code"]) == (own_id, code), line
        assert said["error"]["message"]


def test_what_asks_for_no_answer_gets_none(server: RawServer) -> None:
    server.write(b'{"jsonrpc": "2.0", "id": 1, "result": []}\n{"jsonrpc": "2.0", "method": "x", "params": []}\n\n')
    server.write(b'{"jsonrpc": "2.0", "id": 1, "error": {"code": "\\ud800"\n')
    assert server.ask("ping")["result"] == {}
    assert len(server.lines()) == 1
