"""Dependency injection: parameters of a tool's function whose values are made here, such as the robot or a source.

The model sees the arguments that a value is made from: for a parameter `source: Source` these are `bag`, `start` and
`end`. What makes a value is a function, the maker. It is found by the parameter's type (`_BY_TYPE`), or the annotation
names it (`MadeBy`). A maker takes the `Call`; its other parameters (or some of them) become arguments of the tool.
Where the tool has a parameter of the same name, both get the same value.
"""

from __future__ import annotations

import inspect
from collections.abc import Awaitable, Callable, Collection, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from operator import attrgetter
from typing import Annotated, Any

from ros2_mcp.model.errors import NotFound
from ros2_mcp.ops.memory.bag_store import BagStore
from ros2_mcp.ops.results.results import Report, answer_bytes
from ros2_mcp.ops.sources.kinds import OWN_KINDS, Sources
from ros2_mcp.ops.sources.live import Live
from ros2_mcp.ops.sources.selection import Selection
from ros2_mcp.ops.sources.source import Source, SourceKind
from ros2_mcp.ops.sources.times import is_seconds_ago
from ros2_mcp.programs.declare import Function
from ros2_mcp.programs.program import Programs
from ros2_mcp.robot import Robot
from ros2_mcp.robot.session import Session
from ros2_mcp.tools.arguments import (
    Duration,
    EveryN,
    Fields,
    FromBag,
    FromStart,
    MaxArray,
    MessageLimit,
    NumericFields,
    RecordedTime,
    Since,
    UpToEnd,
    UpToLogEnd,
)
from ros2_mcp.view.viewing import Viewing

_FOR_VALUES = 5 / 6
"""Of a text's bytes; the others are for what stands above and below the values."""
_TIMES_TO_WAIT = frozenset(
    {"duration", "duration_s", "duration_sec", "timeout", "timeout_s", "timeout_sec", "wait_timeout_sec"}
    | {"wait_for_service_sec"}
)
"""Arguments of tools that say how long to wait."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Call:
    """What tools can get in every call; `limitations` says in words what this server does not offer and why.

    `given` are the names of the arguments that the caller gave, `functions` gives those of the module of programs,
    `viewing` has the robot's pages in chats, and `shows_pages` says whether this client can show one.
    """

    robot: Robot
    session: Session
    store: BagStore
    report: Report
    kinds: Sequence[SourceKind] = OWN_KINDS
    limitations: Sequence[str] = ()
    given: Collection[str] = ()
    functions: Callable[[], Sequence[Function]] = tuple
    viewing: Viewing | None = None
    shows_pages: bool = False


@dataclass(frozen=True, slots=True)
class MadeBy:
    """Metadata of a parameter: the function that makes its value, and the arguments it gives the tool (None: all)."""

    maker: Callable[..., Any]
    arguments: tuple[str, ...] | None = None


Makers = Mapping[str, MadeBy | None]
"""Name of a parameter → how its value is made; None for an argument of the tool."""


# ── makers ───────────────────────────────────────────────────────────────────────────────────────────────────────────


def _sources(call: Call) -> Sources:
    return Sources(call.robot, call.store, call.kinds)


async def _source(call: Call, bag: FromBag = "", start: FromStart = "", end: UpToEnd = "") -> Source:
    return await _sources(call).open(bag, start, end, waits=_waits(call), report=call.report)


async def _at_one_time(call: Call, bag: FromBag = "", time: RecordedTime = "") -> Source:
    """What was known at a time: of a recording, up to it."""
    return await _sources(call).open(bag, "", time, names=("time", "time"), waits=False, report=call.report)


def _waits(call: Call) -> bool:
    """Whether the caller gave a time to wait: then what is not there yet is waited for."""
    return not _TIMES_TO_WAIT.isdisjoint(call.given)


async def _log_source(call: Call, since: Since = "", bag: FromBag = "", end: UpToLogEnd = "") -> Source:
    """Without the name of a bag the log is the robot's own: times alone do not mean the black box here."""
    if not (bag or call.store.subject_name):
        return Live(call.robot)
    start, until = (f"{text} s ago" if is_seconds_ago(text) else text for text in (since, end))
    return await _sources(call).open(bag, start, until, names=("since", "end"))


