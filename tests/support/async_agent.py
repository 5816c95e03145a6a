"""An MCP client for async tests: as `support.agent`, but its calls are awaited, and several can be under way."""

from __future__ import annotations

import asyncio
from typing import Any

from mcp import Client

from support.agent import DISCOVERY_S, Refusal


class AsyncAgent:
    """What a client does with the server."""

    def __init__(self, client: Client) -> None:
        self._client = client

    async def call(self, tool: str, **arguments: Any) -> dict[str, Any]:
        """The structured content of one call."""
        result = await self._client.call_tool(tool, arguments)
        if result.is_error:
            raise Refusal("".join(getattr(block, "text", "") for block in result.content))
        return result.structured_content or {}

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
