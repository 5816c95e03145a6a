"""How a tool is declared: one typed function, one word for its risk, one for its group.

Read-only mode, annotations, schemas and documentation follow from the declaration.
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
"""`read` changes nothing; `write` changes the software's state; `actuate` can move the robot; `stop` ends what was set
in motion, and is offered wherever a tool is that does more than read.
"""

Audience = Literal["model", "page"]
"""Who calls a tool: the model, or in a chat host the page that a tool has opened, which no model sees."""

ToolFunction = Callable[..., Awaitable[Any]]


@dataclass(frozen=True, slots=True)
class ForPage:
    """A result for the page alone, as it is: no model reads it. `told` is one line for the host's log."""

    value: Mapping[str, Any]
    told: str


@dataclass(frozen=True, eq=False, kw_only=True)
class ToolDeclaration:
    """One tool as the model sees it.

    `aliases` maps other spellings of its arguments to the right ones, and to nothing what is taken and has no meaning
    here. Tools that are not offered `by_default` come with their group: models choose well among at most forty. A call
    of `also_named` is answered too; it is not listed. `recorded` tools also work where a recording stands for the
    robot. `program` is the name of the function that they are in the module `robot` of programs; without one they are
    not in it. One that `runs_programs` is there where the sandbox is installed, its description shows the module, and
    where nothing may be moved it only reads. `place` is where the tool stands in `tools/list`; None: at the `PLACE` of
    its module. A tool whose `audience` is the page gives `ForPage`; one that `opens_page` has it shown beside the chat.
    `does` is what a policy must allow for it to be of any use: by verb the types, of which one is enough (none: any).
    `beside` are sentences at the end of the description that name another tool, by that tool: where it is offered, too.
    `finds` are words with which a person asks for it, at most fifteen: some clients show their model a tool only after
    a search. One that is `always_loaded` should be there without.
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
        """Whether the policy allows anything that it does."""
        rules = policy.rules
        return not (rules and self.does) or any(rules.may(verb, types) for verb, types in self.does.items())

    @property
    def description(self) -> str:
        """What the model reads first: the function's docstring."""
        return inspect.cleandoc(self.function.__doc__ or "")

    def description_beside(self, offered: Collection[str]) -> str:
        """All that the model reads where these tools are offered."""
        beside = (sentence for name, sentence in self.beside.items() if name in offered)
        return " ".join((self.description, *beside))

    @cache  # noqa: B019 - declarations live as long as the process
    def signature(self) -> inspect.Signature:
        """The function's signature with its annotations evaluated."""
        return inspect.signature(self.function, eval_str=True)

    @cache  # noqa: B019 - as above; it is needed with each call
    def makers(self) -> Makers:
        """How the values of the function's parameters are made."""
        return {name: made_by(parameter) for name, parameter in self.signature().parameters.items()}

    def arguments(self) -> inspect.Signature:
        """The signature that the model sees: without what is made for the function."""
        return arguments_of(self.signature())

    async def perform(self, call: Call, arguments: Mapping[str, Any]) -> Any:
        """Calls the function with validated arguments and with what is made for it; raises `RobotError` as it does."""
        return await self.function(**await values_for(self.makers(), call, arguments))


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
    """Declares the function as a tool of the same name."""

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
