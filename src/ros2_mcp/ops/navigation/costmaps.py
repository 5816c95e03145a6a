"""Costmaps as Nav2 tells them: whole ones as occupancy grids or raw, and what has changed in them since.

Nav2 sends a costmap that does not roll whole only once, and from then on the parts that change, to those who listen.
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
"""For the first part that changes: Nav2 looks once a second what has changed."""
_RAW = "_raw"


@dataclass(frozen=True, slots=True)
class Costmap:
    """A grid with what has changed in it, the sample in which it was sent whole, and in words how old both are.

    `newest_ns` is when the newest of it was sent; None where there are no updates. `is_complete`: nothing that changed
    is known to be missing. `age` says that all of it was sent before anybody listened here.
    """

    grid: CostGrid
    sample: Sample
    skipped: str = ""
    note: str = ""
    newest_ns: int | None = None
    is_complete: bool = True
    age: str = ""


def chosen_costmaps(grids: Sequence[str], raw: Sequence[str]) -> list[str]:
    """The topics of grids, and those of raw costmaps that are not told as grids, too."""
    return [*grids, *(name for name in raw if name.removesuffix(_RAW) not in grids)]


def updates_of(topic: str, updates: Sequence[str]) -> str:
    """The topic with what changes in a costmap; empty where there is none."""
    name = f"{topic}_updates"
    return name if name in updates else ""


async def costmap_of(robot: Robot, source: Source, topic: str, type_name: str, wait_s: float) -> Costmap:
    """The costmap with what has changed in it since it was sent whole: live as it is now, else at the recording's end.

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
    """The costmap as it is now, as far as its changes are heard; `newer_s`: waits so long for what is newer than this.

    Raises:
        RobotError: as `next_message`, and `BadData` if it does not fit its size.
    """
    unheard = ""
    if updates_topic:
        try:
            kept = await costmaps_of(robot).last(topic, updates_topic, wait_s, first_s=FIRST_S, newer_s=newer_s)
        except RobotError as error:  # such as: their type is not known where the bridge runs
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
    """The costmap at the end of a recording's part: the last whole one, with all that was changed in it since.

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
