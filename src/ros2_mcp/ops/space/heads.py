"""Rate and frame of topics whose messages begin with a header, from the first bytes of each message."""

from __future__ import annotations

import asyncio
import struct
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from time import monotonic

import anyio

from ros2_mcp.model.errors import RobotError
from ros2_mcp.model.samples import STAMP_END, Sample
from ros2_mcp.ops.sources.source import Source
from ros2_mcp.robot import Robot

_HEAD_BYTES = 256
"""Enough for the header with its `frame_id`; the rest, such as an image, is not transmitted."""
_ENOUGH, _ENOUGH_NS = 5, 600_000_000
"""So many messages over at least this time (ns) are enough to measure a rate."""
_RARE_S = 0.5
"""A topic is rare (below 2 Hz) if no second message follows for this long, or none but one came within twice this
time."""
_RECENT_NS = 5_000_000_000
"""The part at the end of a recording that is read, in ns: enough for a topic published once a second."""


@dataclass(frozen=True, slots=True)
class Head:
    """The head of one topic: the number of messages received, the rate (None: too few messages), the newest message's
    `frame_id`, and whether the only message received implies a rate below 2 Hz.
    """

    count: int
    rate_hz: float | None
    frame: str
    is_rare: bool = False


async def heads_of(robot: Robot, source: Source, topics: Sequence[str], listen_s: float) -> Mapping[str, Head]:
    """Listen to all topics at once until the rate of each is known, for at most `listen_s`; of a recording read the
    end.

    Return the heads by topic; topics without a subscription within that time are absent.
    """
    look = _live_head if source.is_live else _recorded_head
    found = await asyncio.gather(*(look(robot, source, topic, listen_s) for topic in topics))
    return {topic: head for topic, head in zip(topics, found, strict=True) if head is not None}


async def _live_head(robot: Robot, _: Source, topic: str, listen_s: float) -> Head | None:
    found: list[Sample] = []
    ends_at, began_at, last_at = monotonic() + listen_s, 0.0, 0.0
    with suppress(RobotError), anyio.move_on_after(listen_s):
        async with robot.listen(topic, head_bytes=_HEAD_BYTES, is_volatile=True) as listening:
            began_at = monotonic()
            async for sample in listening.samples(ends_at - monotonic()):
                found.append(sample)
                last_at = monotonic()
                if len(found) >= _ENOUGH and sample.received_ns - found[0].received_ns >= _ENOUGH_NS:
                    break
    now = monotonic()
    is_rare = len(found) == 1 and (now - last_at > _RARE_S or now - began_at > 2 * _RARE_S)
    return _head(found, is_rare=is_rare) if began_at else None


async def _recorded_head(_: Robot, source: Source, topic: str, __: float) -> Head:
    found: list[Sample] = []
    end_ns = source.covers_ns[1] if source.covers_ns else 0
    with suppress(RobotError):
        part = source.part(end_ns - _RECENT_NS, end_ns) if end_ns else source
        async with part.follow(topic, latched=False) as stream:
            async for batch in stream.batches:
                found += [Sample(one.received_ns, one.source_ns, one.sequence, one.data[:_HEAD_BYTES]) for one in batch]
    return _head(found, is_rare=len(found) == 1 and end_ns - found[0].received_ns > _RARE_S * 1e9)


def _head(samples: Sequence[Sample], *, is_rare: bool) -> Head:
    if not samples:
        return Head(0, None, "")
    return Head(len(samples), rate_of(samples), _frame_of(samples[-1].data), is_rare)


def rate_of(samples: Sequence[Sample]) -> float | None:
    """Return the rate in Hz from the times of sending; None if there are fewer than two messages."""
    span_ns = _sent_ns(samples[-1]) - _sent_ns(samples[0])
    return (len(samples) - 1) / span_ns * 1e9 if len(samples) > 1 and span_ns > 0 else None


def _sent_ns(sample: Sample) -> int:
    """Return the source timestamp, else the time of receipt: latched messages are received together, whenever they were
    sent.
    """
    return sample.source_ns or sample.received_ns


def _frame_of(data: bytes) -> str:
    """Return the `frame_id` of a message that begins with a std_msgs/msg/Header, from its CDR bytes; empty if it is cut
    off.
    """
    if len(data) < STAMP_END + 4:
        return ""
    (length,) = struct.unpack_from("<I" if data[1] & 1 else ">I", data, STAMP_END)
    name = data[STAMP_END + 4 : STAMP_END + 4 + max(length - 1, 0)]
    return name.decode("utf-8", "replace") if length and len(name) == length - 1 else ""
