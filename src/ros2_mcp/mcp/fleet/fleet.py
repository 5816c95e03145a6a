"""The robots of one server and their tools (decision 36).

With one robot everything is as if there were no fleet. With several each tool needs `robot`, the name of one: there is
no default and no current robot, for a wrong one would move the wrong machine.
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
"""Robots in one error text."""


class Fleet:
    """The robots of one server, in the order in which they were named; at least one.

    `listed` are the tools for all clients, `listed_with_pages` those for clients that show pages beside the chat.
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
        """What a tool takes; None where it is not offered."""
        return self._schemas.get(tool)

    def acts(self, tool: str) -> bool:
        """Whether it is offered, and can change or move something, or stop it."""
        found = (member.toolset.offered(tool) for member in self.members.values())
        return any(bound.acts for bound in found if bound)

    def named_in(self, arguments: Mapping[str, Any]) -> str:
        """The robot that a call names; empty where there is one only, or it names none that there is."""
        named = arguments.get(ROBOT) if self.has_several else None
        return named if isinstance(named, str) and named in self.members else ""

    # ── calls ──────────────────────────────────────────────────────────────────────────────────────────────────

    async def call_all(self, tool: str, arguments: Mapping[str, Any], client: str) -> CallToolResult | None:
        """The answer of a tool that is about all robots, to the client of that name; None for any other.

        A stop of a robot that there is not stops all: whoever calls it wants something to stand.
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
        """The robot that a call is about, and the arguments for it.

        Raises:
            CallFailed: naming the robots that there are, if none of them is named.
        """
        if not self.has_several:
            return self.first, arguments
        if not any(tool in (declared.name, declared.also_named) for declared in (*TOOLS, *PAGE_TOOLS)):
            return self.first, arguments  # its toolset says so
        rest = dict(arguments)
        named = rest.pop(ROBOT, None)
        if named is None:
            raise CallFailed(f"{tool} needs the argument {ROBOT!r}: {self._names}.")
        return self.find(named), rest

    def find(self, named: object) -> Member:
        """The robot of that name; raises `CallFailed` with the names that there are."""
        if isinstance(named, str) and named in self.members:
            member = self.members[named]
            member.robot.log.start()  # from its first use on: what comes before is not kept
            return member
        near = did_you_mean(str(named), list(self.members), "")
        told = (f"There is no robot {quoted(str(named))}.", near, f"There are: {self._names}.")
        raise CallFailed(" ".join(filter(None, told)))

    @property
    def _names(self) -> str:
        return listed(list(self.members), _MOST_NAMED)

    def told_of(self, member: Member, result: CallToolResult) -> CallToolResult:
        """A result that says which robot it is about, where there are several."""
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

    # ── its life ───────────────────────────────────────────────────────────────────────────────────────────────

    @asynccontextmanager
    async def running(self) -> AsyncGenerator[None, None]:
        """While it is entered the bridges are there: that of the only robot from now on, others when they are first
        used. At the end all work on all robots is ended at the same time.
        """
        if not self.has_several and not self.first.store.subject:
            await self.first.robot.attach()
        try:
            yield
        finally:
            ended: Sequence[BaseException | None] = ()
            with anyio.CancelScope(shield=True):  # who is cancelled leaves the robots stopped all the same
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
