"""A recording that stands for the robot: its topics as a graph, without ROS."""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import Iterable, Mapping
from typing import TYPE_CHECKING, NoReturn

from ros2_mcp.guard.guard import Guard
from ros2_mcp.guard.policy import Policy
from ros2_mcp.link.client import Bridge
from ros2_mcp.model.errors import RosNotFound, UnknownInterface
from ros2_mcp.model.graph import NodeRow, Rows, TopicEndpoints, TopicRow
from ros2_mcp.model.names import defining_type, did_you_mean
from ros2_mcp.model.text import named
from ros2_mcp.ops.memory.bag_store import BagStore
from ros2_mcp.ops.sources.bag import definitions_of, open_bag
from ros2_mcp.robot import Robot
from ros2_mcp.robot.graph import REQUEST_S, Graph
from ros2_mcp.robot.kept import Kept
from ros2_mcp.robot.values import Values

if TYPE_CHECKING:
    from ros2_mcp.bags.stored import StoredTopic
    from ros2_mcp.model.interfaces import DefinitionText


def recorded_robot(store: BagStore, keeps: Iterable[Kept] = ()) -> Robot:
    """Return the store's subject as a robot. It has topics and their types, and refuses all commands."""

    def no_ros() -> NoReturn:
        started = "This server was started with --bag: it reads a recording, not a robot."
        raise RosNotFound(started, "Start the server without --bag to use a robot.")

    bridge = Bridge(no_ros)
    graph = RecordedGraph(bridge, store)
    guard = Guard(Policy(read_only=True, recorded=True))
    return Robot(bridge, guard, keeps, graph=graph, values=RecordedValues(graph, store))


class RecordedGraph(Graph):
    """The part of a graph that a recording has: topics, the QoS of their publishers, and their types."""

    def __init__(self, bridge: Bridge, store: BagStore) -> None:
        super().__init__(bridge)
        self._store = store

    async def topics(self, within_s: float | None = None) -> Rows[TopicRow]:  # noqa: ARG002 - nothing has to settle
        """Return the recorded topics."""
        recorded = (await self._recorded_topics()).values()
        return Rows([TopicRow(found.topic, found.types, len(found.publishers), 0) for found in recorded], settled=True)

    async def topics_and_absence(self, count_most: int) -> tuple[Rows[TopicRow], str]:  # noqa: ARG002 - all are known
        """Return the recorded topics, and "" in place of the reason why a robot is absent: a recording never is."""
        return await self.topics(), ""

    async def absence(self, within_s: float | None = None, found: Rows[NodeRow] | None = None) -> str:  # noqa: ARG002
        """Return "": a recording is never absent."""
        return ""

    async def interfaces(self, within_s: float = REQUEST_S) -> list[str]:  # noqa: ARG002 - a file answers at once
        """Return the types of the recorded topics, and the types that these refer to."""
        return sorted(await recorded_definitions(self._store))

    async def name_of(self, topic: str) -> str:
        """Return the name as it is in the recording; an unknown name is returned as given."""
        source = await open_bag(self._store, self._store.subject_name, may_be_empty=True)
        return await source.name_of(topic)

    async def endpoints(self, topic: str, within_s: float | None = None) -> TopicEndpoints:  # noqa: ARG002 - as above
        """Return the publishers of a topic, without names; none if the recording does not have it."""
        return (await self._recorded_topics()).get(topic, TopicEndpoints(topic, (), ()))

    async def _recorded_topics(self) -> Mapping[str, TopicEndpoints]:
        return (await (await open_bag(self._store, self._store.subject_name)).graph()).topics


class RecordedValues(Values):
    """The types of the recorded topics, as the recording itself defines them."""

    def __init__(self, graph: Graph, store: BagStore) -> None:
        super().__init__(graph)
        self._store = store

    async def learn(self, *types: str) -> None:
        """Read the definitions from the recording. Raises `UnknownInterface` for a type that is not in it."""
        if all(self.definitions.knows(defining_type(name)) for name in types):
            return
        recorded = await recorded_definitions(self._store)
        self.definitions.add(recorded)
        for name in types:
            if not self.definitions.knows(defining_type(name)):
                hint = did_you_mean(name, list(recorded), f"It has {', '.join(map(named, sorted(recorded)[:20]))}.")
                raise UnknownInterface(f"The recording has no definition of {name}.", hint)


async def recorded_definitions(store: BagStore) -> dict[str, DefinitionText]:
    """Return every known definition of the types of the recorded topics and of the types that these refer to."""

    def read() -> list[StoredTopic]:
        with store.reading(store.subject_name) as bag:
            return list({topic.type: topic for topic in bag.topics.values()}.values())

    found: dict[str, DefinitionText] = {}
    for topic in await asyncio.to_thread(read):
        if topic.form != "ros2":
            continue
        with contextlib.suppress(UnknownInterface):
            found |= await definitions_of(topic, None)
    return found
