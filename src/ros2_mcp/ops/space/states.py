"""States that a robot publishes on topics of one value each: modes, flags, numbers."""

from __future__ import annotations

import asyncio
import re
from collections.abc import Mapping
from contextlib import suppress
from typing import Any

from ros2_mcp.model.errors import RobotError
from ros2_mcp.model.interfaces import Field
from ros2_mcp.model.text import named, quoted
from ros2_mcp.ops.sources.from_before import from_before
from ros2_mcp.ops.sources.source import Source
from ros2_mcp.values.definitions import Definitions
from ros2_mcp.values.store import attribute
from ros2_mcp_common.finite import in_words

_HEADER = "std_msgs/msg/Header"
_MOST_TEXT = 30
_FAULT = re.compile(
    r"(^|_)((PROTECTIVE|SAFEGUARD|SAFETY|EMERGENCY|ENABLING)_STOP(PED)?|E_?STOP(PED)?|FAULT|ERROR|FAIL(ED|URE)?|VIOLATION"
    r"|CRITICAL)($|_)"
)
"""Matches names of constants that mean a fault which a person must clear. A robot that merely stopped is not at
fault."""
_NO_FAULT = re.compile(r"(^|_)(NO|NOT|NON|NONE|OK|CLEAR(ED)?|RELEASED|RESET|RECOVERED)($|_)")
"""Matches names of constants that mean the absence of a fault."""


async def states_of(source: Source, topics: Mapping[str, str]) -> tuple[dict[str, str], list[str]]:
    """Return the value of each topic (name: type) that has a single value and was received, in words: the name of the
    type's constant with that value, if such a constant exists. Also return sentences for values named as faults.
    """
    found = await asyncio.gather(*(_state(source, topic, kind) for topic, kind in topics.items()))
    told = {topic: (said, f" ({age})" if age else "") for topic, (said, age) in zip(topics, found, strict=True) if said}
    faults = [f"{named(topic)} is {said}{age}." for topic, (said, age) in told.items() if _is_fault(said)]
    return {topic: said + age for topic, (said, age) in told.items()}, faults


def _is_fault(name: str) -> bool:
    return bool(_FAULT.search(name)) and not _NO_FAULT.search(name)


async def _state(source: Source, topic: str, kind: str) -> tuple[str, str]:
    """Return the value in words, and its age if it was sent before the subscription began."""
    said = age = ""
    with suppress(RobotError):
        async with source.follow(topic, limit=1) as stream:
            field = _only_field(stream.codec.definitions, kind) if stream.type == kind else None
            if field is None:
                return "", ""
            async for batch in stream.batches:
                for sample in batch:
                    value: Any = getattr(stream.codec.decode(kind, sample.data), attribute(field.name))
                    said = _said(value, stream.codec.definitions, kind)
                    age = from_before(source, stream, [sample]).age
    return said, age


def _only_field(definitions: Definitions, kind: str) -> Field | None:
    """Return the only field of a type besides its header; None if there are several, or it is a list or a message."""
    fields = [field for field in definitions.structure(kind).fields if field.type.base != _HEADER]
    is_value = len(fields) == 1 and fields[0].type.arity == "single" and not fields[0].type.is_message
    return fields[0] if is_value else None


def _said(value: Any, definitions: Definitions, kind: str) -> str:
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, str):
        return quoted(value if len(value) <= _MOST_TEXT else f"{value[: _MOST_TEXT - 1]}…")
    if isinstance(value, float):
        return in_words(value, ".3g")
    names = [constant.name for constant in definitions.structure(kind).constants if constant.value == value]
    return named(names[0]) if len(names) == 1 else str(value)
