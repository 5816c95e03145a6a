"""Reads costmaps with their updates: occupancy grids or raw costmaps, live or from a recording.

Nav2 publishes a costmap that does not roll in full only once, and afterwards only the parts that changed.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

from ros2_mcp.model.aside import aside, load
from ros2_mcp.model.errors import BadData, RobotError, TimedOut
from ros2_mcp.model.nav2 import COSTMAP_UPDATE, GRID_UPDATE
from ros2_mcp.model.samples import Sample
from ros2_mcp.model.text import named
from ros2_mcp.ops.navigation.last_costmaps import LastCostmap, costmaps_of, sent_ns
from ros2_mcp.ops.pictures.next_message import next_message
from ros2_mcp.ops.results.results import silent
from ros2_mcp.ops.sources.source import Source
from ros2_mcp.robot import Robot

if TYPE_CHECKING:
    from ros2_mcp.world.costmap import CostGrid

FIRST_S = 1.2
"""Wait for the first update: Nav2 checks once a second which parts have changed."""
_RAW = "_raw"


@dataclass(frozen=True, slots=True)
class Costmap:
    """A costmap with its updates applied, and the message in which it was published in full.

    `newest_ns` is the time of the newest message that it contains; None if the updates are unknown. `is_complete`: no
    update is known to be missing. `note` says how old the costmap and its updates are, `age` that it was published
    before this server subscribed, `skipped` why a message was not used.
    """

    grid: CostGrid
    sample: Sample
    skipped: str = ""
    note: str = ""
    newest_ns: int | None = None
    is_complete: bool = True
    age: str = ""


def chosen_costmaps(grids: Sequence[str], raw: Sequence[str]) -> list[str]:
    """Return the topics of the grids, followed by the raw costmaps that have no grid topic."""
    return [*grids, *(name for name in raw if name.removesuffix(_RAW) not in grids)]


def updates_of(topic: str, updates: Sequence[str]) -> str:
    """Return the topic of a costmap's updates; "" if it is not among `updates`."""
    name = f"{topic}_updates"
    return name if name in updates else ""


async def costmap_of(robot: Robot, source: Source, topic: str, type_name: str, wait_s: float) -> Costmap:
    """Return a costmap with all updates since it was published in full: live, or at the end of a recording.

    Raises:
        RobotError: as `next_message`, and `BadData` if it does not fit its size.
    """
    updates = updates_of(topic, await source.publishing(GRID_UPDATE, COSTMAP_UPDATE))
    if source.is_live:
        return await costmap_now(robot, source, topic, type_name, updates, wait_s)
    return await costmap_recorded(source, topic, type_name, updates)


async def costmap_now(
    robot: Robot, source: Source, topic: str, type_name: str, updates_topic: str, wait_s: float, *, newer_s: float = 0.0
) -> Costmap:
    """Return the live costmap with the updates received so far. With `newer_s`, wait that long for a message newer than
    this call.

    Raises:
        RobotError: as `next_message`, and `BadData` if it does not fit its size.
    """
    unheard = ""
    if updates_topic:
        try:
            kept = await costmaps_of(robot).last(topic, updates_topic, wait_s, first_s=FIRST_S, newer_s=newer_s)
        except RobotError as error:  # e.g. the type of the updates is not installed where the bridge runs
            unheard = f"Updates of {named(topic)} are unknown: {error.message}"
        else:
            if kept.grid is None or kept.whole is None:
                raise TimedOut(f"No message on {topic} (live, {wait_s:g} s).")
            note = _known(kept, kept.whole, robot.now_ns())
            return Costmap(kept.grid, kept.whole, kept.refused, note, kept.newest_ns, kept.is_complete)
    found = await next_message(source.lasting(wait_s), topic, type_name, silent)
    await load("ros2_mcp.world.cost_updates")  # with numpy: not before it is needed
    from ros2_mcp.world.cost_updates import as_grid

    grid = await aside(len(found.sample.data), as_grid, type_name, found.message)
    return Costmap(grid, found.sample, found.skipped, unheard, is_complete=not unheard, age=found.age)


async def costmap_recorded(source: Source, topic: str, type_name: str, updates_topic: str) -> Costmap:
    """Return the costmap at the end of the selected span of a recording: the last full costmap with all later updates.

    Raises:
        RobotError: as `next_message`, and `BadData` if it does not fit its size.
    """
    await load("ros2_mcp.world.cost_updates")  # with numpy: not before it is needed
    from ros2_mcp.world.cost_updates import as_grid, updated

    found = await next_message(source, topic, type_name, silent)
    size = len(found.sample.data)
    grid = await aside(size, as_grid, type_name, found.message)
    if not updates_topic or source.covers_ns is None:
        return Costmap(grid, found.sample, found.skipped)
    until_ns, last, count, refused = source.covers_ns[1], None, 0, found.skipped
    async with source.part(found.sample.received_ns, until_ns).follow(updates_topic, latched=False) as stream:
        async for batch in stream.batches:
            for sample in batch:
                if sent_ns(sample) < sent_ns(found.sample):
                    continue
                try:
                    update = await aside(len(sample.data), stream.codec.decode, stream.type, sample.data)
                    grid = await aside(size, updated, grid, stream.type, update)
                except BadData as error:
                    refused = error.message
                    continue
                last, count = sample, count + 1
        holes = stream.holes
    note = _ages(topic, found.sample, last, count, until_ns)
    is_complete = not holes and (source.began_ns or 0) <= sent_ns(found.sample)
    if not is_complete:
        note += " Some later updates were not recorded."
    return Costmap(grid, found.sample, refused, note, sent_ns(last or found.sample), is_complete)


def _known(kept: LastCostmap, whole: Sample, now_ns: int) -> str:
    ages = _ages(kept.topic, whole, kept.update, kept.updates, now_ns)
    if kept.is_complete:
        return ages
    return f"{ages} Updates from before this server first listened, {_ago(kept.since_ns, now_ns)}, are unknown."


def _ages(topic: str, whole: Sample, update: Sample | None, count: int, now_ns: int) -> str:
    sent = f"The costmap {named(topic)} was sent whole {_ago(sent_ns(whole), now_ns)}"
    if update is None:
        return f"{sent}; no update since."
    return f"{sent}; updates since: {count}, the last {_ago(sent_ns(update), now_ns)}."


def _ago(at_ns: int, now_ns: int) -> str:
    return f"{max(now_ns - at_ns, 0) / 1e9:.1f} s ago"
