"""An MCP client for async tests: as `support.agent`, but its calls are awaited, and several can be under way."""

from __future__ import annotations

import asyncio
from typing import Any

from mcp import Client

from support.agent import DISCOVERY_S, Refusal
from support.structured import META, read


class AsyncAgent:
    """What a client does with the server."""

    def __init__(self, client: Client) -> None:
        self._client = client
        self._schemas: dict[str, dict[str, Any]] = {}

    async def call(self, tool: str, **arguments: Any) -> dict[str, Any]:
        """The structured content of one call."""
        if not self._schemas:
            listed = await self._client.list_tools(meta=META)
            self._schemas = {tool.name: tool.output_schema or {} for tool in listed.tools}
        result = await self._client.call_tool(tool, arguments, meta=META)
        if result.structured_content is None:
            raise Refusal("".join(getattr(block, "text", "") for block in result.content))
        return read(result.structured_content, self._schemas.get(tool, {}))

    async def knows(self, topic: str, publishers: int = 1, subscribers: int = 0) -> dict[str, Any]:
        """Waits until the server sees that many endpoints on the topic; returns the topic's information."""
        loop = asyncio.get_running_loop()
        deadline = loop.time() + DISCOVERY_S
        seen: object = None
        while loop.time() < deadline:
            try:
                info = seen = await self.call("ros2_topic_info", topic_name=topic)
                if len(info["publishers"]) >= publishers and len(info["subscribers"]) >= subscribers:
                    return info
            except Refusal as refusal:
                seen = refusal
            await asyncio.sleep(0.05)
        raise AssertionError(f"{topic} is not known in {DISCOVERY_S:.0f} s: {seen}")
