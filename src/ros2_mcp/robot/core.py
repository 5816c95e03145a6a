"""What every command is carried out with: the graph, values, types, fail-safes, stops and jobs of one robot."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

from ros2_mcp.model.commands import LOCAL
from ros2_mcp.model.times import Outage
from ros2_mcp.robot.failsafes import Failsafes
from ros2_mcp.robot.graph import Graph
from ros2_mcp.robot.jobs import Jobs
from ros2_mcp.robot.no_known_stop import NoKnownStop
from ros2_mcp.robot.reported import Reported
from ros2_mcp.robot.resolution import Types
from ros2_mcp.robot.stops import Accepted, Stops
from ros2_mcp.robot.values import Values

if TYPE_CHECKING:
    from ros2_mcp.link.client import Bridge, Reply


class Core:
    """One robot without the ways to act on it. A recording in the place of a robot has its own `graph` and `values`.

    `principal` is who asks through it, `accepted` when the call was accepted that acts through it, `notes` sentences
    for its result: a view of the robot for one call has these of its own (`Robot.acting_for`), and shares all else.
    With a list `rehearsed` nothing is done through it: what would be is written there, with what the policy says of it.

    A class of its own, so that the modules that carry commands out do not import `Robot`, which imports them.
    """

    def __init__(self, bridge: Bridge, graph: Graph | None = None, values: Values | None = None) -> None:
        self.bridge = bridge
        self.graph = graph or Graph(bridge)
        self.values = values or Values(self.graph)
        self.types = Types(self.graph)
        self.failsafes = Failsafes(self.graph, self.values)
        self.jobs = Jobs()
        self.stops = Stops(bridge)
        self.no_known_stop = NoKnownStop()
        self.reported = Reported()
        self.principal = LOCAL
        self.accepted: Accepted | None = None
        self.notes: list[str] = []
        self.rehearsed: list[str] | None = None

    def now_ns(self) -> int:
        """The time of the robot's clock, by which what it sends is stamped, in ns of Unix time."""
        return self.bridge.clock.now_ns()

    @property
    def is_remote(self) -> bool:
        """Whether a network lies between this server and the robot, so that large messages take their time."""
        return self.bridge.is_remote

    @property
    def outages(self) -> Sequence[Outage]:
        """The times in which a robot elsewhere was out of reach."""
        return self.bridge.outages

    def check_stop(self) -> Accepted:
        """When the call was accepted that acts through this; to be asked after every await and before anything is sent.

        Raises:
            Stopped: if a stop came after that.
        """
        accepted = self.accepted or self.stops.now()
        self.stops.check(self.principal, accepted)
        return accepted

    async def act(self, op: str, body: bytes = b"", *, timeout_s: float, **arguments: Any) -> Reply:
        """One request to the bridge that acts, ended where the client that asks for it goes.

        Raises:
            Stopped: if a stop came after its call was accepted; nothing was sent.
            RobotError: as `Graph.ask`.
        """
        epoch = self.check_stop().epoch
        with self.stops.leaving(self.principal):
            return await self.graph.ask(op, body, timeout_s=timeout_s, epoch=epoch, **arguments)
