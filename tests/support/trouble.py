"""The real server as a client sees it, and the peers that give it trouble."""

from __future__ import annotations

import asyncio
import contextlib
import os
import subprocess
from pathlib import Path
from typing import Any

from mcp import Client

from support.processes import peer_command

FULL = os.environ.get("ROS2_MCP_FULL") == "1"


class ToolFailed(Exception):
    """The tool answered with an error; the text is what the model reads."""


class Agent:
    """What a client does with the server."""

    def __init__(self, client: Client) -> None:
        self._client = client

    async def call(self, tool: str, **arguments: Any) -> dict[str, Any]:
        """The structured content of one call."""
        result = await self._client.call_tool(tool, arguments)
        if result.is_error:
            raise ToolFailed("".join(getattr(block, "text", "") for block in result.content))
        return result.structured_content or {}

    async def knows(self, topic: str, publishers: int = 1, subscribers: int = 0) -> dict[str, Any]:
        """Waits until the server sees that many endpoints on the topic; returns the topic's information."""
        while True:
            with contextlib.suppress(ToolFailed):
                info = await self.call("ros2_topic_info", topic_name=topic)
                if len(info["publishers"]) >= publishers and len(info["subscribers"]) >= subscribers:
                    return info
            await asyncio.sleep(0.05)


class Peer:
    """A node of `faulty_peer`."""

    def __init__(self, environment: dict[str, str], arguments: tuple[str, ...]) -> None:
        self.process = subprocess.Popen(
            peer_command("faulty_peer", *arguments),
            env=environment,
            stdout=subprocess.PIPE,
            text=True,
        )

    def line(self) -> str:
        assert self.process.stdout
        return self.process.stdout.readline().strip()

    def end(self) -> None:
        """Wait until it has left."""
        self.process.communicate(timeout=30)


def count_threads_and_files(pid: int) -> dict[str, int]:
    """How many threads a process has, and how many files it has open."""
    return {what: len(list(Path(f"/proc/{pid}/{what}").iterdir())) for what in ("task", "fd")}


def parent_of(pid: int) -> int:
    """The process that started this one."""
    return int(Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[1])
