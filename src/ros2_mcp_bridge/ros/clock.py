"""The current time of the robot: simulated time if the subscribers use it, else the wall clock of this machine."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

from ros2_mcp_bridge.ros import interfaces, participants, qos, rcl
from ros2_mcp_bridge.ros.graph import CLOCK, UNKNOWN_NODE, Graph

if TYPE_CHECKING:
    from rclpy.node import Node

CLOCK_TYPE = "rosgraph_msgs/msg/Clock"
# The QoS with which rclcpp and rclpy subscribe to it: only the newest message counts.
CLOCK_QOS = {"reliability": "best_effort", "durability": "volatile", "history": "keep_last", "depth": 1}
# How long a lookup of a topic's subscribers is valid; it is repeated at once when their number changes. Two lists of
# endpoints cost 0.2 ms, which is much for each message of a repeat of 1 kHz.
LOOKED_UP_S = 0.1
# The longest wait for the first message after subscribing to the clock. Even at 0.1 x, a simulation publishes 1 to 100
# a second; a clock that is silent for longer has stopped.
FIRST_S = 1.0
NS_PER_S = 1_000_000_000


class RobotClock:
    """The time for the stamps of commands. Only the thread that creates it reads ROS for it.

    Any other thread (fail-safes are carried out on another one if the ROS thread hangs) gets the last time received.
    """

    def __init__(self, node: Node, graph: Graph) -> None:
        self._node = node
        self._graph = graph
        self._thread = threading.get_ident()
        self._raw: rcl.RawSubscription | None = None
        self._interface: Any = None
        self._heard_ns: int | None = None
        self._simulated: dict[str, tuple[float, int, bool]] = {}

    @property
    def is_heard(self) -> bool:
        """Whether simulated time has been received."""
        self._listen()
        return self._heard_ns is not None

    def follow(self) -> None:
        """Subscribe to the simulated time, unless that was done before.

        Call it some time before the first stamp is needed.
        """
        if self._raw is None:
            self._interface = interfaces.load(CLOCK_TYPE)
            self._raw = rcl.subscription(self._node, self._interface, CLOCK, qos.profile(CLOCK_QOS))

    def now_ns(self, topic: str, matched: Callable[[], int]) -> int:
        """Return the current time for the subscribers of a topic, in ns; `matched` returns their number.

        It is simulated time if the node of one of them subscribes to `/clock`, as `use_sim_time` makes it do; 0 if none
        was received yet, like the clock of such a node.
        """
        if not self.is_simulated(topic, matched):
            return time.time_ns()
        self._listen()
        return self._heard_ns or 0

    def is_awaited(self, topic: str, matched: Callable[[], int]) -> bool:
        """Return whether simulated time is needed, is published, and has not been received yet."""
        return self.is_simulated(topic, matched) and not self.is_heard and bool(self._graph.publishers(CLOCK))

    def is_simulated(self, topic: str, matched: Callable[[], int]) -> bool:
        """Return whether the node of a subscriber of that topic uses simulated time."""
        looked_up_at, before, is_simulated = self._simulated.get(topic, (0.0, -1, False))
        if threading.get_ident() != self._thread:
            return is_simulated
        count = matched()
        if before != count or time.monotonic() - looked_up_at > LOOKED_UP_S:
            is_simulated = self._has_simulated(topic)
            self._simulated[topic] = time.monotonic(), count, is_simulated
        return is_simulated

    def forget(self, topic: str) -> None:
        """Forget a topic that is not commanded any more."""
        self._simulated.pop(topic, None)

    def clear(self) -> None:
        """Destroy the subscription."""
        if self._raw is not None:
            self._raw.destroy_when_not_in_use()
            self._raw = None

    def _listen(self) -> None:
        if self._raw is None or threading.get_ident() != self._thread:
            return
        while taken := self._raw.take_message(self._interface, True):
            try:
                stamp = rcl.deserialize(taken[0], self._interface).clock
            except Exception:  # noqa: BLE001 - a broken message of any node must not prevent a stop
                continue
            if stamp.nanosec < NS_PER_S:  # more is invalid, and with a large `sec` would not fit into a stamp
                self._heard_ns = stamp.sec * NS_PER_S + stamp.nanosec

    def _has_simulated(self, topic: str) -> bool:
        """Compare by the names of the nodes, or by their participants while discovery has not reported a name yet.

        Bridges are ignored: they subscribe to whatever an agent reads.
        """
        listening = [info for info in self._graph.subscribers(topic) if not participants.is_bridge(info)]
        clocked = [info for info in self._graph.subscribers(CLOCK) if not participants.is_bridge(info)]
        return any(_is_same_node(one, other) for one in listening for other in clocked)


def _is_same_node(one: Any, other: Any) -> bool:
    if UNKNOWN_NODE in (one.node_name, other.node_name):
        return participants.of(one) == participants.of(other)
    return (one.node_name, one.node_namespace) == (other.node_name, other.node_namespace)
