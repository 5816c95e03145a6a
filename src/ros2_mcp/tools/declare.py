"""Declares tools: a typed function with a title, a risk and a group.

Read-only mode, annotations, schemas and documentation are derived from the declaration.
"""

from __future__ import annotations

import inspect
from collections.abc import Awaitable, Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cache
from typing import Any, Literal

from ros2_mcp.guard.policy import Policy
from ros2_mcp.tools.injection import Call, Makers, arguments_of, made_by, values_for
from ros2_mcp_common.policy.verbs import Verb

Risk = Literal["read", "write", "actuate", "stop"]
"""`read` changes nothing; `write` changes the software's state; `actuate` can move the robot; `stop` ends motion and
jobs, and is offered with every tool that does more than read."""

Audience = Literal["model", "page"]
"""The caller of a tool: the model, or in a chat host the page that a tool has opened. No model sees the page's tools.
"""

ToolFunction = Callable[..., Awaitable[Any]]


@dataclass(frozen=True, slots=True)
class ForPage:
    """A result that only the page receives, unchanged; no model reads it. `told` is one line for the host's log."""

    value: Mapping[str, Any]
    told: str


@dataclass(frozen=True, eq=False, kw_only=True)
class ToolDeclaration:
    """One tool as the model sees it.

    - `by_default`: offered without its group being chosen; others come with their group, as models choose well among at
      most forty tools.
    - `aliases`: other spellings of arguments → the right ones, or "" for an argument that is accepted and ignored.
    - `also_named`: another name under which a call is accepted; it is not listed.
    - `recorded`: also works where a recording stands for the robot.
    - `program`: its function in the module `robot` of programs; "" if it is not in the module.
    - `runs_programs`: offered only with an installed sandbox; its description shows the module `robot`; it only reads
      where nothing may be moved.
    - `place`: position in `tools/list`; None: the `PLACE` of its module.
    - `audience`: a tool for the page returns `ForPage`.
    - `opens_page`: its page is shown in the chat.
    - `does`: what a policy must allow for the tool to be useful: verb → types, of which one is enough (none: any).
    - `beside`: other tool → a sentence added to the description if that tool is offered.
    - `finds`: at most fifteen words with which a person asks for it: some clients show a tool only after a search.
    - `always_loaded`: the tool should be available without such a search.
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
    program: str = ""
    runs_programs: bool = False
    place: int | None = None
    audience: Audience = "model"
    opens_page: bool = False
    does: Mapping[Verb, Sequence[str]] = field(default_factory=dict[Verb, Sequence[str]])
    beside: Mapping[str, str] = field(default_factory=dict[str, str])
    finds: str = ""
    always_loaded: bool = False

    def is_of_use(self, policy: Policy) -> bool:
        """Whether the policy allows any act of this tool."""
        rules = policy.rules
        return not (rules and self.does) or any(rules.may(verb, types) for verb, types in self.does.items())

    @property
    def description(self) -> str:
        """The function's docstring: the text that the model reads first."""
        return inspect.cleandoc(self.function.__doc__ or "")

    def description_beside(self, offered: Collection[str]) -> str:
        """Return the description, with the sentences about other tools that are `offered`."""
        beside = (sentence for name, sentence in self.beside.items() if name in offered)
        return " ".join((self.description, *beside))

    @cache  # noqa: B019 - declarations live as long as the process
    def signature(self) -> inspect.Signature:
        """Return the function's signature with evaluated annotations."""
        return inspect.signature(self.function, eval_str=True)

    @cache  # noqa: B019 - as above; it is needed with each call
    def makers(self) -> Makers:
        """Return how the value of each parameter is made."""
        return {name: made_by(parameter) for name, parameter in self.signature().parameters.items()}

    def arguments(self) -> inspect.Signature:
        """Return the signature that the model sees, without injected parameters."""
        return arguments_of(self.signature())

    async def perform(self, call: Call, arguments: Mapping[str, Any]) -> Any:
        """Call the function with validated arguments and injected values; raises the `RobotError`s of the function."""
        return await self.function(**await values_for(self.makers(), call, arguments))


DECLARED: list[ToolDeclaration] = []
"""All tools in the order of their declaration."""


def tool(
    *,
    title: str,
    risk: Risk,
    group: str = "core",
    by_default: bool = True,
    aliases: Mapping[str, str] | None = None,
    also_named: str = "",
    recorded: bool = False,
    program: str = "",
    runs_programs: bool = False,
    place: int | None = None,
    audience: Audience = "model",
    opens_page: bool = False,
    does: Mapping[Verb, Sequence[str]] | None = None,
    beside: Mapping[str, str] | None = None,
    finds: str = "",
    always_loaded: bool = False,
) -> Callable[[ToolFunction], ToolFunction]:
    """Declare the decorated function as a tool with the same name; its arguments are fields of `ToolDeclaration`."""

    def declare(function: ToolFunction) -> ToolFunction:
        DECLARED.append(
            ToolDeclaration(
                function=function,
                name=function.__name__,
                title=title,
                risk=risk,
                group=group,
                by_default=by_default,
                aliases=aliases or {},
                also_named=also_named,
                recorded=recorded,
                program=program,
                runs_programs=runs_programs,
                place=place,
                audience=audience,
                opens_page=opens_page,
                does=does or {},
                beside=beside or {},
                finds=finds,
                always_loaded=always_loaded,
            )
        )
        return function

    return declare
