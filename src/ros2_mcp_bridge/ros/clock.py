"""What the robot takes for *now*: simulated time where those who listen use it, else the wall clock of this machine."""

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
# As rclcpp and rclpy subscribe to it: only the newest counts.
CLOCK_QOS = {"reliability": "best_effort", "durability": "volatile", "history": "keep_last", "depth": 1}
# Who listens to a topic is looked up anew after this time, and at once when their number changes. Chosen: two lists of
# endpoints cost 0.2 ms, which is much for each message of a repeat of 1 kHz.
LOOKED_UP_S = 0.1
# For the first message on a clock that was just subscribed to. Chosen: even at 0.1 x a simulation publishes 1 to 100 a
# second, and after this a clock that is silent stands still.
FIRST_S = 1.0
NS_PER_S = 1_000_000_000


class RobotClock:
    """The time for the stamps of commands. The thread that makes it is the only one that reads ROS for it.

    Any other (fail-safes are carried out on another one if the ROS thread hangs) is told the last time that was heard.
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
        """Whether simulated time has been heard."""
        self._listen()
        return self._heard_ns is not None

    def follow(self) -> None:
        """Subscribe to the simulated time, if that was not done before; a while before the first stamp is needed."""
        if self._raw is None:
            self._interface = interfaces.load(CLOCK_TYPE)
            self._raw = rcl.subscription(self._node, self._interface, CLOCK, qos.profile(CLOCK_QOS))

    def now_ns(self, topic: str, matched: Callable[[], int]) -> int:
        """*Now* for the subscribers of a topic, in nanoseconds; `matched` tells their number.

        Simulated time if the node of one of them subscribes to `/clock`, which is what `use_sim_time` makes it do; 0 if
        none was heard yet, as such a node's own clock says.
        """
        if not self.is_simulated(topic, matched):
            return time.time_ns()
        self._listen()
        return self._heard_ns or 0

    def is_awaited(self, topic: str, matched: Callable[[], int]) -> bool:
        """Whether simulated time is needed, is published, and has not been heard yet."""
        return self.is_simulated(topic, matched) and not self.is_heard and bool(self._graph.publishers(CLOCK))

    def is_simulated(self, topic: str, matched: Callable[[], int]) -> bool:
        """Whether a subscriber's node of that topic uses simulated time."""
        looked_up_at, before, is_simulated = self._simulated.get(topic, (0.0, -1, False))
        if threading.get_ident() != self._thread:
            return is_simulated
        count = matched()
        if before != count or time.monotonic() - looked_up_at > LOOKED_UP_S:
            is_simulated = self._has_simulated(topic)
            self._simulated[topic] = time.monotonic(), count, is_simulated
        return is_simulated

    def forget(self, topic: str) -> None:
        """Nobody commands this topic any more."""
        self._simulated.pop(topic, None)

    def clear(self) -> None:
        """End receiving."""
        if self._raw is not None:
            self._raw.destroy_when_not_in_use()
            self._raw = None

    def _listen(self) -> None:
        if self._raw is None or threading.get_ident() != self._thread:
            return
        while taken := self._raw.take_message(self._interface, True):
            try:
                stamp = rcl.deserialize(taken[0], self._interface).clock
            except Exception:  # noqa: BLE001 - anybody can publish a broken one: it must not keep a robot from a stop
                continue
            if stamp.nanosec < NS_PER_S:  # more is no time, and added to a large `sec` it fits into no stamp
                self._heard_ns = stamp.sec * NS_PER_S + stamp.nanosec

    def _has_simulated(self, topic: str) -> bool:
        """By the nodes' names; by their participants while discovery has not told a name yet.

        Bridges are left out, ours and others: they subscribe to whatever an agent wants to see.
        """
        listening = [info for info in self._graph.subscribers(topic) if not participants.is_bridge(info)]
        clocked = [info for info in self._graph.subscribers(CLOCK) if not participants.is_bridge(info)]
        return any(_is_same_node(one, other) for one in listening for other in clocked)


def _is_same_node(one: Any, other: Any) -> bool:
    if UNKNOWN_NODE in (one.node_name, other.node_name):
        return participants.of(one) == participants.of(other)
    return (one.node_name, one.node_namespace) == (other.node_name, other.node_namespace)
