"""A client of MCP over HTTP with negligible cost of its own: one connection that is kept open, one call at a time."""

from __future__ import annotations

import asyncio
import itertools
import json
from typing import Any

from .stdio import LONGEST_LINE, PROTOCOL, STRUCTURED, CallFailed


class HttpClient:
    """One session of a server on this machine; use as an async context manager."""

    def __init__(self, port: int, token: str) -> None:
        self._port = port
        self._always = {
            "Host": f"127.0.0.1:{port}",
            "Authorization": f"Bearer {token}",
            "Accept": "application/json, text/event-stream",
            "Content-Type": "application/json",
        }
        self._numbers = itertools.count(1)

    async def __aenter__(self) -> HttpClient:
        await self._connect()
        asked = {"protocolVersion": PROTOCOL, "capabilities": {}, "clientInfo": {"name": "bench", "version": "1"}}
        _, named = await self._post({"id": 0, "method": "initialize", "params": asked})
        self._always["Mcp-Session-Id"] = named["mcp-session-id"]
        await self._post({"method": "notifications/initialized"})
        return self

    async def __aexit__(self, *_: object) -> None:
        self._writer.close()

    async def call(self, tool: str, **arguments: Any) -> dict[str, Any]:
        """Return the structured content of one call."""
        params = {"name": tool, "arguments": arguments, "_meta": {STRUCTURED: True}}
        request = {"id": next(self._numbers), "method": "tools/call", "params": params}
        body, _ = await self._post(request)
        lines = body.decode().splitlines()
        told = [line.removeprefix("data:") for line in lines if line.startswith("data:")] or [body.decode()]
        answer = json.loads(told[-1])
        result = answer.get("result", {"isError": True, "content": [{"text": str(answer)}]})
        if result.get("isError"):
            raise CallFailed(result["content"][0]["text"])
        return result["structuredContent"]

    async def _connect(self) -> None:
        self._reader, self._writer = await asyncio.open_connection("127.0.0.1", self._port, limit=LONGEST_LINE)

    async def _post(self, message: dict[str, Any]) -> tuple[bytes, dict[str, str]]:
        """Send a message; return the body and the headers of the response."""
        if self._reader.at_eof():  # the server closes connections that were idle for some seconds
            self._writer.close()
            await self._connect()
        body = json.dumps({"jsonrpc": "2.0", **message}).encode()
        headers = "".join(f"{name}: {value}\r\n" for name, value in self._always.items())
        self._writer.write(f"POST /mcp HTTP/1.1\r\n{headers}Content-Length: {len(body)}\r\n\r\n".encode() + body)
        first, *lines = (await self._reader.readuntil(b"\r\n\r\n")).decode().split("\r\n")
        named = {name.lower(): value for name, _, value in (line.partition(": ") for line in lines if line)}
        if named.get("transfer-encoding") == "chunked":
            content = await self._chunks()
        else:
            content = await self._reader.readexactly(int(named.get("content-length", 0)))
        if " 20" not in first:
            raise CallFailed(f"{first}: {content[:500].decode()}")
        return content, named

    async def _chunks(self) -> bytes:
        content = b""
        while size := int(await self._reader.readline(), 16):
            content += await self._reader.readexactly(size)
            await self._reader.readline()
        await self._reader.readline()
        return content
