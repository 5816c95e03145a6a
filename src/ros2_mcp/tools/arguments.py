"""The kinds of arguments that tools share, with their bounds and descriptions."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Any

from pydantic import BeforeValidator, Field

from ros2_mcp.ops.sources.selection import MAX_MESSAGES
from ros2_mcp.ops.sources.times import is_seconds_ago, taken_as
from ros2_mcp_common.wire.limits import MAX_DURATION_S

WHOLE_SENTENCE = "whole_sentence"
"""The type of a validation error whose message also says what was given."""


def _no_bool(value: Any) -> Any:
    """Python's `True` is the integer 1: as a number it can only be a mistake."""
    if isinstance(value, bool):
        raise ValueError("a number is expected")
    return value


def _strictly_bool(value: Any) -> Any:
    """Pydantic would take 1 and "yes" as well, and a flag may decide whether something is sent to the robot."""
    if not isinstance(value, bool):
        raise ValueError("true or false is expected")
    return value


def _as_text(value: Any) -> Any:
    """Models write seconds as a number, although the argument is a text."""
    return str(value) if isinstance(value, (int, float)) and not isinstance(value, bool) else value


@dataclass(frozen=True)
class TimeArgument:
    """Metadata of an argument that is a time in the past, or with `ago` may be a number of seconds ago."""

    ago: bool = False

    def taken_as(self, text: str) -> str:
        """How a text is taken that does not say it all; empty for any other."""
        return "" if self.ago and is_seconds_ago(text) else taken_as(text)


# NaN and infinities are refused: as a time, a rate or a bound they compare in ways that nobody means.
Number = Annotated[float, BeforeValidator(_no_bool), Field(allow_inf_nan=False)]
Whole = Annotated[int, BeforeValidator(_no_bool)]
Flag = Annotated[bool, BeforeValidator(_strictly_bool)]

TopicName = Annotated[str, Field(description="Such as /scan.")]
MessageType = Annotated[
    str,
    Field(description="Such as sensor_msgs/msg/LaserScan. Default: the topic's own."),
]
Pattern = Annotated[str, Field(description="Part of a name (or type), or a glob: */map*.")]
# At most: a result as long as that is cut by its size in characters (`mcp/binding.py`) before it is by this number.
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
FromBag = Annotated[str, Field(description='Read this bag, not live data; "black box": this server\'s.')]
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
    Field(ge=1, le=MAX_MESSAGES, description="Stop after this many messages; without duration, in 20 s at most."),
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
    Field(description='Seconds ago, such as "30", or an ISO 8601 time. Default: all kept lines.'),
]
UpToLogEnd = Annotated[
    str,
    BeforeValidator(_as_text),
    TimeArgument(ago=True),
    Field(description='Like since; in a bag also "12 s in". Default: now, or the end of the bag.'),
]
