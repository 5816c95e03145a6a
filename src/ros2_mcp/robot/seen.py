"""The nodes and topics of the robot that were seen in this session, and the nodes and topics that have disappeared
since.

Servers like this one and the ROS command-line tools are not part of a robot.
"""

from __future__ import annotations

import re
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field

from ros2_mcp.model import names
from ros2_mcp.model.graph import OF_EVERY_NODE, TopicEndpoints
from ros2_mcp.model.text import listed
from ros2_mcp_common.wire.protocol import BRIDGE_NODE

_MOST = 5000
"""The most names that are remembered: ten times the number in large robots. A system that creates new names without end
must not fill the memory; the names that were seen first are forgotten."""
_BRIDGES = re.compile(rf"/{BRIDGE_NODE}\d+")
_OF_ONE_PROCESS = re.compile(r"_(\d{3,}|[0-9a-f]{8,})$")
"""The end of names such as `launch_ros_4711` or `transform_listener_impl_5581ab4b0a20`: such a node never returns, and
is not missed."""
_MAX_LISTED = 20
"""The most names of each kind in one sentence: enough to recognise the robot. Also the most publishers that are kept
per topic."""


@dataclass(frozen=True, slots=True)
class Left:
    """Nodes that were seen earlier and have disappeared, and topics without a publisher, each with its former
    publishers.

    `types` are the types of the topics.
    """

    nodes: Collection[str] = ()
    topics: Mapping[str, Sequence[str]] = field(default_factory=dict[str, Sequence[str]])
    types: Mapping[str, str] = field(default_factory=dict[str, str])

    def __str__(self) -> str:
        """Return a sentence, or "" if nothing has disappeared."""
        parts = [
            f"{kind} {listed(sorted(found), _MAX_LISTED)}"
            for kind, found in (("nodes", self.nodes), ("topics", self.topics))
            if found
        ]
        return f"Seen earlier in this session, and gone: {'; '.join(parts)}." if parts else ""


class Seen:
    """The robot's nodes and the topics that they published, as far as the graph was queried in this session."""

    def __init__(self) -> None:
        self._nodes: dict[str, None] = {}
        self._publishers: dict[str, set[str]] = {}
        self._types: dict[str, str] = {}
        self._subscribers: dict[str, frozenset[str]] = {}
        self._ran: dict[str, None] = {}

    def note_stream(self, topic: str) -> None:
        """Record that a topic has a continuous stream of messages."""
        self._ran.setdefault(topic)
        if len(self._ran) > _MOST:
            del self._ran[next(iter(self._ran))]

    @property
    def ran(self) -> Collection[str]:
        """The topics that were streams at some time in this session."""
        return self._ran.keys()

    def knows(self, node: str) -> bool:
        """Return whether the node was seen before, or is a node that is never recorded."""
        return node in self._nodes or not _is_missed(node)

    def note(self, node: str, topics: Mapping[str, str] | None = None) -> None:
        """Record that a node exists and publishes these topics; `topics` maps their names to their types."""
        if not _is_missed(node):
            return
        if node.startswith("/"):  # otherwise the endpoint belongs to no ROS node
            self._nodes.setdefault(node)
        for topic, type_name in (topics or {}).items():
            if topic in OF_EVERY_NODE or names.is_hidden(topic):
                continue
            self._types[topic] = type_name
            nodes = self._publishers.setdefault(topic, set())
            if len(nodes) < _MAX_LISTED:
                nodes.add(node)
        for kept in (self._nodes, self._publishers, self._types):
            if len(kept) > _MOST:
                del kept[next(iter(kept))]

    def note_subscribers(self, topic: str, nodes: Collection[str]) -> None:
        """Record the present subscribers of a topic."""
        self._subscribers.pop(topic, None)
        self._subscribers[topic] = frozenset(node for node in nodes if is_of_robot(node) and node != names.UNKNOWN_NODE)
        if len(self._subscribers) > _MOST:
            del self._subscribers[next(iter(self._subscribers))]

    def subscribers(self, topic: str) -> Collection[str]:
        """Return the robot's nodes that subscribed to a topic when its endpoints were last queried."""
        return self._subscribers.get(topic, frozenset())

    def published(self, types: Collection[str]) -> Sequence[str]:
        """Return the topics of these types that a node of the robot was ever seen to publish."""
        return [topic for topic, type_name in self._types.items() if type_name in types]

    def left(self, nodes: Collection[str], topics: Mapping[str, TopicEndpoints]) -> Left:
        """Return the nodes and topics that have disappeared, given the present nodes, and the topics with their present
        endpoints.
        """
        published = {
            name for name, found in topics.items() if any(is_of_robot(one.node) for one in found.publishers)
        }  # fmt: skip
        # a node that has just appeared may be known by its publishers before it is listed as a node
        present = {*nodes, *(one.node for found in topics.values() for one in found.publishers)}
        silenced = {topic: sorted(by) for topic, by in self._publishers.items() if topic not in published}
        return Left(
            [node for node in self._nodes if node not in present],
            silenced,
            {topic: self._types[topic] for topic in silenced if topic in self._types},
        )


def _is_missed(node: str) -> bool:
    """Return whether a node may be missed after it has disappeared."""
    return is_of_robot(node) and not _OF_ONE_PROCESS.search(node) and node != names.UNKNOWN_NODE


def is_of_robot(node: str) -> bool:
    """Return whether a node may belong to a robot: no bridge of a server like this server, and not hidden, as ROS's
    tools are.
    """
    return not (_BRIDGES.fullmatch(node) or names.is_hidden(node))
