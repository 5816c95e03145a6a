"""Requests about the ROS graph, which are answered as soon as discovery has settled."""

from __future__ import annotations

import math
import time
from collections.abc import Iterable, Sequence
from contextlib import suppress
from typing import TYPE_CHECKING

from ros2_mcp_bridge.request import OperationError, Request, Steps
from ros2_mcp_bridge.ros import participants, qos, rcl
from ros2_mcp_common.policy.keep_out import STANDING_GOALS
from ros2_mcp_common.policy.velocity import MOTION_TYPES
from ros2_mcp_common.policy.verbs import matches, meaning
from ros2_mcp_common.wire.protocol import (
    NOT_COUNTED,
    CountedReply,
    Endpoint,
    EndpointsReply,
    NodeReply,
    NodesReply,
    ServersReply,
    ServicesReply,
    TopicsReply,
)

if TYPE_CHECKING:
    from rclpy.node import Node
    from rclpy.topic_endpoint_info import TopicEndpointInfo

# The period at which the whole graph is listed; about seven listings fit into QUIET_S.
POLL_S = 0.06
# The graph is quiet when nothing has changed for this time. It need not be as long as the period of announcements,
# because the participants on this machine are counted, too.
QUIET_S = 0.4
# Fast DDS announces itself every 3 s (decision 13): a little after that, every participant has been discovered.
ANNOUNCEMENT_PERIOD_S = 3.5
# A graph that keeps changing is listed as it is after this time.
LONGEST_SETTLING_S = 10.0
# The default of `settle_s`: the period of announcements (decision 13).
SETTLE_S = 3.0
# The longest wait for the names of nodes, which come a little after their endpoints, mostly milliseconds. If they do
# not come at all, as after the robot was frozen for longer than its lease, they are waited for only once.
NAMES_S = 1.0
# The polling period of a waiting request; each time costs a look at one number, or at the endpoints of one topic.
WAIT_POLL_S = 0.02
UNKNOWN_NODE = "_NODE_NAME_UNKNOWN_"
CLOCK = "/clock"


