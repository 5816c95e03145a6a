"""What every command is carried out with: the graph, values, types, fail-safes and jobs of one robot."""

from __future__ import annotations

from typing import TYPE_CHECKING

from ros2_mcp.robot.failsafes import Failsafes
from ros2_mcp.robot.graph import Graph
from ros2_mcp.robot.jobs import Jobs
from ros2_mcp.robot.resolution import Types
from ros2_mcp.robot.values import Values

if TYPE_CHECKING:
    from ros2_mcp.link.client import Bridge


class Core:
    """One robot without the ways to act on it. A recording in the place of a robot has its own `graph` and `values`.

    A class of its own, so that the modules that carry commands out do not import `Robot`, which imports them.
    """

    def __init__(self, bridge: Bridge, graph: Graph | None = None, values: Values | None = None) -> None:
        self.bridge = bridge
        self.graph = graph or Graph(bridge)
        self.values = values or Values(self.graph)
        self.types = Types(self.graph)
        self.failsafes = Failsafes(self.graph, self.values)
        self.jobs = Jobs()
