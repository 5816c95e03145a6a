"""An MCP client for the tests: `mcp.Client` over real stdio, called without async."""

from __future__ import annotations

import json
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future
from contextlib import contextmanager
from typing import Any

from anyio.from_thread import BlockingPortal, start_blocking_portal
from mcp import Client, StdioServerParameters
from mcp.types import CallToolResult

from support import rounds
from support.structured import META, read

FULL = rounds.FULL
SERVER = (sys.executable, "-m", "ros2_mcp")
CALL_S = 60.0
DISCOVERY_S = 60.0
"""Two participants that have just started may need several seconds to know all of each other; this only ends a hang."""


def until(check: Callable[[], Any], seconds: float = 45.0) -> Any:
    """What the check gives, as soon as that is true."""
    deadline = time.monotonic() + seconds
    while not (found := check()):
        assert time.monotonic() < deadline, "it never came true"
        time.sleep(0.05)
    return found


class Refusal(Exception):
    """The text of a tool's error, as the model reads it."""


class Agent:
    """Calls tools and gets their structured results."""

    def __init__(self, client: Client, portal: BlockingPortal) -> None:
        self.client = client
        self._portal = portal
        self._schemas: dict[str, dict[str, Any]] = {}

    def call(self, tool: str, **arguments: Any) -> dict[str, Any]:
        """The structured result of a tool; raises `Refusal` with the text of its error."""
        return self.begin(tool, **arguments).result(CALL_S)

    def begin(self, tool: str, **arguments: Any) -> Future[dict[str, Any]]:
        """Start a call; cancelling the future cancels the call."""
        return self._portal.start_task_soon(self._call, tool, arguments)

    def refusal(self, tool: str, **arguments: Any) -> str:
        """The text of the error that the call must end in."""
        try:
            result = self.call(tool, **arguments)
        except Refusal as refusal:
            return str(refusal)
        raise AssertionError(f"{tool} was not refused: {result}")

    def knows(self, *topics: str) -> Agent:
        """Itself, as soon as its server has discovered the topics."""
        deadline = time.monotonic() + DISCOVERY_S
        while True:
            try:
                missing = [topic for topic in topics if not self._lists(topic)]
            except Refusal as refusal:  # a busy machine may need longer for a bridge than its server waits: 20 s
                missing = [str(refusal)]
            if not missing:
                return self
            assert time.monotonic() < deadline, f"not discovered: {missing}"

    def until_answered(self, tool: str, **arguments: Any) -> Agent:
        """Itself, as soon as the call is not refused: as a rule, when the other side has discovered the server too."""
        deadline = time.monotonic() + DISCOVERY_S
        while True:
            try:
                self.call(tool, **arguments)
                return self
            except Refusal as refusal:
                assert time.monotonic() < deadline, str(refusal)

    def whole(self, tool: str, arguments: dict[str, Any], progress: Any = None) -> CallToolResult:
        """The result with its text and pictures; `progress` is called with each report."""
        return self._portal.call(self._whole, tool, arguments, progress)

    def text(self, tool: str, **arguments: Any) -> str:
        """The text that a model reads, error or not: asked for as such clients do, without structured content."""
        result = self._portal.call(self.client.call_tool, tool, arguments)
        assert result.structured_content is None
        return result.content[0].text  # type: ignore[union-attr]

    def ask(self, method: str, *arguments: Any) -> Any:
        """Another request of the client, by the name of its method."""
        return self._portal.call(getattr(self.client, method), *arguments)

    def tools(self) -> dict[str, Any]:
        """Every tool by name."""
        return {tool.name: tool for tool in self._portal.call(self.client.list_tools).tools}

    def _lists(self, topic: str) -> bool:
        listed = self.call("ros2_topic_list", pattern=topic)["topics"]
        return any(entry["topic_name"] == topic for entry in listed)

    async def _call(self, tool: str, arguments: dict[str, Any]) -> dict[str, Any]:
        result = await self._whole(tool, arguments)
        if result.structured_content is None:
            raise Refusal(result.content[0].text)  # type: ignore[union-attr]
        assert json.loads(json.dumps(result.structured_content, allow_nan=False)) is not None
        return read(result.structured_content, self._schemas.get(tool, {}))

    async def _whole(self, tool: str, arguments: dict[str, Any], progress: Any = None) -> CallToolResult:
        if not self._schemas:  # from now on the client validates what it gets against them
            listed = await self.client.list_tools(meta=META)
            self._schemas = {tool.name: tool.output_schema or {} for tool in listed.tools}
        return await self.client.call_tool(tool, arguments, progress_callback=progress, meta=META)


@contextmanager
def agent_for(
    environment: dict[str, str],
    *options: str,
    mode: Any = "auto",
    command: Sequence[str] = SERVER,
    extensions: Sequence[Any] = (),
) -> Iterator[Agent]:
    """A client of a newly started server; both end with the block."""
    server = StdioServerParameters(command=command[0], args=[*command[1:], *options], env=environment)
    with (
        start_blocking_portal() as portal,
        portal.wrap_async_context_manager(
            Client(server, mode=mode, read_timeout_seconds=CALL_S, extensions=extensions)
        ) as client,
    ):
        yield Agent(client, portal)
