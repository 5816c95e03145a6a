"""Listing topics, as `ros2 topic list` does."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from ros2_mcp.model import names
from ros2_mcp.model.graph import OF_EVERY_NODE
from ros2_mcp.ops.results import list_note
from ros2_mcp.robot import Robot


@dataclass(frozen=True, slots=True, kw_only=True)
class TopicEntry:
    """One topic; `topic_types` is filled only where there are several, which is a fault of the system."""

    topic_name: str
    topic_type: str
    publishers: int
    subscribers: int
    topic_types: Sequence[str] = ()


@dataclass(frozen=True, slots=True)
class TopicList:
    """The topics of the graph; `settled` is false if discovery was still under way when the wait for it ended."""

    topics: Sequence[TopicEntry]
    total: int
    settled: bool
    note: str

    def summary(self) -> str:
        """One line."""
        return f"{len(self.topics)} of {self.total} topics. {self.note}".rstrip()


async def list_topics(robot: Robot, pattern: str = "", include_hidden: bool = False, limit: int = 200) -> TopicList:
    """The topics whose names match the pattern (a glob, or any part of a name), sorted by name."""
    found = await robot.graph.topics()
    visible = {row.name: row for row in found if include_hidden or not names.is_hidden(row.name)}
    chosen = names.matching(sorted(visible), pattern)
    note = list_note(len(chosen), limit, found.settled)
    if visible.keys() <= OF_EVERY_NODE:
        # Only topics of ROS itself: most often the server is in another domain or network than the robot.
        domain = "this domain" if robot.graph.domain_id is None else f"domain {robot.graph.domain_id}"
        note = (
            f"{note} No topic of a robot is seen in {domain}: is the robot on, in the same domain (ROS_DOMAIN_ID), and "
            "reachable from here?"
        ).strip()
    topics = [
        TopicEntry(
            topic_name=row.name,
            topic_type=row.types[0],
            publishers=row.publishers,
            subscribers=row.subscribers,
            topic_types=row.types if len(row.types) > 1 else (),
        )
        for row in (visible[name] for name in chosen[:limit])
    ]
    return TopicList(topics, len(visible), found.settled, note)
