"""List topics, as `ros2 topic list` does."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

from ros2_mcp.model import names
from ros2_mcp.model.text import counted_of
from ros2_mcp.ops.results.results import IF_ANY, ON_REQUEST, SAID, list_note
from ros2_mcp.robot import Robot

_FEW = 8
"""Up to this many internal topics are listed: a robot without Nav2 has hardly as many."""
_INTERNAL_TYPES = frozenset(
    {
        "bond/msg/Status",
        "lifecycle_msgs/msg/TransitionEvent",
        "map_msgs/msg/OccupancyGridUpdate",
        "nav2_msgs/msg/Costmap",
        "nav2_msgs/msg/CostmapUpdate",
        "nav2_msgs/msg/VoxelGrid",
    }
)
_INTERNAL_NAMES = frozenset({"clearing_endpoints", "voxel_marked_cloud", "voxel_unknown_cloud", "evaluation"})


@dataclass(frozen=True, slots=True, kw_only=True)
class TopicEntry:
    """One topic; `topic_types` is set only if the topic has several types, which is a fault.

    `request_fields` maps the fields of the messages to their types, if requested.
    """

    topic_name: str
    topic_type: str
    publishers: int
    subscribers: int
    topic_types: Sequence[str] = ()
    request_fields: dict[str, Any] | None = field(default=None, metadata=ON_REQUEST)


@dataclass(frozen=True, slots=True)
class TopicList:
    """The topics of the graph; `settled` is false if discovery was still under way when the wait for it ended."""

    topics: Sequence[TopicEntry]
    total: int = field(metadata=SAID)
    settled: bool = field(metadata=SAID)
    note: str = field(metadata=IF_ANY)

    def summary(self) -> str:
        """Return the result in one line."""
        return f"{counted_of(len(self.topics), self.total, 'topic')}. {self.note}".rstrip()


def is_internal(name: str, types: Sequence[str]) -> bool:
    """Return whether a topic is internal to nodes or for debugging, like dozens of topics
    of Nav2 and its lifecycle nodes.
    """
    return not _INTERNAL_TYPES.isdisjoint(types) or name.rpartition("/")[2] in _INTERNAL_NAMES


async def list_topics(
    robot: Robot, pattern: str = "", include_hidden: bool = False, limit: int = 200, *, with_fields: bool = False
) -> TopicList:
    """Return the topics whose names or types match the pattern (a glob, or any part of a name), sorted by name."""
    found, absence = await robot.graph.topics_and_absence(count_most=limit)
    visible = {row.name: row for row in found if include_hidden or not names.is_hidden(row.name)}
    chosen = names.matching(sorted(visible), pattern, lambda name: visible[name].types)
    note = ""
    internals = {name for name in chosen if is_internal(name, visible[name].types)}
    if len(internals) > _FEW and not (pattern or include_hidden):
        chosen = [name for name in chosen if name not in internals]
        note = (
            f"Not shown: {len(internals)} internal topics (bonds, transition events, costmaps' raw forms, updates and "
            "debug clouds); a pattern or include_hidden=true lists them. "
        )
    note += list_note(len(chosen), limit, found.settled, absence)
    rows = await robot.graph.counted([visible[name] for name in chosen[:limit]])
    fields, unknown = await robot.values.fields_of(row.types[0] for row in rows) if with_fields else ({}, "")
    topics = [
        TopicEntry(
            topic_name=row.name,
            topic_type=row.types[0],
            publishers=row.publishers,
            subscribers=row.subscribers,
            topic_types=row.types if len(row.types) > 1 else (),
            request_fields=fields.get(row.types[0]),
        )
        for row in rows
    ]
    return TopicList(topics, len(visible), found.settled, " ".join(filter(None, (note, unknown))))
