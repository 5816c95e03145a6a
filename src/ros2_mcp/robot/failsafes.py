"""Fail-safes: what the bridge does for us when this process dies, however it dies.

A fail-safe is a request that stays open. The bridge carries it out when the stream ends; withdrawing it cancels the
request. Here too is what we have driven, so that it can be stopped.
"""

from __future__ import annotations

import asyncio
import logging
from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from ros2_mcp.model.errors import BridgeLost, RobotError
from ros2_mcp.model.goals import CANCEL_TYPE, cancel_request
from ros2_mcp.model.qos import QoS
from ros2_mcp.robot.graph import NO_END_S
from ros2_mcp_bridge.limits import MAX_FAILSAFES
from ros2_mcp_bridge.velocity import VELOCITY_TYPES

if TYPE_CHECKING:
    from ros2_mcp.robot.graph import Graph
    from ros2_mcp.robot.values import Values

_DISCOVERED_S = 10.0
"""A new bridge knows the robot after 4 s at most on a quiet network; on a bad one the zero still has to come."""
_ACKNOWLEDGED_S = 0.5
"""A reliable subscriber acknowledges within milliseconds; longer waiting would not stop the robot sooner."""
_logger = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True)
class Failsafe:
    """A message to publish (`failsafe_publish`), or a request to send (`failsafe_call`), as CDR."""

    op: str
    body: bytes
    arguments: Mapping[str, Any]


class Failsafes:
    """The fail-safes in force, by topic or goal id. Of too many of one kind the oldest is withdrawn: goals that nobody
    followed to their end never displace a zero command.
    """

    def __init__(self, graph: Graph, values: Values) -> None:
        self._graph = graph
        self._values = values
        self._held: dict[str, tuple[str, asyncio.Task[None]]] = {}
        self._being_done: dict[str, asyncio.Task[None]] = {}
        self._zeros: dict[tuple[str, str], bytes] = {}

    @property
    def zeros(self) -> Mapping[tuple[str, str], bytes]:
        """(topic, type) → the bytes of the zero command, of every velocity topic that this server has driven."""
        return dict(self._zeros)

    def leave_zero(self, topic: str, type_name: str, qos: QoS) -> bytes:
        """Before velocity commands are published: leaves the zero that ends them, and notes that we drive the topic.

        Returns:
            The zero (CDR) for a type that keeps a robot moving, which must have been learnt; nothing for others.
        """
        if type_name not in VELOCITY_TYPES:
            return b""
        zero = self._zeros.get((topic, type_name)) or self._values.encode_known(type_name, {})
        self._zeros[topic, type_name] = zero
        destination = {"topic": topic, "type": type_name, "qos": qos.request()}
        self._leave(topic, Failsafe("failsafe_publish", zero, destination))
        return zero

    def leave_cancel(self, goal_id: str, action: str) -> None:
        """Before a goal is sent: leaves the request that cancels it. `CANCEL_TYPE` must have been learnt."""
        body = self._values.encode_known(f"{CANCEL_TYPE}_Request", cancel_request(goal_id))
        service = {"service": f"{action}/_action/cancel_goal", "type": CANCEL_TYPE}
        self._leave(goal_id, Failsafe("failsafe_call", body, service))

    def withdraw(self, key: str) -> None:
        """Takes the fail-safe of a topic or goal back; without effect where there is none."""
        if key in self._held:
            self._held.pop(key)[1].cancel()

    def _leave(self, key: str, failsafe: Failsafe) -> None:
        """Puts it in force, unless one of that key is. The robot is moved again: an old one need not be carried out."""
        if key in self._being_done:
            self._being_done.pop(key).cancel()
        if key in self._held:
            return
        of_this_kind = [other for other, (op, _) in self._held.items() if op == failsafe.op]
        if len(of_this_kind) >= MAX_FAILSAFES:
            self.withdraw(of_this_kind[0])
        self._held[key] = failsafe.op, asyncio.create_task(self._hold(key, failsafe))

    async def _hold(self, key: str, failsafe: Failsafe) -> None:
        """Keeps it in force, in one bridge after the other. What a killed bridge left moving, its successor stops."""
        while True:
            try:
                await self._graph.ask(failsafe.op, failsafe.body, timeout_s=NO_END_S, **failsafe.arguments)
            except BridgeLost:
                if failsafe.op == "failsafe_publish":
                    self._being_done[key] = asyncio.create_task(self._publish(key, failsafe))
            except RobotError as error:
                self._held.pop(key, None)
                if not self._graph.is_closed:
                    _logger.warning("a fail-safe is not in force: %s", error)
                return

    async def _publish(self, key: str, failsafe: Failsafe) -> None:
        """Carries out what a killed bridge could not. The new one has yet to discover the robot: the message waits."""
        patience = {"wait_match_s": _DISCOVERED_S, "wait_ack_s": _ACKNOWLEDGED_S, "timeout_s": 2 * _DISCOVERED_S}
        try:
            await self._graph.ask("publish", failsafe.body, **patience, **failsafe.arguments)
        except RobotError as error:
            if not self._graph.is_closed:
                _logger.warning("%s could not be stopped after the bridge was lost: %s", key, error)
        finally:
            if self._being_done.get(key) is asyncio.current_task():
                del self._being_done[key]
