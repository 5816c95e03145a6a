"""Dependency injection: parameters of tools whose values the server makes, such as the robot or a source.

The model sees the arguments that a value is made from: for a parameter `source: Source` these are `bag`, `start` and
`end`. The function that makes a value is its maker. It is found by the type of the parameter (`_BY_TYPE`), or by the
annotation (`MadeBy`). A maker takes the `Call`; its other parameters, or some of them, become arguments of the tool. If
the tool has a parameter of the same name, both get the same value.
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
"""Share of a text's bytes for values; the rest is for the text before and after them."""
_TIMES_TO_WAIT = frozenset(
    {"duration", "duration_s", "duration_sec", "timeout", "timeout_s", "timeout_sec", "wait_timeout_sec"}
    | {"wait_for_service_sec"}
)
"""Arguments of tools that set how long to wait."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Call:
    """The values that makers can use in a call. `limitations` are sentences on what this server does not offer, and
    why.

    `given` are the names of the arguments in the call, `functions` returns the functions of the programs' module,
    `viewing` has the robot's pages in chats, and `shows_pages` says whether the client can show a page.
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
    """Metadata of a parameter: the maker of its value, and which of the maker's parameters become arguments (None:
    all)."""

    maker: Callable[..., Any]
    arguments: tuple[str, ...] | None = None


Makers = Mapping[str, MadeBy | None]
"""Parameter name → how its value is made; None for an argument of the tool."""


# ── makers ───────────────────────────────────────────────────────────────────────────────────────────────────────────


def _sources(call: Call) -> Sources:
    return Sources(call.robot, call.store, call.kinds)


async def _source(call: Call, bag: FromBag = "", start: FromStart = "", end: UpToEnd = "") -> Source:
    return await _sources(call).open(bag, start, end, waits=_waits(call), report=call.report)


async def _at_one_time(call: Call, bag: FromBag = "", time: RecordedTime = "") -> Source:
    """Open a source that ends at a time; a recording is read up to it."""
    return await _sources(call).open(bag, "", time, names=("time", "time"), waits=False, report=call.report)


def _waits(call: Call) -> bool:
    """Whether the caller gave a time to wait; then the source waits for topics that do not exist yet."""
    return not _TIMES_TO_WAIT.isdisjoint(call.given)


async def _log_source(call: Call, since: Since = "", bag: FromBag = "", end: UpToLogEnd = "") -> Source:
    """Open the source of the log: the robot's own without a bag; a time alone does not select the black box here."""
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
"""For tools with time arguments of their own."""
AtOneTime = Annotated[Source, MadeBy(_at_one_time)]
"""A source that ends at one time."""
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
"""Parameter type → how its value is made, for types that have only one meaning."""


# ── how they are used ────────────────────────────────────────────────────────────────────────────────────────────────


def made_by(parameter: inspect.Parameter) -> MadeBy | None:
    """Return how the value of a parameter is made; None for an argument of the tool."""
    metadata = getattr(parameter.annotation, "__metadata__", ())
    found = next((item for item in metadata if isinstance(item, MadeBy)), None)
    return found or next((made for kind, made in _BY_TYPE.items() if parameter.annotation == kind), None)


def arguments_of(whole: inspect.Signature) -> inspect.Signature:
    """Return the signature that the model sees: injected parameters are replaced by the arguments of their makers."""
    arguments: dict[str, inspect.Parameter] = {}
    for parameter in whole.parameters.values():
        made = made_by(parameter)
        for argument in _parameters_of(made) if made else [parameter]:
            if argument is parameter or argument.name not in whole.parameters:
                arguments[argument.name] = argument.replace(kind=inspect.Parameter.KEYWORD_ONLY)
    return whole.replace(parameters=list(arguments.values()))


async def values_for(makers: Makers, call: Call, arguments: Mapping[str, Any]) -> dict[str, Any]:
    """Return the values of all parameters of a tool's function.

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
    """Return the maker's parameters that become arguments of the tool; the first parameter, the call, never does."""
    if made.arguments == ():
        return ()
    found = dict(inspect.signature(made.maker, eval_str=True).parameters)
    return [found[name] for name in made.arguments or list(found)[1:]]
