"""The map and the filter masks: without a publisher, or published as volatile, so that later subscribers get
nothing."""

from __future__ import annotations

import re
from collections.abc import Iterator

from ros2_mcp.model.text import listed, named
from ros2_mcp.ops.navigation.checks.check import MAP, NavCheck
from ros2_mcp.ops.navigation.evidence import GRID, NavEvidence, NavFinding, is_of_role, nodes_of, resolved

_INFO = "nav2_msgs/msg/CostmapFilterInfo"
_READERS = ("global_costmap", "local_costmap", "amcl")
_MOST_NAMES = 4


def _find(evidence: NavEvidence) -> Iterator[NavFinding]:
    for topic in evidence.topics(GRID, _INFO):
        readers = [one for one in topic.subscribers if is_of_role(one.node, *_READERS)]
        if not readers:
            continue
        is_map = _is_map(evidence, topic.topic)
        what, where = "map" if is_map else "mask", named(topic.topic)
        who = listed(nodes_of(readers), _MOST_NAMES)
        rank = "stops everything" if is_map else "makes it worse"
        if not topic.publishers:
            gone = evidence.graph.left.topics.get(topic.topic, ())
            told = f"{listed(list(gone), 2)} published it earlier, and has left." if gone else ""
            elsewhere = [] if gone or not is_map else _elsewhere(evidence, topic.topic)
            yield NavFinding(
                rank=rank,
                subject=topic.topic,
                cause=f"{who} takes its map from {where}, which has no publisher; the map is on {named(elsewhere[0])}."
                if elsewhere
                else f"There is no {what}: {who} waits for {where}, which has no publisher.",
                proof=told or "Without one the costmap has its default size, and goals seem to lie outside of it.",
                remedy=f"Set its map_topic to {elsewhere[0]}, or remap it."
                if elsewhere
                else "Start map_server with a map (and its lifecycle manager), or slam_toolbox.",
            )
            continue
        volatile = [one for one in topic.publishers if one.qos.durability == "volatile"]
        if len(volatile) == len(topic.publishers):
            wants = [one for one in readers if one.qos.durability == "transient_local"]
            how = f"{listed(nodes_of(wants), _MOST_NAMES)} asks for transient_local" if wants else "who comes later"
            yield NavFinding(
                rank=rank,
                subject=topic.topic,
                cause=f"The {what} never reaches {who}: {listed(nodes_of(volatile), 2)} publishes {where} as volatile.",
                proof=f"{how[:1].upper()}{how[1:]}, which a volatile publisher never serves."
                if wants
                else "A volatile publisher sends nothing to those who subscribe after it was published.",
                remedy="Publish it with durability transient_local, as map_server does.",
            )


def _is_map(evidence: NavEvidence, topic: str) -> bool:
    """Whether a topic is that of a map, by its name or by a `map_topic` of the nodes that read it; else of a mask."""
    if topic.rpartition("/")[2] == "map":
        return True
    nodes = evidence.of_role(*_READERS)
    return any(
        name.rpartition(".")[2] == "map_topic" and isinstance(value, str) and resolved(node, value) == topic
        for node in nodes
        for name, value in (evidence.parameters or {}).get(node, {}).items()
    )


def _elsewhere(evidence: NavEvidence, topic: str) -> list[str]:
    """The topics on which another map is published, the most likely first; none if that is not clear."""
    others = [
        one.topic
        for one in evidence.topics(GRID)
        if one.publishers and one.topic != topic and not re.search("costmap|mask|filter", one.topic)
    ]
    named_map = [one for one in others if one.rpartition("/")[2] == "map"]
    return named_map if len(named_map) == 1 else others if len(others) == 1 else []


CHECK = NavCheck((), _find, MAP)