def _selection(
    call: Call,
    duration: Duration = None,
    message_limit: MessageLimit = None,
    fields: Fields = None,
    max_array: MaxArray = 64,
    every_n: EveryN = 1,
) -> Selection:
    return Selection(
        fields=fields or (),
        max_array=max_array,
        every_n=every_n,
        duration_s=duration,
        message_limit=message_limit,
        max_bytes=int(answer_bytes(call.robot) * _FOR_VALUES),
    )


def _numbers(call: Call, fields: NumericFields = None) -> Selection:
    return _selection(call, fields=fields)


def _viewing(call: Call) -> Viewing:
    if call.viewing is None:
        raise NotFound("This server has no pages.")
    return call.viewing


def _programs(call: Call) -> Programs:
    return Programs(functions=call.functions(), store=call.store, kinds=call.kinds)


LimitedMessages = Annotated[Selection, MadeBy(_selection)]
Messages = Annotated[Selection, MadeBy(_selection, ("fields", "max_array", "every_n"))]
OneMessage = Annotated[Selection, MadeBy(_selection, ("fields", "max_array"))]
Numbers = Annotated[Selection, MadeBy(_numbers)]
Limitations = Annotated[Sequence[str], MadeBy(attrgetter("limitations"), ())]
ProgramsHere = Annotated[Programs, MadeBy(_programs, ())]
ShowsPages = Annotated[bool, MadeBy(attrgetter("shows_pages"), ())]
Waits = Annotated[bool, MadeBy(_waits, ())]
RecordingSource = Annotated[Source, MadeBy(_source, ("bag",))]
"""For tools with a time of their own."""
AtOneTime = Annotated[Source, MadeBy(_at_one_time)]
"""What was known at a time."""
LogSource = Annotated[Source, MadeBy(_log_source)]

_BY_TYPE: Mapping[Any, MadeBy] = {
    Source: MadeBy(_source),
    Sources: MadeBy(_sources),
    Selection: MadeBy(_selection, ()),
    Robot: MadeBy(attrgetter("robot"), ()),
    Session: MadeBy(attrgetter("session"), ()),
    BagStore: MadeBy(attrgetter("store"), ()),
    Report: MadeBy(attrgetter("report"), ()),
    Viewing: MadeBy(_viewing, ()),
}
"""Type of a parameter → how its value is made, where the type alone says what is meant."""


# ── how they are used ────────────────────────────────────────────────────────────────────────────────────────────────


def made_by(parameter: inspect.Parameter) -> MadeBy | None:
    """How the value of a parameter is made; None if it is an argument of the tool."""
    metadata = getattr(parameter.annotation, "__metadata__", ())
    found = next((item for item in metadata if isinstance(item, MadeBy)), None)
    return found or next((made for kind, made in _BY_TYPE.items() if parameter.annotation == kind), None)


def arguments_of(whole: inspect.Signature) -> inspect.Signature:
    """The signature that the model sees: injected parameters are replaced by the arguments that they are made from."""
    arguments: dict[str, inspect.Parameter] = {}
    for parameter in whole.parameters.values():
        made = made_by(parameter)
        for argument in _parameters_of(made) if made else [parameter]:
            if argument is parameter or argument.name not in whole.parameters:
                arguments[argument.name] = argument.replace(kind=inspect.Parameter.KEYWORD_ONLY)
    return whole.replace(parameters=list(arguments.values()))


async def values_for(makers: Makers, call: Call, arguments: Mapping[str, Any]) -> dict[str, Any]:
    """The values of all parameters of a tool's function, each with how it is made.

    Raises:
        RobotError: if one cannot be made, such as a source that is not there.
    """
    values: dict[str, Any] = {}
    for name, made in makers.items():
        if made is None:
            values[name] = arguments[name]
            continue
        value: Any = made.maker(call, **{one.name: arguments[one.name] for one in _parameters_of(made)})
        values[name] = await value if isinstance(value, Awaitable) else value
    return values


@cache
def _parameters_of(made: MadeBy) -> Sequence[inspect.Parameter]:
    """The arguments that a tool has for a maker; its first parameter is the call."""
    if made.arguments == ():
        return ()
    found = dict(inspect.signature(made.maker, eval_str=True).parameters)
    return [found[name] for name in made.arguments or list(found)[1:]]
