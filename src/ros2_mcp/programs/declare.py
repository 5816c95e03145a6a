"""What the module `robot` of a program is made of: functions with typed signatures, from which all else follows.

Most are tools, which the toolset gives (`ToolDeclaration.program`). What only programs have is declared here: a typed
function with a docstring under `@function`. A parameter `use: Use` is given to it; the others are what a program gives.
"""

from __future__ import annotations

import inspect
from collections.abc import Awaitable, Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Literal, Protocol, get_origin, get_type_hints

from ros2_mcp.model.errors import BadInput

if TYPE_CHECKING:
    from ros2_mcp.model.pictures import Picture
    from ros2_mcp.ops.memory.bag_store import BagStore
    from ros2_mcp.ops.results.results import Report
    from ros2_mcp.ops.sources.kinds import Sources
    from ros2_mcp.ops.sources.source import Source
    from ros2_mcp.programs.held import Held
    from ros2_mcp.programs.streams import FollowRequest, Streams
    from ros2_mcp.robot import Robot
    from ros2_mcp.robot.goals import Goal
    from ros2_mcp.robot.session import Session

Risk = Literal["read", "act"]
"""`act` changes or moves something: such a call is a command, and counted as one."""


class Use(Protocol):
    """What a function gets of the program that calls it: `session` is for this call alone."""

    @property
    def robot(self) -> Robot:
        """The robot."""
        ...

    @property
    def session(self) -> Session:
        """What is done in it is done for the program."""
        ...

    @property
    def store(self) -> BagStore:
        """The recordings."""
        ...

    @property
    def sources(self) -> Sources:
        """What can be read from, live or recorded."""
        ...

    @property
    def streams(self) -> Streams:
        """The topics that the program follows."""
        ...

    @property
    def held(self) -> Held:
        """The large arrays of the messages that it has read."""
        ...

    @property
    def report(self) -> Report:
        """Progress, for who called `ros2_program_run`."""
        ...

    @property
    def line(self) -> int:
        """The line of the program that calls."""
        ...

    async def follow(self, source: Source, wanted: FollowRequest) -> Any:
        """Follows topics; what stands for their messages in the program."""
        ...

    def follow_goal(self, goal: Goal | None) -> Any:
        """Follows the feedback of a goal; what stands for it in the program."""
        ...

    def tell(self, note: str) -> None:
        """Adds a sentence to the note of the result, once."""
        ...

    def keep(self, picture: Picture) -> None:
        """Hands a picture to the model at the end."""
        ...

    async def stop_own(self) -> list[str]:
        """Ends what this program has in motion; in words, what that was."""
        ...


Perform = Callable[[Use, Mapping[str, Any]], Awaitable[Any]]
"""Does what a function does, with its arguments by name; the result is a JSON value."""


@dataclass(frozen=True, eq=False, kw_only=True)
class Function:
    """A function of the module `robot`.

    `signature` is what a program gives and gets; what it returns may be a dataclass, which the program sees as an
    object of JSON. `recorded`: it works where a recording stands for the robot, too. `tool` is the tool that it is.
    """

    name: str
    signature: inspect.Signature
    doc: str
    risk: Risk
    recorded: bool
    perform: Perform
    tool: str = ""

    @property
    def unwrapped(self) -> str:
        """The field of its result that it gives, if it is named like one: `topics()` gives the list of topics."""
        kind = self.signature.return_annotation
        if self.name not in getattr(kind, "__dataclass_fields__", {}):
            return ""
        origin = get_origin(get_type_hints(kind)[self.name])
        return self.name if origin in (list, Sequence, dict, Mapping) else ""


DECLARED: list[Function] = []
"""What only programs have, in the order of declaration."""


def function(*, risk: Risk = "read", recorded: bool = True) -> Callable[[Callable[..., Any]], Callable[..., Any]]:
    """Declares a function of the module `robot` under its own name. It may be async; pure ones need no `Use`."""

    def declare(implementation: Callable[..., Any]) -> Callable[..., Any]:
        whole = inspect.signature(implementation, eval_str=True)
        gives_use = "use" in whole.parameters
        kinds = {each.kind: name for name, each in whole.parameters.items()}
        several = kinds.get(inspect.Parameter.VAR_POSITIONAL, "")
        seen = whole.replace(parameters=[each for name, each in whole.parameters.items() if name != "use"])

        async def perform(use: Use, arguments: Mapping[str, Any]) -> Any:
            named = {name: value for name, value in arguments.items() if name != several}
            given = {"use": use} if gives_use else {}
            result = implementation(*arguments.get(several, ()), **given, **named)
            return await result if inspect.isawaitable(result) else result

        DECLARED.append(
            Function(
                name=implementation.__name__,
                signature=seen,
                doc=inspect.cleandoc(implementation.__doc__ or ""),
                risk=risk,
                recorded=recorded,
                perform=perform,
            )
        )
        return implementation

    return declare


def pure(name: str, implementation: Callable[..., Any]) -> Function:
    """A function that only computes, from its arguments alone; what it raises is an error of who called it."""

    async def perform(_: Use, arguments: Mapping[str, Any]) -> Any:
        try:
            return implementation(**arguments)
        except (ValueError, TypeError, ArithmeticError, LookupError) as error:
            raise BadInput(f"robot.{name}: {error}.") from error

    signature = inspect.signature(implementation, eval_str=True)
    doc = inspect.cleandoc(implementation.__doc__ or "")
    return Function(name=name, signature=signature, doc=doc, risk="read", recorded=True, perform=perform)
