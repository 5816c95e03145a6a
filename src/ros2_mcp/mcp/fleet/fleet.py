"""The robots of one server and their tools (decision 36).

With one robot, the tools are those of a single server. With several, each tool needs the argument `robot`. There is no
default and no current robot, because a wrong one would move the wrong machine.
"""

from __future__ import annotations

import asyncio
from collections.abc import AsyncGenerator, Mapping, Sequence
from contextlib import asynccontextmanager
from typing import Any

import anyio
from mcp.types import CallToolResult, TextContent, Tool

from ros2_mcp.mcp.binding import SUMMARY, CallFailed, answer
from ros2_mcp.mcp.fleet import about_all
from ros2_mcp.mcp.fleet.about_all import ROBOTS, STOP
from ros2_mcp.mcp.fleet.listing import ROBOT, listed_tools, listed_with_pages
from ros2_mcp.mcp.fleet.member import Member
from ros2_mcp.model.names import did_you_mean
from ros2_mcp.model.text import listed, quoted
from ros2_mcp.tools import PAGE_TOOLS, TOOLS

_MOST_NAMED = 15
"""The most robots that one error text names."""


class Fleet:
    """The robots of one server, in the order in which they were named; at least one.

    `listed` are the tools for all clients. `listed_with_pages` are the tools for clients that show pages beside the
    chat.
    """

    def __init__(self, members: Sequence[Member]) -> None:
        self.members = {member.name: member for member in members}
        self.first = members[0]
        self.has_several = len(members) > 1
        one = self.first.toolset
        self.listed: list[Tool] = (
            listed_tools(members) if self.has_several else [tool.listed for tool in one.by_name.values()]
        )
        self.listed_with_pages: list[Tool] = self.listed + (
            listed_with_pages(members) if self.has_several else [tool.listed for tool in one.with_pages.values()]
        )
        self._schemas = {tool.name: tool.input_schema for tool in self.listed_with_pages}

    def input_schema(self, tool: str) -> dict[str, Any] | None:
        """Return the schema of a tool's arguments; None if it is not offered."""
        return self._schemas.get(tool)

    def acts(self, tool: str) -> bool:
        """Return whether a tool is offered and can change, move or stop something."""
        found = (member.toolset.offered(tool) for member in self.members.values())
        return any(bound.acts for bound in found if bound)

    def named_in(self, arguments: Mapping[str, Any]) -> str:
        """Return the name of the robot that a call names; "" if there is only one robot, or no robot of that name."""
        named = arguments.get(ROBOT) if self.has_several else None
        return named if isinstance(named, str) and named in self.members else ""

    # ── calls ──────────────────────────────────────────────────────────────────────────────────────────────────

    async def call_all(self, tool: str, arguments: Mapping[str, Any], client: str) -> CallToolResult | None:
        """Return the answer of a tool for all robots, or None for any other tool. `client` is the name of the
        principal.

        A stop that names an unknown robot stops all of them: its caller wants something to stop.
        """
        if not self.has_several or tool not in (ROBOTS, STOP):
            return None
        if tool == ROBOTS:
            if arguments:
                raise CallFailed(f"{ROBOTS} has no argument {quoted(next(iter(arguments)))}.")
            result = await about_all.states([*self.members.values()])
            return answer(result)
        named = arguments.get(ROBOT)
        chosen, told = (
            [*self.members.values()],
            [f"{STOP} has no argument {quoted(name)}: ignored." for name in arguments if name != ROBOT],
        )
        if isinstance(named, str) and named in self.members:
            chosen = [self.members[named]]
        elif named is not None:
            told.insert(0, f"There is no robot {quoted(str(named))}: all were told to stop.")
        stopped = await about_all.stop(chosen, client, " ".join(told[:_MOST_NAMED]))
        return answer(stopped)

    def choose(self, tool: str, arguments: Mapping[str, Any]) -> tuple[Member, Mapping[str, Any]]:
        """Return the robot that a call names, and the arguments without `robot`.

        Raises:
            CallFailed: if no known robot is named. It lists the names of the robots.
        """
        if not self.has_several:
            return self.first, arguments
        if not any(tool in (declared.name, declared.also_named) for declared in (*TOOLS, *PAGE_TOOLS)):
            return self.first, arguments  # its toolset raises the error
        rest = dict(arguments)
        named = rest.pop(ROBOT, None)
        if named is None:
            raise CallFailed(f"{tool} needs the argument {ROBOT!r}: {self._names}.")
        return self.find(named), rest

    def find(self, named: object) -> Member:
        """Return the robot of that name. Raises `CallFailed` with the known names."""
        if isinstance(named, str) and named in self.members:
            member = self.members[named]
            member.robot.log.start()  # /rosout is subscribed to from the first use on; earlier lines are not kept
            return member
        near = did_you_mean(str(named), list(self.members), "")
        told = (f"There is no robot {quoted(str(named))}.", near, f"There are: {self._names}.")
        raise CallFailed(" ".join(filter(None, told)))

    @property
    def _names(self) -> str:
        return listed(list(self.members), _MOST_NAMED)

    def told_of(self, member: Member, result: CallToolResult) -> CallToolResult:
        """Return the result with the name of its robot, if there are several robots."""
        if not self.has_several:
            return result
        said = f"Robot {member.name}: "
        structured: dict[str, Any] = {ROBOT: member.name, **(result.structured_content or {})}
        if summary := structured.pop(SUMMARY, ""):
            structured = {SUMMARY: f"{said}{summary}", **structured}
        content = list(result.content)
        for place, block in enumerate(content):
            if isinstance(block, TextContent):
                content[place] = TextContent(type="text", text=f"{said}{block.text}")
                break
        return CallToolResult(content=content, structured_content=structured, is_error=result.is_error)

    # ── start and end ──────────────────────────────────────────────────────────────────────────────────────────

    @asynccontextmanager
    async def running(self) -> AsyncGenerator[None, None]:
        """Within this context, the bridges run: the bridge of an only robot from the beginning, the bridges of several
        robots from their first use. On exit, end all work on all robots at the same time.
        """
        if not self.has_several and not self.first.store.subject:
            await self.first.robot.attach()
        try:
            yield
        finally:
            ended: Sequence[BaseException | None] = ()
            with anyio.CancelScope(shield=True):  # even if cancelled, the robots have to be stopped
                leaving = [self._leave(member) for member in self.members.values()]
                ended = await asyncio.gather(*leaving, return_exceptions=True)
            for error in filter(None, ended):
                raise error

    async def _leave(self, member: Member) -> None:
        if viewing := member.toolset.viewing:
            await viewing.close()
        if self.has_several:
            await member.robot.log.close()
        try:
            await member.robot.leave()
        finally:
            await member.store.close()
