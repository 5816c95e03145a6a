"""Argument types that several tools share, with their bounds and descriptions."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Any

from pydantic import BeforeValidator, Field

from ros2_mcp.ops.sources.selection import MAX_MESSAGES
from ros2_mcp.ops.sources.times import is_seconds_ago, taken_as
from ros2_mcp_common.wire.limits import MAX_DURATION_S

WHOLE_SENTENCE = "whole_sentence"
"""Type of a validation error whose message is a complete sentence, including the given value."""


def _no_bool(value: Any) -> Any:
    """Reject a bool, which Python treats as the integer 0 or 1: as a number it can only be a mistake."""
    if isinstance(value, bool):
        raise ValueError("a number is expected")
    return value


def _strictly_bool(value: Any) -> Any:
    """Accept only a bool. Pydantic also accepts 1 and "yes", and a flag may decide whether the robot is commanded."""
    if not isinstance(value, bool):
        raise ValueError("true or false is expected")
    return value


def _as_text(value: Any) -> Any:
    """Convert a number to a string: models write seconds as a number even if the argument is a string."""
    return str(value) if isinstance(value, (int, float)) and not isinstance(value, bool) else value


@dataclass(frozen=True)
class TimeArgument:
    """Metadata of an argument that is a time in the past; with `ago` also a number of seconds ago."""

    ago: bool = False

    def taken_as(self, text: str) -> str:
        """Return how an ambiguous time is interpreted; "" for a time that is complete."""
        return "" if self.ago and is_seconds_ago(text) else taken_as(text)


# NaN and infinities are rejected: as a time, a rate or a bound they give meaningless comparisons.
Number = Annotated[float, BeforeValidator(_no_bool), Field(allow_inf_nan=False)]
Whole = Annotated[int, BeforeValidator(_no_bool)]
Flag = Annotated[bool, BeforeValidator(_strictly_bool)]

TopicName = Annotated[str, Field(description="Such as /scan.")]
MessageType = Annotated[
    str,
    Field(description="Such as sensor_msgs/msg/LaserScan. Default: the topic's own."),
]
Pattern = Annotated[str, Field(description="Part of a name (or type), or a glob: */map*.")]
NamePattern = Annotated[str, Field(description="Part of a name, or a glob: *map*.")]
# A result with more rows would be cut by its number of characters first (`mcp/binding.py`).
Limit = Annotated[Whole, Field(ge=1, le=2000, description="Maximum rows.")]
Hidden = Annotated[Flag, Field(description="Also hidden names (a part starts with _).")]
Fields = Annotated[
    list[str] | None,
    Field(
        description='Only these fields: ["pose.pose.position", "ranges[0:10]", '
        "\"transforms[child_frame_id == 'base_link']\"]."
    ),
]
# At most 10,000 elements: with three digits and a comma each that is 40 kB, and a result has 12 kB.
MaxArray = Annotated[
    Whole,
    Field(ge=0, le=10_000, description="Summarise longer arrays."),
]
EveryN = Annotated[Whole, Field(ge=1, le=1_000_000, description="Keep every n-th message.")]
FromBag = Annotated[
    str, Field(description='Read this bag instead of live data; "black box": this server\'s recording.')
]
FromStart = Annotated[
    str,
    BeforeValidator(_as_text),
    TimeArgument(),
    Field(description='Start: ISO 8601, UNIX time, "last 30 s", "12 s in".'),
]
UpToEnd = Annotated[str, BeforeValidator(_as_text), TimeArgument(), Field(description="End, in the forms of start.")]
RecordedTime = Annotated[
    str,
    BeforeValidator(_as_text),
    TimeArgument(),
    Field(description='Time in the bag: ISO 8601, UNIX time or "12 s in". Default: its end.'),
]
Seconds = Annotated[Number, Field(ge=0, le=MAX_DURATION_S)]
Duration = Annotated[Number | None, Field(gt=0, le=MAX_DURATION_S, description="Seconds to collect.")]
MessageLimit = Annotated[
    Whole | None,
    Field(ge=1, le=MAX_MESSAGES, description="Stop after this many messages; without `duration`, waits at most 20 s."),
]
NumericFields = Annotated[
    list[str] | None,
    Field(description='Such as ["pose.pose.position", "ranges[0:10]"]. Default: all numbers.'),
]
BagName = Annotated[str, Field(description="Name of the bag, as ros2_bag_list shows it.")]
BagStart = Annotated[
    str,
    BeforeValidator(_as_text),
    TimeArgument(),
    Field(
        description='ISO 8601, UNIX time, "last 30 s" (before the end of the bag) or "2 min in" (after its beginning).'
    ),
]
BagEnd = Annotated[
    str,
    BeforeValidator(_as_text),
    TimeArgument(),
    Field(description="Like start; inclusive. Default: the end of the bag."),
]
PastTime = Annotated[
    str,
    BeforeValidator(_as_text),
    TimeArgument(),
    Field(description='ISO 8601, such as 2026-11-21T03:00:00.5Z, UNIX time, or relative: "last 30 s", "5 min ago".'),
]
UpToPastTime = Annotated[str, BeforeValidator(_as_text), TimeArgument(), Field(description="Like time_start.")]
AtTime = Annotated[
    str,
    BeforeValidator(_as_text),
    TimeArgument(),
    Field(description='ISO 8601, a stamp or "2 s ago".'),
]
Since = Annotated[
    str,
    BeforeValidator(_as_text),
    TimeArgument(ago=True),
    Field(description='Seconds ago, such as "30", or an ISO 8601 time. Default: all in memory.'),
]
UpToLogEnd = Annotated[
    str,
    BeforeValidator(_as_text),
    TimeArgument(ago=True),
    Field(description='Like since; in a bag also "12 s in". Default: now, or the end of the bag.'),
]
