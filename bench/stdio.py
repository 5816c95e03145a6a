"""A client of MCP over stdio with negligible cost of its own: one line of JSON per message."""

from __future__ import annotations

import asyncio
import itertools
import json
from collections.abc import Mapping, Sequence
from typing import Any

PROTOCOL = "2025-11-25"
STRUCTURED = "io.github.ros2-mcp/structured"
"""Requests structured content; a copy from `ros2_mcp/mcp/server.py`, whose import takes a second."""
LONGEST_LINE = 64 * 1024 * 1024
LEAVE_S = 5.0


class CallFailed(Exception):
    """Raised if the server answers with an error."""


class StdioClient:
    """One server process and the calls to it; use as an async context manager."""

    def __init__(self, command: Sequence[str], env: Mapping[str, str]) -> None:
        self._command = command
        self._env = env
        self._numbers = itertools.count(1)
        self._open: dict[int, asyncio.Future[dict[str, Any]]] = {}

    async def __aenter__(self) -> StdioClient:
        pipe, nothing = asyncio.subprocess.PIPE, asyncio.subprocess.DEVNULL
        self._process = await asyncio.create_subprocess_exec(
            *self._command, env=self._env, stdin=pipe, stdout=pipe, stderr=nothing, limit=LONGEST_LINE
        )
        self._reading = asyncio.create_task(self._read())
        return self

    async def __aexit__(self, *_: object) -> None:
        self._process.stdin.close()  # type: ignore[union-attr]
        try:
            await asyncio.wait_for(self._process.wait(), LEAVE_S)
        except asyncio.TimeoutError:
            self._process.kill()
            await self._process.wait()
        self._reading.cancel()

    @property
    def pid(self) -> int:
        return self._process.pid

    def owed(self) -> int:
        """Return the number of requests without an answer."""
        return len(self._open)

    async def greet(self) -> list[dict[str, Any]]:
        """Initialize the session; return the list of tools."""
        await self.initialize()
        return (await self.request("tools/list"))["tools"]

    async def initialize(self) -> None:
        """Initialize the session."""
        me = {"name": "bench", "version": "1"}
        await self.request("initialize", protocolVersion=PROTOCOL, capabilities={}, clientInfo=me)
        self._send({"method": "notifications/initialized"})

    async def call(self, tool: str, **arguments: Any) -> dict[str, Any]:
        """Return the structured content of one call."""
        result = await self.request("tools/call", name=tool, arguments=arguments, _meta={STRUCTURED: True})
        if result.get("isError"):
            raise CallFailed(result["content"][0]["text"])
        return result["structuredContent"]

    async def request(self, method: str, **parameters: Any) -> dict[str, Any]:
        number = next(self._numbers)
        answer = self._open[number] = asyncio.get_running_loop().create_future()
        self._send({"id": number, "method": method, "params": parameters})
        message = await answer
        if "error" in message:
            raise CallFailed(message["error"]["message"])
        return message["result"]

    def _send(self, message: dict[str, Any]) -> None:
        self._process.stdin.write(json.dumps({"jsonrpc": "2.0", **message}).encode() + b"\n")  # type: ignore[union-attr]

    async def _read(self) -> None:
        while line := await self._process.stdout.readline():  # type: ignore[union-attr]
            message = json.loads(line)
            answer = self._open.pop(message.get("id"), None)
            if answer and not answer.done():
                answer.set_result(message)
        for answer in self._open.values():
            answer.set_exception(CallFailed("The server has gone."))
