"""The tools of one server: which it offers, why it lacks the others, and a call of one by its name."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from mcp.types import CallToolResult

from ros2_mcp.binding import CallFailed, bind
from ros2_mcp.guard.policy import Policy
from ros2_mcp.model.errors import BadInput
from ros2_mcp.model.names import did_you_mean
from ros2_mcp.ops.memory.bag_store import BagStore
from ros2_mcp.ops.results import Report
from ros2_mcp.ops.sources.kinds import OWN_KINDS
from ros2_mcp.ops.sources.source import SourceKind
from ros2_mcp.robot import Robot
from ros2_mcp.tools import GROUPS, TOOLS, ToolDeclaration

_OTHER_NAMES = {tool.also_named: tool.name for tool in TOOLS if tool.also_named}


class Toolset:
    """The tools that the chosen groups and the policy leave, in the order of `tools/list`.

    A tool that is not allowed is absent, not refused. `by_name` has those that are offered, `missing` says of each
    other why it is not.

    Raises:
        BadInput: for a group that does not exist.
    """

    def __init__(
        self,
        robot: Robot,
        store: BagStore,
        groups: Sequence[str] = (),
        kinds: Sequence[SourceKind] = OWN_KINDS,
    ) -> None:
        for group in groups:
            if group not in (*GROUPS, "default", "all"):
                choices = ", ".join(("default", "all", *GROUPS))
                raise BadInput(f"There is no group of tools {group!r}.", f"Choose from {choices}.")
        allowed = [tool for tool in TOOLS if _is_allowed(tool, robot.policy)]
        # Who opens a recording has all that works on one: it is a short list.
        chosen = [tool for tool in allowed if robot.policy.recorded or _is_chosen(tool, groups)]
        if any(tool.risk != "read" for tool in chosen):  # whatever can set something in motion comes with what stops it
            chosen = [tool for tool in allowed if tool in chosen or tool.risk == "stop"]
        self._left_out = [tool for tool in allowed if tool not in chosen]
        self.by_name = {tool.name: bind(tool, robot, store, kinds, limitations=self.limitations) for tool in chosen}
        self.missing = {
            tool.name: _why_missing(tool, robot.policy, groups) for tool in TOOLS if tool.name not in self.by_name
        }

    @property
    def left_out_groups(self) -> list[str]:
        """The groups with tools that could be offered, and are not."""
        groups = {tool.group for tool in self._left_out}
        return [group for group in GROUPS if group in groups]

    @property
    def limitations(self) -> list[str]:
        """In words, which tools are not offered although they could be, and how to have them."""
        return [
            f"Not offered: {', '.join(tool.name for tool in self._left_out if tool.group == group)}. "
            f"Start the server with --tools default,{group} (or all) to have them."
            for group in self.left_out_groups
        ]

    async def call(
        self, name: str, arguments: Mapping[str, Any], report: Report, robot: Robot | None = None
    ) -> CallToolResult:
        """Calls a tool by its name, or by the one that it has in another server.

        Raises:
            CallFailed: with the text that the model reads.
        """
        tool = self.by_name.get(_OTHER_NAMES.get(name, name))
        if tool:
            return await tool.call(arguments, report, robot)
        if name in self.missing:
            raise CallFailed(f"{name} is not offered: {self.missing[name]}.")
        names = [tool.name for tool in TOOLS]
        raise CallFailed(f"There is no tool {name}. {did_you_mean(name, names, 'tools/list has them all.')}")


def _is_allowed(tool: ToolDeclaration, policy: Policy) -> bool:
    if policy.recorded:
        return tool.recorded
    return tool.risk == "read" or not policy.read_only


def _is_chosen(tool: ToolDeclaration, groups: Sequence[str]) -> bool:
    by_default = tool.by_default and (not groups or "default" in groups)
    return by_default or tool.group in groups or "all" in groups


def _why_missing(tool: ToolDeclaration, policy: Policy, groups: Sequence[str]) -> str:
    if policy.recorded:
        return "the robot of this server is a recording (ros2_bag_info tells what is in it)"
    if policy.read_only and tool.risk != "read":
        return "this server is read-only"
    return f"needs the option --tools {','.join([*(groups or ['default']), tool.group])}"
