"""List nodes, as `ros2 node list` does."""

from __future__ import annotations

import asyncio
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field

from ros2_mcp.model import names
from ros2_mcp.model.text import counted_of
from ros2_mcp.ops.results.results import IF_ANY, SAID, list_note
from ros2_mcp.robot import Robot


@dataclass(frozen=True, slots=True, kw_only=True)
class NodeList:
    """The nodes of the graph by full name; `duplicates` are names that several nodes share, which is a fault."""

    nodes: Sequence[str]
    total: int = field(metadata=SAID)
    settled: bool = field(metadata=SAID)
    duplicates: Sequence[str]
    note: str = field(metadata=IF_ANY)

    def summary(self) -> str:
        """Return the result in one line."""
        return f"{counted_of(len(self.nodes), self.total, 'node')}. {self.note}".rstrip()


async def list_nodes(robot: Robot, pattern: str = "", include_hidden: bool = False, limit: int = 200) -> NodeList:
    """Return the nodes whose full names match the pattern, sorted, without this server's own."""
    found, absence = await asyncio.gather(robot.graph.nodes(), robot.graph.absence())
    others = [row.name for row in found if row.name not in robot.graph.own_nodes]
    visible = sorted(name for name in others if include_hidden or not names.is_hidden(name))
    chosen = names.matching(visible, pattern)
    return NodeList(
        nodes=chosen[:limit],
        total=len(visible),
        settled=found.settled,
        duplicates=[name for name, count in Counter(visible).items() if count > 1],
        note=list_note(len(chosen), limit, found.settled, absence),
    )
