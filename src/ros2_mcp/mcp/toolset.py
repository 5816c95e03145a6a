"""The tools of one robot: which are offered, why others are not, and calls by name."""

from __future__ import annotations

import re
from collections.abc import Collection, Mapping, Sequence
from dataclasses import replace
from functools import cache
from typing import Any

from mcp.types import CallToolResult

from ros2_mcp.guard.audit import called_through
from ros2_mcp.guard.policy import Policy
from ros2_mcp.mcp.binding import BoundTool, CallFailed, bind
from ros2_mcp.mcp.program_functions import function_of
from ros2_mcp.model.commands import LOCAL, Principal
from ros2_mcp.model.errors import BadInput
from ros2_mcp.model.names import did_you_mean
from ros2_mcp.ops.memory.bag_store import BagStore
from ros2_mcp.ops.results.results import Report
from ros2_mcp.ops.sources.kinds import OWN_KINDS
from ros2_mcp.ops.sources.source import SourceKind
from ros2_mcp.programs.declare import Function
from ros2_mcp.programs.module import FUNCTIONS
from ros2_mcp.programs.sandbox import is_installed
from ros2_mcp.programs.stub import short
from ros2_mcp.robot import Robot
from ros2_mcp.robot.session import Session
from ros2_mcp.tools import GROUPS, PAGE_TOOLS, TOOLS, ToolDeclaration
from ros2_mcp.tools.declare import Risk
from ros2_mcp.view.viewing import Viewing

_TOOL = re.compile(r"\bros2_\w+")
_OTHER_NAMES = {tool.also_named: tool.name for tool in TOOLS if tool.also_named}


_VIEW = "view"
"""The group of the page beside the chat. Unless chosen, it is listed only for clients that show pages."""

_NOT_ALLOWED = "The policy of this server allows nothing that this tool does (ros2_policy)."
_BESIDE = {"turn": "drive", "feedback": "goal"}
"""Functions that only programs have, each with the tool's function that it needs."""


