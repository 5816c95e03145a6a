"""Listing topics, as `ros2 topic list` does."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

from ros2_mcp.model import names
from ros2_mcp.ops.results.results import IF_ANY, ON_REQUEST, SAID, list_note
from ros2_mcp.robot import Robot


@dataclass(frozen=True, slots=True, kw_only=True)
class TopicEntry:
    """One topic; `topic_types` is filled only where there are several, which is a fault of the system.

    `request_fields` is name → type of a message, only where that was asked for.
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
        """One line."""
        return f"{len(self.topics)} of {self.total} topics. {self.note}".rstrip()


async def list_topics(
    robot: Robot, pattern: str = "", include_hidden: bool = False, limit: int = 200, *, with_fields: bool = False
) -> TopicList:
    """The topics whose names or types match the pattern (a glob, or any part of one), sorted by name."""
    found, absence = await robot.graph.topics_and_absence(count_most=limit)
    visible = {row.name: row for row in found if include_hidden or not names.is_hidden(row.name)}
    chosen = names.matching(sorted(visible), pattern, lambda name: visible[name].types)
    note = list_note(len(chosen), limit, found.settled, absence)
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
