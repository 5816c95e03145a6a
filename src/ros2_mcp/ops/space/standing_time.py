"""Stamps of a clock other than the robot's, such as simulated time, also if it has stopped; reported once, not for each
publisher.
"""

from __future__ import annotations

from contextlib import suppress
from typing import Any

from ros2_mcp.model.errors import RobotError
from ros2_mcp.model.text import named
from ros2_mcp.ops.sources.source import Source
from ros2_mcp.world.no_transform import UNIX_FROM_NS, seconds_in_words, stamp_in_words
from ros2_mcp.world.transforms import FrameTree

_CLOCK, _CLOCK_TYPE = "/clock", "rosgraph_msgs/msg/Clock"
_LOOK_S = 0.5
"""Time to wait for two messages of /clock: simulators publish it at 10 Hz or more."""
_TOLD_NS = 1_000_000_000
"""A message received within this time shows that transforms are still published."""
_AHEAD_NS = 1_000_000_000
"""If /clock is ahead of the newest stamp by more than this, simulated time goes on."""


async def standing_time(source: Source, tree: FrameTree, at_ns: int) -> str:
    """Report that the clock by which all transforms are stamped has stopped: since when, at which time, and the state
    of /clock. Empty if it still runs, or if that is unknown because publishers are silent.
    """
    stood_ns = tree.stood_ns(at_ns)
    if not stood_ns:
        return ""
    newest_ns = max(edge.stamps[-1] for edge in tree.edges.values() if edge.moving and edge.moving[-1].stamp_ns)
    is_told = any(at_ns - edge.last_received_ns < _TOLD_NS for edge in tree.edges.values() if edge.moving)
    if source.transforms is None:
        said = "transforms repeat the same stamps" if is_told else ""
    else:
        said = await _clock_in_words(source, newest_ns, is_told=is_told)
    if not said:
        return ""
    return (
        f"Simulated time stopped {seconds_in_words(stood_ns)} ago, at {stamp_in_words(newest_ns)}, and so did all "
        f"stamps: {said}."
    )


async def look_for_clock(source: Source, tree: FrameTree) -> None:
    """Set `tree.has_clock` if /clock is published, provided that some stamps look like simulated time.

    A recording without /clock leaves it unset: /clock is seldom recorded.
    """
    if any(edge.moving and edge.stamps[-1] < UNIX_FROM_NS for edge in tree.edges.values()):
        if source.transforms:
            tree.has_clock = bool(await source.transforms.clock_publishers())
        elif await source.publishing(_CLOCK_TYPE):
            tree.has_clock = True


async def other_clock(source: Source, tree: FrameTree) -> list[str]:
    """Report that all stamps come from a clock other than the robot's, and whether /clock is published; empty if they
    do not.
    """
    if not tree.clock_ns:
        return []
    away = f"{seconds_in_words(tree.clock_ns)} {'behind' if tree.clock_ns > 0 else 'ahead of'} the robot's clock"
    what = "simulated time, or a bag that is played"
    if source.transforms and not await source.transforms.clock_publishers():
        is_wall = all(edge.stamps[-1] >= UNIX_FROM_NS for edge in tree.edges.values() if edge.moving)
        wrong = "clocks that are set wrong" if is_wall else "the time since a machine started, never synchronised"
        what = f"{_CLOCK} has no publisher: a bag that is played without it, or {wrong}"
    return [f"Stamps are {away} ({what}): ages count from receipt."]


async def _clock_in_words(source: Source, newest_ns: int, *, is_told: bool) -> str:
    """Describe the state of /clock that explains the stop; empty if /clock goes on, or if neither it nor transforms are
    received.
    """
    assert source.transforms
    publishers = await source.transforms.clock_publishers()
    if not publishers:
        return f"{_CLOCK} has no publisher any more, so transforms keep its last time" if is_told else ""
    who = " and ".join(map(named, publishers[:2]))
    times: list[int] = []
    with suppress(RobotError):
        async with source.lasting(_LOOK_S).follow(_CLOCK, limit=2) as stream:
            async for batch in stream.batches:
                for sample in batch:
                    message: Any = stream.codec.decode(stream.type, sample.data)
                    times.append(message.clock.sec * 1_000_000_000 + message.clock.nanosec)
    if not times:
        return f"{who} publishes {_CLOCK}, but sends nothing (a simulation that is paused, or hangs)"
    if max(times) != min(times) or max(times) > newest_ns + _AHEAD_NS:
        return ""
    stopped = f"{_CLOCK}, published by {who}, is stopped at {stamp_in_words(max(times))}"
    return f"{stopped} (a simulation that is paused, or hangs)"
