"""The kinds of arguments that tools share, with their bounds and descriptions."""

from __future__ import annotations

from typing import Annotated, Any

from pydantic import BeforeValidator, Field

from ros2_mcp.ops.sources.selection import MAX_MESSAGES
from ros2_mcp_bridge.limits import MAX_DURATION_S


def _no_bool(value: Any) -> Any:
    """Python's `True` is the integer 1: as a number it can only be a mistake."""
    if isinstance(value, bool):
        raise ValueError("a number is meant")
    return value


def _strictly_bool(value: Any) -> Any:
    """Pydantic would take 1 and "yes" as well, and a flag may decide whether something is sent to the robot."""
    if not isinstance(value, bool):
        raise ValueError("give true or false")
    return value


def _as_text(value: Any) -> Any:
    """Models write seconds as a number, although the argument is a text."""
    return str(value) if isinstance(value, (int, float)) and not isinstance(value, bool) else value


# NaN and infinities are refused: as a time, a rate or a bound they compare in ways that nobody means.
Number = Annotated[float, BeforeValidator(_no_bool), Field(allow_inf_nan=False)]
Whole = Annotated[int, BeforeValidator(_no_bool)]
Flag = Annotated[bool, BeforeValidator(_strictly_bool)]

TopicName = Annotated[str, Field(description="Name of the topic, such as /scan.")]
MessageType = Annotated[
    str,
    Field(description="Type such as sensor_msgs/msg/LaserScan. Leave it out to use the topic's own."),
]
Pattern = Annotated[str, Field(description="Only names that match: a glob such as /camera/*, or any part of a name.")]
# At most: a result as long as that is cut by its size in characters (`binding.py`) before it is by this number.
Limit = Annotated[Whole, Field(ge=1, le=2000, description="How many to list at most.")]
Hidden = Annotated[Flag, Field(description="Also names that ROS hides (a part starting with an underscore).")]
Fields = Annotated[
    list[str] | None,
    Field(description='Only these parts of a message, such as ["pose.pose.position", "ranges[0:10]"]. Default: all.'),
]
# At most 10,000 elements: with three digits and a comma each that is 40 kB, and a result has 32 kB.
MaxArray = Annotated[
    Whole,
    Field(ge=0, le=10_000, description="Show arrays up to this length in full; longer ones are summarised."),
]
EveryN = Annotated[Whole, Field(ge=1, le=1_000_000, description="Keep only every n-th message.")]
FromBag = Annotated[str, Field(description='Ask this recording instead of the robot now; "black box": our own.')]
FromStart = Annotated[str, Field(description='Of the recording: ISO 8601 with zone, or "last 30 s".')]
UpToEnd = Annotated[str, Field(description="Written like start.")]
Seconds = Annotated[Number, Field(ge=0, le=MAX_DURATION_S)]
Duration = Annotated[Number | None, Field(gt=0, le=MAX_DURATION_S, description="Collect for this long, in seconds.")]
MessageLimit = Annotated[
    Whole | None,
    Field(ge=1, le=MAX_MESSAGES, description="Stop after this many messages (alone: waiting at most 20 s)."),
]
NumericFields = Annotated[
    list[str] | None,
    Field(description='Only these fields, such as ["pose.pose.position", "ranges[0:10]"]. Default: all numeric ones.'),
]
BagName = Annotated[str, Field(description="Name of the bag, as ros2_bag_list shows it.")]
BagStart = Annotated[
    str,
    Field(
        description='From this moment on: ISO 8601 with zone; "last 30 s" is that long before the end, "2 min in" (or '
        '"first 2 min") that long after the beginning.'
    ),
]
BagEnd = Annotated[
    str, Field(description="Up to this moment (a time is included), written like start. Default: the end of the bag.")
]
Since = Annotated[
    str,
    BeforeValidator(_as_text),
    Field(description='Seconds ago, such as "30", or a time like "2030-01-31T12:00:00Z". Default: all that is kept.'),
]
