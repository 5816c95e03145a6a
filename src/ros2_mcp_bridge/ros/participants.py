"""The number of DDS participants on this machine, and how many of them a node has discovered.

An RTPS participant listens on well-known UDP ports, which the kernel lists: 7400 + 250 * domain + 10 + 2 * number. So
it is known, without waiting for the next announcement, which participants on this machine are still undiscovered.
"""

from __future__ import annotations

import os
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, cast

from ros2_mcp_common.wire.protocol import BRIDGE_NODE

if TYPE_CHECKING:
    from rclpy.node import Node
    from rclpy.topic_endpoint_info import TopicEndpointInfo

# From the RTPS specification: PB, DG, and the smaller of d1 (10) and d3 (11).
FIRST_PORT = 7400
PORTS_PER_DOMAIN = 250
FIRST_UNICAST = 10
DISCOVERY_TOPIC = "ros_discovery_info"
GUID_PREFIX_BYTES = 12
# The prefix of the names of stoppers' nodes. It makes them hidden, like the nodes of ROS's own tools.
STOPPER_NODE = "_ros2_mcp_stopper_"


def reach_is_local() -> bool:
    """Return whether the environment restricts ROS to this machine."""
    reach = os.environ.get("ROS_AUTOMATIC_DISCOVERY_RANGE", "").upper()
    return reach in ("LOCALHOST", "OFF") or os.environ.get("ROS_LOCALHOST_ONLY") == "1"


def all_discovered(node: Node) -> bool:
    """Return whether a node has discovered all participants on this machine; True if their number is not known."""
    return discovered(node) >= on_this_machine(node.context.get_domain_id())


def on_this_machine(domain_id: int) -> int:
    """Return the number of participants of a domain in this network namespace."""
    of_discovery = ports_of(domain_id)[::2]
    return sum(1 for port in set(_bound_udp_ports()) if port in of_discovery)


def ports_of(domain_id: int) -> range:
    """Return the ports of the participants of a domain: even ports for discovery, odd ports for data."""
    first = FIRST_PORT + PORTS_PER_DOMAIN * domain_id
    return range(first + FIRST_UNICAST, first + PORTS_PER_DOMAIN)


def discovered(node: Node) -> int:
    """Return the number of participants with ROS nodes that a node knows, including its own."""
    infos = node.get_publishers_info_by_topic(DISCOVERY_TOPIC, no_mangle=True)
    return len({of(info) for info in infos})


def of(info: TopicEndpointInfo) -> bytes:
    """Return the GUID prefix of an endpoint's participant."""
    return gid(info)[:GUID_PREFIX_BYTES]


def is_bridge(info: TopicEndpointInfo) -> bool:
    """Return whether an endpoint belongs to a bridge, of this or another server."""
    return info.node_name.startswith(BRIDGE_NODE)


def is_stopper(node_name: str) -> bool:
    """Return whether a node is a stopper, of this or another server: it is no part of the robot."""
    return node_name.startswith(STOPPER_NODE)


def gid(info: TopicEndpointInfo) -> bytes:
    """Return the global identifier (GID) of an endpoint; its first 12 bytes identify the participant."""
    return bytes(cast("list[int]", info.endpoint_gid))  # pyright: ignore[reportUnknownMemberType]


def _bound_udp_ports() -> Iterator[int]:
    for table in (Path("/proc/net/udp"), Path("/proc/net/udp6")):
        if table.exists():
            for line in table.read_text().splitlines()[1:]:
                yield int(line.split()[1].rpartition(":")[2], 16)
