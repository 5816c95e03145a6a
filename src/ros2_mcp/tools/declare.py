"""How a tool is declared: one typed function, one word for its risk, one for its group.

Read-only mode, annotations, schemas and documentation follow from the declaration.
"""

from __future__ import annotations

import inspect
from collections.abc import Awaitable, Callable, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, Literal

from ros2_mcp.ops.memory import Memory
from ros2_mcp.ops.results import Report
from ros2_mcp.robot import Robot

Risk = Literal["read", "write", "actuate"]
"""`read` changes nothing; `write` changes the software's state; `actuate` can move the robot."""

ToolFunction = Callable[..., Awaitable[Any]]


@dataclass(frozen=True)
class ToolDeclaration:
    """One tool as the model sees it.

    `aliases` maps other spellings of its arguments to the right ones. Tools that are not offered `by_default` come
    with their group: models choose best among about thirty. A call of `also_named` is answered too; it is not listed.
    `recorded` tools also work where a recording stands for the robot.
    """

    function: ToolFunction
    name: str
    title: str
    risk: Risk
    group: str
    by_default: bool = True
    aliases: Mapping[str, str] = field(default_factory=dict[str, str])
    also_named: str = ""
    recorded: bool = False

    @cached_property
    def injected(self) -> dict[str, Any]:
        """Parameters that the model does not see, with what they want: robot, memory, or report of progress."""
        parameters = self.signature().parameters.values()
        return {p.name: p.annotation for p in parameters if p.annotation in (Robot, Memory, Report)}

    @property
    def description(self) -> str:
        """What the model reads: the function's docstring."""
        return inspect.cleandoc(self.function.__doc__ or "")

    def signature(self) -> inspect.Signature:
        """The function's signature with its annotations evaluated."""
        return inspect.signature(self.function, eval_str=True)

    def arguments(self) -> inspect.Signature:
        """The signature that the model sees: without what is injected."""
        whole = self.signature()
        given = [p for p in whole.parameters.values() if p.name not in self.injected]
        return whole.replace(parameters=given)


DECLARED: list[ToolDeclaration] = []
"""Every tool, in the order of declaration."""


def tool(
    *,
    title: str,
    risk: Risk,
    group: str = "core",
    by_default: bool = True,
    aliases: Mapping[str, str] | None = None,
    also_named: str = "",
    recorded: bool = False,
) -> Callable[[ToolFunction], ToolFunction]:
    """Declares the function as a tool of the same name."""

    def declare(function: ToolFunction) -> ToolFunction:
        DECLARED.append(
            ToolDeclaration(
                function, function.__name__, title, risk, group, by_default, aliases or {}, also_named, recorded
            )
        )
        return function

    return declare
