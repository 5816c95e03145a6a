"""Nav2's own speed limit: the controller is told how fast the policy lets goals drive, before a goal is sent.

It only makes the robot slower, so the policy need not allow it. Whether the robot obeys is judged by what it measures
(`goals` in a policy's `feedback`).
"""

from __future__ import annotations

import sys
import time
from typing import TYPE_CHECKING, Any

from rclpy.qos import QoSProfile

from ros2_mcp_bridge.exit.limiter import Limiter
from ros2_mcp_bridge.request import OperationError, Request, Steps
from ros2_mcp_bridge.ros import interfaces, rcl
from ros2_mcp_bridge.ros.graph import Graph
from ros2_mcp_common.policy.keep_out import STANDING_GOALS
from ros2_mcp_common.policy.velocity import SPEED_LIMIT
from ros2_mcp_common.policy.verbs import matches, meaning

if TYPE_CHECKING:
    from rclpy.node import Node

# The longest wait for the controller to match a new publisher, and to acknowledge: both take milliseconds on one
# machine. A goal is not held up longer, since its speed is measured in any case.
MATCHED_S, ACKNOWLEDGED_S = 0.5, 0.2
POLL_S = 0.005


class SpeedLimits:
    """The publishers of speed limits by topic, a publisher for each namespace with a controller."""

    def __init__(self, node: Node, graph: Graph, limiter: Limiter) -> None:
        self._node = node
        self._graph = graph
        self._limiter = limiter
        self._publishers: dict[str, Any] = {}

    def tell(self, request: Request) -> Steps[None]:
        """Steps that tell the controller beside an action of Nav2 the policy's speed for goals, if both are there."""
        meant = meaning(request.text("service"), request.text("type"))
        most = self._limiter.speed_of_goals
        if not most or meant.verb != "goal" or not meant.type.startswith("nav2_msgs/"):
            return
        topic = f"{meant.name.rpartition('/')[0]}/speed_limit"
        is_heard = any(info.topic_type == SPEED_LIMIT for info in self._graph.subscribers(topic))
        if not is_heard or matches(STANDING_GOALS, meant.type):
            return
        try:
            interface = interfaces.load(SPEED_LIMIT)
            if topic not in self._publishers:
                self._publishers[topic] = rcl.publisher(self._node, interface, topic, QoSProfile(depth=1))
        except (OperationError, rcl.RCLError) as error:
            sys.stderr.write(f"{topic} could not be told: {error}\n")
            return
        publisher, deadline = self._publishers[topic], time.monotonic() + MATCHED_S
        while not publisher.get_subscription_count() and time.monotonic() < deadline:
            yield POLL_S
        publisher.publish_raw(rcl.serialize(interface(percentage=False, speed_limit=most)))
        deadline = time.monotonic() + ACKNOWLEDGED_S
        while not rcl.is_acknowledged(publisher) and time.monotonic() < deadline:
            yield POLL_S

    def clear(self) -> None:
        """Destroy the publishers."""
        for publisher in self._publishers.values():
            publisher.destroy_when_not_in_use()
        self._publishers.clear()
