"""The functions of the module `robot` of programs, with typed signatures from which all else follows.

Most are tools, which the toolset adds (`ToolDeclaration.program`). Functions that only programs have are declared with
`@function`: a typed function with a docstring. A parameter `use: Use` is passed by the server; the others are the
program's arguments.
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
"""`act` changes or moves something: such a call is a command, and counted as such."""


class Use(Protocol):
    """The objects that a function can use on behalf of the program that calls it; one per call."""

    @property
    def robot(self) -> Robot:
        """The robot."""
        ...

    @property
    def session(self) -> Session:
        """The session of this call: its actions are the program's."""
        ...

    @property
    def store(self) -> BagStore:
        """The recordings."""
        ...

    @property
    def sources(self) -> Sources:
        """The sources of messages, live or recorded."""
        ...

    @property
    def streams(self) -> Streams:
        """The topics that the program follows, each as a stream."""
        ...

    @property
    def held(self) -> Held:
        """The large arrays of the messages that it has read."""
        ...

    @property
    def report(self) -> Report:
        """Reports progress to the caller of `ros2_program_run`."""
        ...

    @property
    def line(self) -> int:
        """The line of the call in the program."""
        ...

    async def follow(self, source: Source, wanted: FollowRequest) -> Any:
        """Follow topics. Return the stream's representation in the program."""
        ...

    def follow_goal(self, goal: Goal | None) -> Any:
        """Follow the feedback of a goal. Return the stream's representation in the program."""
        ...

    def tell(self, note: str) -> None:
        """Add a sentence to the note of the result, once."""
        ...

    def keep(self, picture: Picture) -> None:
        """Add a picture to the result, for the model."""
        ...

    async def stop_own(self) -> list[str]:
        """End the motion of this program. Return the ended motions, in words."""
        ...


Perform = Callable[[Use, Mapping[str, Any]], Awaitable[Any]]
"""Performs a function with its arguments by name; the result is a JSON value or a dataclass."""


@dataclass(frozen=True, eq=False, kw_only=True)
class Function:
    """A function of the module `robot`.

    `signature` has the parameters and the result as a program sees them; a dataclass as result becomes a JSON object.
    `recorded`: it also works if the robot is a recording. `tool` is the name of the tool that it calls, or "".
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
        """The field of the result that the function returns alone, because it has its name: `topics()` returns the list
        `topics`.
        """
        kind = self.signature.return_annotation
        if self.name not in getattr(kind, "__dataclass_fields__", {}):
            return ""
        origin = get_origin(get_type_hints(kind)[self.name])
        return self.name if origin in (list, Sequence, dict, Mapping) else ""


DECLARED: list[Function] = []
"""The functions that only programs have, in the order of declaration."""


def function(*, risk: Risk = "read", recorded: bool = True) -> Callable[[Callable[..., Any]], Callable[..., Any]]:
    """Declare a function of the module `robot` under its own name. It may be async; it may omit the parameter `use`."""

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
    """Return a function that only computes, from its arguments alone. Its errors become `BadInput`."""

    async def perform(_: Use, arguments: Mapping[str, Any]) -> Any:
        try:
            return implementation(**arguments)
        except (ValueError, TypeError, ArithmeticError, LookupError) as error:
            raise BadInput(f"robot.{name}: {error}.") from error

    signature = inspect.signature(implementation, eval_str=True)
    doc = inspect.cleandoc(implementation.__doc__ or "")
    return Function(name=name, signature=signature, doc=doc, risk="read", recorded=True, perform=perform)