class Toolset:
    """The tools that remain after the choice of groups and the policy, in the order of `tools/list`.

    A tool that is not allowed is absent, not refused. `by_name` are the offered tools. `missing` gives, for each other
    tool, the reason. `with_pages` are tools that only clients that show pages beside the chat are offered.

    Raises:
        BadInput: for a group that does not exist.
    """

    def __init__(
        self,
        robot: Robot,
        store: BagStore,
        groups: Sequence[str] = (),
        kinds: Sequence[SourceKind] = OWN_KINDS,
        warnings: Sequence[str] = (),
        viewing: Viewing | None = None,
    ) -> None:
        self.viewing = viewing
        self._warnings = warnings
        self._robot = robot
        for group in groups:
            if group not in (*GROUPS, "default", "all"):
                choices = ", ".join(("default", "all", *GROUPS))
                raise BadInput(f"There is no group of tools {group!r}.", f"Choose from {choices}.")
        self._store, self._kinds = store, kinds
        allowed = [_as_allowed(tool, robot.policy) for tool in TOOLS if _is_allowed(tool, robot.policy)]
        # For a recording, all tools that work on one are offered: they are few.
        chosen = [tool for tool in allowed if robot.policy.recorded or _is_chosen(tool, groups)]
        if any(tool.risk != "read" for tool in chosen):  # tools that start motion come with the stop
            chosen = [tool for tool in allowed if tool in chosen or tool.risk == "stop"]
        beside: list[ToolDeclaration] = []
        if viewing and (robot.policy.recorded or not groups or not {"default", "all", _VIEW}.isdisjoint(groups)):
            beside = [tool for tool in (*TOOLS, *PAGE_TOOLS) if tool.group == _VIEW and tool not in chosen]
        self._left_out = [tool for tool in allowed if tool not in chosen and tool not in beside]
        self.with_pages = {tool.name: self._bind(tool) for tool in beside}
        self._allowed = allowed
        self.by_name = {tool.name: self._bind(tool) for tool in chosen}
        self._groups, self._policy = groups or ("default",), robot.policy
        for tool in self.by_name.values():
            tool.listed.description = tool.declaration.description_beside(self.by_name)
            if not tool.declaration.is_of_use(robot.policy):
                tool.listed.description += f"\n\n{_NOT_ALLOWED}"
            if tool.declaration.runs_programs:
                tool.listed.description += f"\n\n{short(self.functions())}"
        self.missing = {tool.name: self.why_missing([tool.name]) for tool in TOOLS if tool.name not in self.by_name}

    def _bind(self, tool: ToolDeclaration) -> BoundTool:
        return bind(
            tool,
            self._robot,
            self._store,
            self._kinds,
            limitations=self.limitations,
            only_offered=self._only_offered,
            functions=self.functions,
            viewing=self.viewing,
        )

    @cache  # noqa: B019 - a toolset lives as long as its server
    def functions(self) -> Sequence[Function]:
        """Return the functions of the module `robot`: the functions that only programs have, and the allowed tools of
        the offered groups.
        """
        groups = {tool.declaration.group for tool in self.by_name.values()}
        tools = [function_of(self._bind(tool)) for tool in self._allowed if tool.program and tool.group in groups]
        may_act, recorded = not self._robot.policy.read_only, self._robot.policy.recorded
        names = {"", *(each.name for each in tools)}
        own = [each for each in FUNCTIONS if (may_act or each.risk == "read") and _BESIDE.get(each.name, "") in names]
        own = [each for each in own if each.recorded or not recorded]
        return [*own, *tools]

    @property
    def left_out_groups(self) -> list[str]:
        """The groups with tools that are allowed, but not offered."""
        groups = {tool.group for tool in self._left_out}
        return [group for group in GROUPS if group in groups]

    @property
    def limitations(self) -> list[str]:
        """Limitations in words: warnings about the settings, and tools that are allowed but not offered."""
        return list(self._warnings) + [
            f"Not offered: {', '.join(tool.name for tool in self._left_out if tool.group == group)}. "
            f"Start the server with --tools default,{group} (or all) to have them."
            for group in self.left_out_groups
        ]

    def why_missing(self, names: Collection[str]) -> str:
        """Return why these tools are not offered, as the end of a sentence."""
        tools = [tool for tool in TOOLS if tool.name in names]
        if any(tool.runs_programs for tool in tools) and not is_installed():
            return "the extra `programs` is not installed (ros2-mcp doctor shows the command)"
        if self._policy.recorded:
            return "the robot of this server is a recording (ros2_bag_info shows what is in it)"
        if self._policy.read_only and any(tool.risk != "read" for tool in tools):
            return "this server is read-only"
        groups = dict.fromkeys((*self._groups, *(tool.group for tool in tools)))
        return f"the option --tools {','.join(groups)} is needed"

    def note_refusal(self, name: str, reason: str, principal: Principal) -> None:
        """Note in the audit that a call of a tool that acts was refused before it reached the guard."""
        if self.risk_of(name) in ("write", "actuate") and (audit := self._robot.guard.audit):
            who = {"principal": principal.name, "transport": principal.transport, "login": principal.login}
            with called_through(_OTHER_NAMES.get(name, name)):
                audit.note("refused", **who, reason=reason)

    def risk_of(self, name: str) -> Risk:
        """Return the risk of a tool, offered or not; `read` for an unknown name."""
        for tool in (*TOOLS, *PAGE_TOOLS):
            if tool.name == _OTHER_NAMES.get(name, name):
                return tool.risk
        return "read"

    def _only_offered(self, text: str) -> str:
        """Return a hint or a note, with the tools in it that are not offered listed at its end, and how to get them."""
        absent = self.missing.keys() & set(_TOOL.findall(text))
        if not absent:
            return text
        return f"{text.rstrip()} (Not offered here: {', '.join(sorted(absent))}; {self.why_missing(absent)}.)"

    def offered(self, name: str) -> BoundTool | None:
        """Return the tool of that name, or of that alias from another server; None if it is not offered."""
        own_name = _OTHER_NAMES.get(name, name)
        return self.by_name.get(own_name) or self.with_pages.get(own_name)

    async def call(
        self,
        name: str,
        arguments: Mapping[str, Any],
        report: Report,
        session: Session | None = None,
        *,
        shows_pages: bool = False,
    ) -> CallToolResult:
        """Call a tool by its name, or by its alias from another server.

        Raises:
            CallFailed: with the text that the model reads.
        """
        tool = self.offered(name)
        with called_through(_OTHER_NAMES.get(name, name)) as call:
            try:
                if tool:
                    return await tool.call(arguments, report, session, shows_pages=shows_pages)
                own_name = _OTHER_NAMES.get(name, name)
                if own_name in self.missing:
                    raise CallFailed(f"{own_name} is not offered: {self.missing[own_name]}.")
            except CallFailed as error:
                if not call.has_line:  # it did not reach the guard
                    self.note_refusal(name, str(error), session.principal if session else LOCAL)
                raise
        names = [tool.name for tool in TOOLS]
        raise CallFailed(f"There is no tool {name}. {did_you_mean(name, names, 'tools/list has them all.')}")


def _is_allowed(tool: ToolDeclaration, policy: Policy) -> bool:
    if tool.runs_programs and not is_installed():
        return False
    if policy.recorded:
        return tool.recorded
    return tool.risk == "read" or tool.runs_programs or not policy.read_only


def _as_allowed(tool: ToolDeclaration, policy: Policy) -> ToolDeclaration:
    """Return the tool as this policy allows it: a tool that runs programs only reads if nothing may be moved."""
    return replace(tool, risk="read") if tool.runs_programs and (policy.recorded or policy.read_only) else tool


def _is_chosen(tool: ToolDeclaration, groups: Sequence[str]) -> bool:
    by_default = tool.by_default and (not groups or "default" in groups)
    return by_default or tool.group in groups or "all" in groups
