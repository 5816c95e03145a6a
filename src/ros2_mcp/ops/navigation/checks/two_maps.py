"""Two nodes that publish different maps on one topic: a subscriber has the map that came last."""

from __future__ import annotations

from collections.abc import Iterator

from ros2_mcp.model.text import listed, named
from ros2_mcp.ops.navigation.checks.check import LOCALISER, NavCheck
from ros2_mcp.ops.navigation.evidence import NavEvidence, NavFinding, nodes_of
from ros2_mcp.world.costmap import CostGrid

_MOST_NAMES, _MOST_MAPS = 4, 3


def _find(evidence: NavEvidence) -> Iterator[NavFinding]:
    grids = evidence.grids
    if grids is None:
        return
    topic = evidence.topic(grids.map_topic)
    publishers = nodes_of(topic.publishers)
    if len(topic.publishers) < 2 or len(grids.maps) < 2:
        return
    who = listed(publishers, _MOST_NAMES) if len(publishers) > 1 else f"{len(topic.publishers)} publishers"
    yield NavFinding(
        rank="stops everything",
        subject=topic.topic,
        cause=f"Different maps are published on {named(topic.topic)}, by {who}: a subscriber has the last one.",
        proof=f"{len(grids.maps)} maps came: {'; '.join(map(_in_words, grids.maps[:_MOST_MAPS]))}.",
        remedy="End one of them (a second map_server, or SLAM beside it), and load the right map again.",
        covers=("localisation",),
    )


def _in_words(grid: CostGrid) -> str:
    height, width = grid.cells.shape
    return f"{width} x {height} cells of {grid.resolution_m:.3g} m, {int((grid.cells >= 65).sum())} occupied"


CHECK = NavCheck(("grids",), _find, LOCALISER)
