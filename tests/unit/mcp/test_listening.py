"""Where clients come in: connections that stall, servers that start at one socket together, sessions of others."""

from __future__ import annotations

import json
import socket
from collections.abc import Mapping
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import anyio
import anyio.lowlevel
import pytest

from ros2_mcp.guard.tokens import ALL, LOGIN, Login
from ros2_mcp.mcp.transports.http import connections
from ros2_mcp.mcp.transports.http.app import _Readable  # pyright: ignore[reportPrivateUsage]
from ros2_mcp.mcp.transports.http.connections import Connections
from ros2_mcp.mcp.transports.sockets import _bound  # pyright: ignore[reportPrivateUsage]
from ros2_mcp.model.errors import BadInput

PATIENCE_S = 30.0


async def test_a_connection_on_which_tls_is_never_negotiated_is_ended(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(connections, "RECEIVE_S", 0.0)
    monkeypatch.setattr(connections, "_LOOK_S", 0.01)
    known = Connections()
    (listener,) = await known.listen("127.0.0.1", 0)
    listener.listen()
    with listener, socket.create_connection(listener.getsockname(), PATIENCE_S) as client:
        listener.setblocking(True)
        accepted, _ = listener.accept()
        with accepted:
            async with anyio.create_task_group() as tasks:
                tasks.start_soon(known.keep)
                assert await anyio.to_thread.run_sync(client.recv, 1) == b""
                tasks.cancel_scope.cancel()


async def test_where_nothing_can_listen_it_is_said() -> None:
    with pytest.raises(BadInput, match="cannot listen at 192"):
        await Connections().listen("192.0.2.1", 9)


def test_of_servers_that_find_a_socket_left_behind_at_the_same_time_one_takes_it(tmp_path: Path) -> None:
    path = tmp_path / "socket"

    def bind(_: int) -> socket.socket | None:
        try:
            return _bound(path)
        except BadInput:
            return None

    with ThreadPoolExecutor(4) as pool:
        for _ in range(50):
            bound = [listener for listener in pool.map(bind, range(4)) if listener]
            assert len(bound) == 1
            bound[0].close()  # what it leaves behind is there for the next ones


async def test_what_another_token_cancels_in_a_session_that_is_not_its_own_is_carried_out() -> None:
    """It is not known yet, while a large request is read, that the session is not its own."""
    reached: list[str] = []

    async def application(scope: Any, receive: Any, send: Any) -> None:
        reached.append(scope[LOGIN].name)

    async def send(_: Any) -> None: ...

    async def post(layer: _Readable, who: str, message: Mapping[str, Any]) -> None:
        body = json.dumps({"jsonrpc": "2.0", **message}).encode()

        async def receive() -> Any:
            return {"type": "http.request", "body": body, "more_body": False}

        headers = [(b"mcp-session-id", b"7"), (b"content-length", str(len(body)).encode())]
        named = {LOGIN: Login(who, ALL), "path": "/mcp", "query_string": b"", "headers": headers}
        await layer({"type": "http", "method": "POST", **named}, receive, send)

    class Nobody:
        """Leases and scopes that mind nothing."""

        def received(self, _: Any) -> None: ...

        def lacking(self, *_: Any) -> str:
            return ""

        def stops(self, *_: Any) -> bool:
            return False

    nobody: Any = Nobody()
    layer = _Readable(application, nobody, nobody)
    large = {"id": 1, "method": "tools/call", "params": {"padding": ["x"] * 100_000}}
    with anyio.fail_after(PATIENCE_S):
        async with anyio.create_task_group() as tasks:
            tasks.start_soon(post, layer, "own", large)
            while not layer._being_read:  # pyright: ignore[reportPrivateUsage]
                await anyio.lowlevel.checkpoint()
            assert not reached
            await post(layer, "other", {"method": "notifications/cancelled", "params": {"requestId": 1}})
    assert reached == ["other", "own"]
