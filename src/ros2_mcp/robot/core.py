"""The parts of one robot that every command needs: graph, values, types, fail-safes, stops and jobs."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from ros2_mcp.model.commands import LOCAL, Principal
from ros2_mcp.model.qos import QoS
from ros2_mcp.robot.failsafes import Failsafes
from ros2_mcp.robot.graph import Graph
from ros2_mcp.robot.jobs import Jobs
from ros2_mcp.robot.resolution import Types
from ros2_mcp.robot.session import Session
from ros2_mcp.robot.stops import Accepted, Stops
from ros2_mcp.robot.values import Values

if TYPE_CHECKING:
    from ros2_mcp.link.client import Bridge, Reply, Subscription


class Core:
    """One robot without the execution of commands. A recording that stands for a robot passes its own `graph` and
    `values`.

    A class of its own, so that the modules that carry out commands need not import `Robot`, which imports them.
    """

    def __init__(self, bridge: Bridge, graph: Graph | None = None, values: Values | None = None) -> None:
        self._bridge = bridge
        self.graph = graph or Graph(bridge)
        self.values = values or Values(self.graph)
        self.types = Types(self.graph)
        self.failsafes = Failsafes(self.graph, self.values)
        self.jobs = Jobs()
        self.stops = Stops(bridge)

    def now_ns(self) -> int:
        """Return the present time of the robot's clock, in ns of Unix time. Outgoing messages are stamped with it."""
        return self._bridge.clock.now_ns()

    async def subscribe(
        self, topic: str, type_name: str, qos: QoS, *, max_samples: int, max_bytes: int
    ) -> Subscription:
        """Subscribe to all samples of a topic whose QoS is known. Raises as `Bridge.subscribe`."""
        request = qos.request()
        return await self._bridge.subscribe(
            topic, type_name, request, keep="all", max_samples=max_samples, max_bytes=max_bytes
        )

    def session(self, principal: Principal = LOCAL, accepted: Accepted | None = None) -> Session:
        """Return a session for this principal. `accepted` is when its call was accepted (default: now): a stop after
        that time ends the session.
        """
        return Session(principal=principal, accepted=accepted or self.stops.now())

    def check_stop(self, session: Session) -> None:
        """Check, after every await and before anything is sent, that no stop has ended the session.

        Raises:
            Stopped: if a stop came after the session was accepted.
        """
        self.stops.check(session.principal, session.accepted)

    async def act(self, session: Session, op: str, body: bytes = b"", *, timeout_s: float, **arguments: Any) -> Reply:
        """Send a request that acts to the bridge, and return the reply. It is cancelled if its client disconnects.

        Raises:
            Stopped: if a stop came after the session was accepted; nothing was sent.
            RobotError: as `Graph.ask`.
        """
        self.check_stop(session)
        with self.stops.leaving(session.principal):
            return await self.graph.ask(op, body, timeout_s=timeout_s, epoch=session.accepted.epoch, **arguments)
