"""What has been seen of the robot in this session, and what of it has left.

Servers like this one and the tools of ROS's command line are no part of a robot.
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
"""Names that are remembered: ten times what large robots have. A system that makes new ones for ever must not fill the
memory; what was seen first is forgotten."""
_BRIDGES = re.compile(rf"/{BRIDGE_NODE}\d+")
_OF_ONE_PROCESS = re.compile(r"_(\d{3,}|[0-9a-f]{8,})$")
"""Of `launch_ros_4711` or `transform_listener_impl_5581ab4b0a20`: it never comes back, and nobody misses it."""
_MAX_LISTED = 20
"""Names of each kind in one sentence: they say which robot it was. No more are kept of who published on a topic."""


@dataclass(frozen=True, slots=True)
class Left:
    """What was seen earlier and is not there any more: nodes, and topics without a publisher by who published them.

    `types` are those of the topics.
    """

    nodes: Collection[str] = ()
    topics: Mapping[str, Sequence[str]] = field(default_factory=dict[str, Sequence[str]])
    types: Mapping[str, str] = field(default_factory=dict[str, str])

    def __str__(self) -> str:
        """In words; empty where nothing has left."""
        parts = [
            f"{kind} {listed(sorted(found), _MAX_LISTED)}"
            for kind, found in (("nodes", self.nodes), ("topics", self.topics))
            if found
        ]
        return f"Seen earlier in this session, and gone: {'; '.join(parts)}." if parts else ""


class Seen:
    """The robot's nodes and the topics that they published on, as far as the graph was asked in this session."""

    def __init__(self) -> None:
        self._nodes: dict[str, None] = {}
        self._publishers: dict[str, set[str]] = {}
        self._types: dict[str, str] = {}
        self._subscribers: dict[str, frozenset[str]] = {}
        self._ran: dict[str, None] = {}

    def note_stream(self, topic: str) -> None:
        """Notes that messages come on a topic all the time."""
        self._ran.setdefault(topic)
        if len(self._ran) > _MOST:
            del self._ran[next(iter(self._ran))]

    @property
    def ran(self) -> Collection[str]:
        """The topics that were a stream at some time of this session."""
        return self._ran.keys()

    def knows(self, node: str) -> bool:
        """Whether the node was seen before, or is one that is never noted."""
        return node in self._nodes or not _is_missed(node)

    def note(self, node: str, topics: Mapping[str, str] | None = None) -> None:
        """Notes that a node is there and publishes on these topics; `topics` are their types by their names."""
        if not _is_missed(node):
            return
        if node.startswith("/"):  # else the endpoint is of no ROS node
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
        """Notes which nodes subscribe to a topic now."""
        self._subscribers.pop(topic, None)
        self._subscribers[topic] = frozenset(node for node in nodes if is_of_robot(node) and node != names.UNKNOWN_NODE)
        if len(self._subscribers) > _MOST:
            del self._subscribers[next(iter(self._subscribers))]

    def subscribers(self, topic: str) -> Collection[str]:
        """The robot's nodes that subscribed to a topic when its endpoints were last looked up."""
        return self._subscribers.get(topic, frozenset())

    def published(self, types: Collection[str]) -> Sequence[str]:
        """The topics of these types that a node of the robot was ever seen to publish."""
        return [topic for topic, type_name in self._types.items() if type_name in types]

    def left(self, nodes: Collection[str], topics: Mapping[str, TopicEndpoints]) -> Left:
        """What of it is not there any more, where these are the nodes, and the topics with their endpoints."""
        published = {
            name for name, found in topics.items() if any(is_of_robot(one.node) for one in found.publishers)
        }  # fmt: skip
        present = set(nodes)
        silenced = {topic: sorted(by) for topic, by in self._publishers.items() if topic not in published}
        return Left(
            [node for node in self._nodes if node not in present],
            silenced,
            {topic: self._types[topic] for topic in silenced if topic in self._types},
        )


def _is_missed(node: str) -> bool:
    """Whether somebody may ask for the node when it has left."""
    return is_of_robot(node) and not _OF_ONE_PROCESS.search(node) and node != names.UNKNOWN_NODE


def is_of_robot(node: str) -> bool:
    """Whether a node may be a robot's: no bridge of a server like this one, and hidden as ROS's own tools are."""
    return not (_BRIDGES.fullmatch(node) or names.is_hidden(node))
