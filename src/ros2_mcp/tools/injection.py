"""Dependency injection: parameters of a tool's function whose values are made here, such as the robot or a source.

The model sees the arguments that a value is made from: for a parameter `source: Source` these are `bag`, `start` and
`end`. What makes a value is a function, the maker. It is found by the parameter's type (`_MAKERS`), or the annotation
names it (`MadeBy`). A maker takes the `Call`; each of its other parameters becomes an argument of the tool. Where the
tool has a parameter of the same name, both get the same value.
"""

from __future__ import annotations

import inspect
from collections.abc import Awaitable, Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from operator import attrgetter
from typing import Annotated, Any

from ros2_mcp.ops.memory.bag_store import BagStore
from ros2_mcp.ops.results import Report
from ros2_mcp.ops.sources.kinds import OWN_KINDS, Sources
from ros2_mcp.ops.sources.live import Live
from ros2_mcp.ops.sources.selection import Selection
from ros2_mcp.ops.sources.source import Source, SourceKind
from ros2_mcp.robot import Robot
from ros2_mcp.tools.arguments import (
    Duration,
    EveryN,
    Fields,
    FromBag,
    FromStart,
    MaxArray,
    MessageLimit,
    NumericFields,
    Since,
    UpToEnd,
)

Maker = Callable[..., Any]


@dataclass(frozen=True, slots=True)
class Call:
    """What there is in every call: the robot, the bags, where progress is reported, and the kinds of sources."""

    robot: Robot
    store: BagStore
    report: Report
    kinds: Sequence[SourceKind] = OWN_KINDS


@dataclass(frozen=True, slots=True)
class MadeBy:
    """Metadata of a parameter: the function that makes its value."""

    maker: Maker


# ── makers ───────────────────────────────────────────────────────────────────────────────────────────────────────────


def _sources(call: Call) -> Sources:
    return Sources(call.robot, call.store, call.kinds)


async def _source(call: Call, bag: FromBag = "", start: FromStart = "", end: UpToEnd = "") -> Source:
    return await _sources(call).open(bag, start, end)


async def _log_source(call: Call, since: Since = "", bag: FromBag = "", end: UpToEnd = "") -> Source:
    """Without the name of a bag the log is the robot's own: times alone do not mean the black box here."""
    if not (bag or end or call.store.subject_name):
        return Live(call.robot)
    is_number = since.strip().replace(".", "", 1).isdigit()
    return await _sources(call).open(bag, f"{since} s ago" if is_number else since, end)


def _size(call: Call) -> Selection:
    return Selection(max_bytes=call.robot.result_bytes)


def _messages(call: Call, fields: Fields = None, max_array: MaxArray = 64, every_n: EveryN = 1) -> Selection:
    return Selection(fields=fields or (), max_array=max_array, every_n=every_n, max_bytes=call.robot.result_bytes)


def _limited_messages(
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
        max_bytes=call.robot.result_bytes,
    )


def _message(call: Call, fields: Fields = None, max_array: MaxArray = 64) -> Selection:
    return Selection(fields=fields or (), max_array=max_array, max_bytes=call.robot.result_bytes)


def _numbers(call: Call, fields: NumericFields = None) -> Selection:
    return Selection(fields=fields or (), max_bytes=call.robot.result_bytes)


Messages = Annotated[Selection, MadeBy(_messages)]
LimitedMessages = Annotated[Selection, MadeBy(_limited_messages)]
OneMessage = Annotated[Selection, MadeBy(_message)]
Numbers = Annotated[Selection, MadeBy(_numbers)]
LogSource = Annotated[Source, MadeBy(_log_source)]

_MAKERS: Mapping[Any, Maker] = {
    Source: _source,
    Sources: _sources,
    Selection: _size,
    Robot: attrgetter("robot"),
    BagStore: attrgetter("store"),
    Report: attrgetter("report"),
}
"""Type of a parameter → its maker, where the type alone says what is meant."""


# ── their use ────────────────────────────────────────────────────────────────────────────────────────────────────────


def maker_of(parameter: inspect.Parameter) -> Maker | None:
    """What makes the value of a parameter; None if it is an argument of the tool."""
    for metadata in getattr(parameter.annotation, "__metadata__", ()):
        if isinstance(metadata, MadeBy):
            return metadata.maker
    return next((maker for kind, maker in _MAKERS.items() if parameter.annotation == kind), None)


def arguments_of(whole: inspect.Signature) -> inspect.Signature:
    """The signature that the model sees: injected parameters are replaced by the arguments that they are made from."""
    arguments: dict[str, inspect.Parameter] = {}
    for parameter in whole.parameters.values():
        maker = maker_of(parameter)
        for argument in [parameter] if maker is None else _parameters_of(maker).values():
            if argument is parameter or argument.name not in whole.parameters:
                arguments[argument.name] = argument.replace(kind=inspect.Parameter.KEYWORD_ONLY)
    return whole.replace(parameters=list(arguments.values()))


async def values_for(whole: inspect.Signature, call: Call, arguments: Mapping[str, Any]) -> dict[str, Any]:
    """The values of all parameters of a tool's function.

    Raises:
        RobotError: if one cannot be made, such as a source that is not there.
    """
    values: dict[str, Any] = {}
    for name, parameter in whole.parameters.items():
        maker = maker_of(parameter)
        if maker is None:
            values[name] = arguments[name]
            continue
        made: Any = maker(call, **{argument: arguments[argument] for argument in _parameters_of(maker)})
        values[name] = await made if isinstance(made, Awaitable) else made
    return values


@cache
def _parameters_of(maker: Maker) -> dict[str, inspect.Parameter]:
    """The parameters of a maker, the call left out."""
    if isinstance(maker, attrgetter):
        return {}
    found = list(inspect.signature(maker, eval_str=True).parameters.values())
    return {parameter.name: parameter for parameter in found[1:]}
