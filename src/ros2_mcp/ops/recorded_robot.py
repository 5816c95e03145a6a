"""A recording in the place of the robot: its topics as a graph, and no ROS anywhere."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from ros2_mcp.guard.policy import Policy
from ros2_mcp.link.client import Bridge
from ros2_mcp.model.errors import RosNotFound
from ros2_mcp.ops.memory import Memory
from ros2_mcp.ops.recorded import open_source
from ros2_mcp.robot import Robot, TopicEndpoints
from ros2_mcp.robot.graph import Graph

if TYPE_CHECKING:
    from ros2_mcp.link.installation import RosInstallation


def recorded_robot(memory: Memory, result_bytes: int) -> Robot:
    """The recording that is the memory's subject, as far as it can be a robot: it has topics, and does nothing."""
    bridge = Bridge(_no_ros)
    robot = Robot(bridge, Policy(read_only=True, recorded=True), result_bytes)
    robot.graph = RecordedGraph(bridge, memory)
    return robot


def _no_ros() -> RosInstallation:
    raise RosNotFound("This server was started with --bag: its robot is a recording.", "Start it without, for a robot.")


class RecordedGraph(Graph):
    """The graph as far as a recording tells it: topics and what their publishers offered."""

    def __init__(self, bridge: Bridge, memory: Memory) -> None:
        super().__init__(bridge)
        self._memory = memory

    async def query(self, op: str, **arguments: Any) -> Mapping[str, Any]:
        """Answers `topics`; for anything else there is no robot."""
        if op != "topics":
            return await super().query(op, **arguments)
        topics = await self._topics()
        return {
            "topics": [[each.topic, each.types, len(each.publishers), 0] for each in topics.values()],
            "settled": True,
        }

    async def endpoints(self, topic: str) -> TopicEndpoints:
        """The publishers of a topic, without names; empty where the recording does not have it."""
        return (await self._topics()).get(topic, TopicEndpoints(topic, (), ()))

    async def _topics(self) -> Mapping[str, TopicEndpoints]:
        return (await (await open_source(self._memory, self._memory.subject_name)).scene()).topics