class Graph:
    """Answers the requests about the graph; most are steps, because they may have to wait."""

    def __init__(self, node: Node) -> None:
        self.settled = False
        self._node = node
        self._nameless: set[str] = set()

    def settle(self) -> Steps[None]:
        """Steps that watch discovery until the graph has been quiet for some time, or the
        longest settling time is over.
        """
        started = looked_at = time.monotonic()
        seen, quiet_s = None, 0.0
        while not self.settled:
            yield POLL_S
            now, current = time.monotonic(), self._snapshot()
            # Lateness of this process is no quiet: other processes that stalled with it have not sent anything
            # meanwhile.
            quiet_s = quiet_s + min(now - looked_at, 2 * POLL_S) if current == seen else 0.0
            seen, looked_at = current, now
            topics = [name for name, _ in self._node.get_topic_names_and_types()]
            is_quiet = quiet_s >= QUIET_S and not self._has_unknown_nodes(topics)
            is_whole = self._all_discovered() or now - started >= ANNOUNCEMENT_PERIOD_S
            self.settled = (is_quiet and is_whole) or now - started >= LONGEST_SETTLING_S

    def topics(self, request: Request) -> Steps[TopicsReply]:
        """Steps that return every topic with its types and numbers of endpoints, and every node."""
        yield from self._wait_settled(request)
        found = self._node.get_topic_names_and_types()
        are_counted = len(found) <= request.number("count_most", math.inf)
        counted = self._counted(found) if are_counted else [(NOT_COUNTED, NOT_COUNTED)] * len(found)
        topics = [(name, types, *counts) for (name, types), counts in zip(found, counted, strict=True)]
        return {"topics": topics, "nodes": self._nodes(), "settled": self.settled}

    def counted(self, request: Request) -> CountedReply:
        """Return the numbers of publishers and subscribers of the named topics."""
        types = dict(self._node.get_topic_names_and_types())
        return {"counted": self._counted([(name, types.get(name, ())) for name in request.texts("topics")])}

    def services(self, request: Request) -> Steps[ServicesReply]:
        """Steps that return every service with its types."""
        yield from self._wait_settled(request)
        return {"services": self._node.get_service_names_and_types(), "settled": self.settled}

    def servers(self, request: Request) -> Steps[ServersReply]:
        """Steps that return the nodes that provide a service, found by querying each node.

        Nodes with the same name are listed separately.
        """
        service = request.text("service")
        yield from self._wait_settled(request)
        found: list[tuple[str, str]] = []
        for name, namespace in self._node.get_node_names_and_namespaces():
            with suppress(rcl.RCLError):  # the node has left meanwhile
                served = self._node.get_service_names_and_types_by_node(name, namespace)
                found += [(name, namespace)] if any(service == one for one, _ in served) else []
        return {"servers": found}

    def nodes(self, request: Request) -> Steps[NodesReply]:
        """Steps that return every node."""
        yield from self._wait_settled(request)
        return {"nodes": self._nodes(), "settled": self.settled}

    def node(self, request: Request) -> Steps[NodeReply]:
        """Steps that return the topics and services of one node: what it publishes, subscribes to, serves and calls."""
        name, namespace = request.text("name"), request.text("namespace")
        yield from self._wait_settled(request)
        if (name, namespace) not in self._node.get_node_names_and_namespaces():
            raise OperationError("not_found", f"There is no node {name} in namespace {namespace}.")
        return {
            "publishers": self._node.get_publisher_names_and_types_by_node(name, namespace),
            "subscribers": self._node.get_subscriber_names_and_types_by_node(name, namespace),
            "servers": self._node.get_service_names_and_types_by_node(name, namespace),
            "clients": self._node.get_client_names_and_types_by_node(name, namespace),
        }

    def endpoints(self, request: Request) -> Steps[EndpointsReply]:
        """Steps that return the publishers and subscribers of a topic with their QoS."""
        topic = request.text("topic")
        deadline = time.monotonic() + min(NAMES_S, request.number("settle_s", SETTLE_S))
        yield from self._wait_settled(request)
        while True:
            found = self._endpoints(topic)
            both = *found["publishers"], *found["subscribers"]
            nameless = {endpoint["gid"] for endpoint in both if endpoint["node"] == UNKNOWN_NODE}
            if time.monotonic() >= deadline:
                self._nameless |= nameless
            if nameless <= self._nameless:
                return found
            yield WAIT_POLL_S

    def wait_endpoints(self, request: Request) -> Steps[EndpointsReply]:
        """Steps that return the publishers and subscribers of a topic, as soon as there are enough of them.

        Raises:
            OperationError: of kind `timeout`, if there are not enough in time.
        """
        topic = request.text("topic")
        publishers, subscribers = request.number("publishers", 0), request.number("subscribers", 0)
        deadline = time.monotonic() + request.number("timeout_s")
        while True:
            present = self._count_publishers(topic), self._count_subscribers(topic)
            is_enough = present[0] >= publishers and present[1] >= subscribers
            is_late = time.monotonic() >= deadline
            if is_enough and (is_late or not self._has_unknown_nodes([topic])):
                return self._endpoints(topic)
            if is_late:
                message = "{} has {} publishers and {} subscribers; waited for {} and {}."
                raise OperationError("timeout", message.format(topic, *present, publishers, subscribers))
            yield WAIT_POLL_S

    def moving_actions(self) -> list[str]:
        """Return the names of the actions whose goals may move a robot's base."""
        return sorted(
            meant.name
            for service, types in self._node.get_service_names_and_types()
            for meant in (meaning(service, type_name) for type_name in types)
            if meant.verb == "goal" and not matches(STANDING_GOALS, meant.type)
        )

    def subscribers(self, topic: str) -> list[TopicEndpointInfo]:
        """Return rclpy's information about every subscriber of a topic, except stoppers."""
        return _without_stoppers(self._node.get_subscriptions_info_by_topic(topic))

    def own_subscribers(self, topic: str, type_name: str) -> int:
        """Return the number of subscribers of a topic, with this type, that belong to this bridge."""
        own = self._node.get_name(), self._node.get_namespace()
        return sum(
            (info.node_name, info.node_namespace) == own and info.topic_type == type_name
            for info in self.subscribers(topic)
        )

    def count(self, topic: str) -> tuple[int, int]:
        """Return the numbers of publishers and subscribers of a topic, including the publishers and subscribers of
        stoppers.
        """
        return rcl.count_publishers(self._node, topic), rcl.count_subscribers(self._node, topic)

    def publishers(self, topic: str) -> list[TopicEndpointInfo]:
        """Return rclpy's information about every publisher of a topic, except stoppers."""
        return _without_stoppers(self._node.get_publishers_info_by_topic(topic))

    def stoppers(self, topic: str) -> int:
        """Return the number of publishers of stoppers on a topic."""
        return len(self._node.get_publishers_info_by_topic(topic)) - len(self.publishers(topic))

    def publisher_gids(self, topic: str) -> set[bytes]:
        """Return the global identifiers (GID) of a topic's publishers, except stoppers."""
        return {participants.gid(info) for info in self.publishers(topic)}

    def _nodes(self) -> list[tuple[str, str]]:
        found = self._node.get_node_names_and_namespaces()
        return [node for node in found if not participants.is_stopper(node[0])]

    # Stoppers publish velocity commands, and subscribe to the simulated time: the endpoints of other topics are counted
    # without reading their names.

    def _counted(self, topics: Sequence[tuple[str, Iterable[str]]]) -> list[tuple[int, int]]:
        """Return the numbers of publishers and subscribers of topics, which are given with their types."""
        counts = rcl.counts(self._node, [name for name, _ in topics])
        return [
            (
                len(self.publishers(name)) if publishers and not MOTION_TYPES.isdisjoint(types) else publishers,
                len(self.subscribers(name)) if name == CLOCK else subscribers,
            )
            for (name, types), (publishers, subscribers) in zip(topics, counts, strict=True)
        ]

    def _count_publishers(self, topic: str) -> int:
        return len(self.publishers(topic)) if rcl.count_publishers(self._node, topic) else 0

    def _count_subscribers(self, topic: str) -> int:
        return len(self.subscribers(topic)) if topic == CLOCK else rcl.count_subscribers(self._node, topic)

    def _wait_settled(self, request: Request) -> Steps[None]:
        deadline = time.monotonic() + request.number("settle_s", SETTLE_S)
        while not self.settled and time.monotonic() < deadline:
            yield min(WAIT_POLL_S, max(0.0, deadline - time.monotonic()))

    def _endpoints(self, topic: str) -> EndpointsReply:
        return {
            "publishers": [_endpoint(info) for info in self.publishers(topic)],
            "subscribers": [_endpoint(info) for info in self.subscribers(topic)],
            "settled": self.settled,
        }

    def _snapshot(self) -> object:
        node = self._node
        nodes = sorted(node.get_node_names_and_namespaces())
        return node.get_topic_names_and_types(), node.get_service_names_and_types(), nodes

    def _all_discovered(self) -> bool:
        """Return whether all participants on this machine have been discovered.

        If participants may also be on other machines, the kernel cannot count them: then at least one
        other node has to be there.
        """
        if not participants.all_discovered(self._node):
            return False
        counts_all = participants.reach_is_local() and participants.on_this_machine(self._node.context.get_domain_id())
        ours = self._node.get_name(), self._node.get_namespace()
        return bool(counts_all or set(self._node.get_node_names_and_namespaces()) - {ours})

    def _has_unknown_nodes(self, topics: Iterable[str]) -> bool:
        return any(
            info.node_name == UNKNOWN_NODE
            for topic in topics
            for info in (*self.publishers(topic), *self.subscribers(topic))
        )


def _without_stoppers(infos: list[TopicEndpointInfo]) -> list[TopicEndpointInfo]:
    return [info for info in infos if not participants.is_stopper(info.node_name)]


def _endpoint(info: TopicEndpointInfo) -> Endpoint:
    found_hash = str(getattr(info, "topic_type_hash", ""))  # not in Humble
    return {
        "node": info.node_name,
        "namespace": info.node_namespace,
        "type": info.topic_type,
        "hash": found_hash if found_hash.startswith("RIHS01_") else "",
        "gid": participants.gid(info).hex(),
        "qos": qos.describe(info.qos_profile),
    }
