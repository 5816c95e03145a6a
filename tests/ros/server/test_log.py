"""MCP's logging over both transports: the server's log goes to the session that asked for it, from its level on."""

from __future__ import annotations

from contextlib import AbstractAsyncContextManager
from typing import Any

import anyio
import pytest
from mcp import Client
from mcp.types import LoggingMessageNotificationParams

from support.ports import listening
from support.tokens import client_at

MISSPELT = "ros2_topic_list failed: "
PATIENCE_S = 20.0


def test_over_stdio_what_fails_is_told_from_the_level_on_that_was_asked_for_and_stderr_keeps_its_own(start_raw) -> None:
    server = start_raw()
    introduction = server.begin("2025-11-25")
    assert introduction["capabilities"]["logging"] == {}
    assert server.call("ros2_topic_list", patern="x")["isError"]
    assert messages(server) == []
    for level in ("info", "warning"):
        assert server.ask("logging/setLevel", level=level)["result"] == {}
        assert server.call("ros2_topic_list", patern="x")["isError"]
        server.call("ros2_status")
    (told,) = [params for params in messages(server) if params["data"].startswith(MISSPELT)]
    assert (told["level"], told["logger"]) == ("info", "ros2_mcp.mcp.server")
    assert server.ask("logging/setLevel", level="loud")["error"]["code"] == -32602
    server.ask("logging/setLevel", level="debug")
    assert server.call("ros2_topic_list", patern="x")["isError"]
    server.close()
    server.errors.seek(0)
    assert MISSPELT.encode() not in server.errors.read()


def messages(server: Any) -> list[Any]:
    return [line["params"] for line in server.lines() if line.get("method") == "notifications/message"]


@pytest.mark.filterwarnings("ignore:The logging capability is deprecated")
async def test_over_http_it_goes_to_the_session_that_asked_alone(ros_environment) -> None:
    told: dict[str, list[Any]] = {"asks": [], "silent": []}

    def client(name: str) -> AbstractAsyncContextManager[Client]:
        async def take(params: LoggingMessageNotificationParams) -> None:
            told[name].append(params.data)

        return client_at(f"http://127.0.0.1:{port}/mcp", mode="legacy", logging_callback=take)

    with listening(ros_environment, "streamable-http") as (port, _):
        async with client("silent") as silent, client("asks") as asks:
            await asks.set_logging_level("info")
            with anyio.fail_after(PATIENCE_S):
                while not told["asks"]:  # its listening stream may not be open yet
                    await silent.call_tool("ros2_topic_list", {"patern": "x"})
                    await anyio.sleep(0.1)
    assert told["asks"][0].startswith(MISSPELT) and told["silent"] == []
