"""How often a read waits for the bridge: what does not depend on each other is asked at the same time."""

from __future__ import annotations

import asyncio
import math
from collections.abc import AsyncGenerator
from contextlib import asynccontextmanager
from typing import Any, cast

import pytest

from ros2_mcp.link.client import Bridge, Reply, Subscription
from ros2_mcp.link.clock import RobotClock
from ros2_mcp.model.errors import BridgeRefused, NotFound
from ros2_mcp.ops.topics.list import list_topics
from ros2_mcp.robot import Robot
from ros2_mcp_common.wire.protocol import NOT_COUNTED
from support.made_bridge import NUMBER

QOS = {
    "reliability": "reliable",
    "durability": "volatile",
    "history": "keep_last",
    "depth": 10,
    "deadline_ns": None,
    "lifespan_ns": None,
    "liveliness": "automatic",
    "liveliness_lease_ns": None,
}


class SlowBridge:
    """A bridge that is far away: answers to all that was asked meanwhile come together, once in a round."""

    hello = None
    nodes = frozenset[str]()
    is_closed = False
    is_remote = True
    clock = RobotClock()

    def __init__(self) -> None:
        self.rounds = 0
        self.asked: list[str] = []
        self.open_subscriptions = 0
        self.durability = "volatile"
        self.is_published = True
        self.present: dict[str, tuple[int, int]] = {}
        self._waiting: list[asyncio.Event] = []

    async def request(self, op: str, *_: bytes, **arguments: Any) -> Reply:
        await self._round(op)
        return Reply(getattr(self, f"_{op}")(**arguments), b"")

    async def subscribe(self, topic: str, type_name: str, qos: dict[str, Any], **_: Any) -> Subscription:  # noqa: ARG002
        await self._round(f"subscribe {qos['durability']}")
        self.open_subscriptions += 1

        async def unsubscribe(_: Subscription) -> None:
            self.open_subscriptions -= 1

        return Subscription("all", 10, 1000, unsubscribe)

    @asynccontextmanager
    async def answering(self) -> AsyncGenerator[None, None]:
        async def rounds() -> None:
            while True:
                await asyncio.sleep(0.005)  # until everybody has asked what he can
                if self._waiting:
                    self.rounds += 1
                answered, self._waiting = self._waiting, []
                for each in answered:
                    each.set()

        work = asyncio.create_task(rounds())
        try:
            yield
        finally:
            work.cancel()
            await asyncio.wait({work})

    async def _round(self, op: str) -> None:
        self.asked.append(op)
        answered = asyncio.Event()
        self._waiting.append(answered)
        await answered.wait()

    def _endpoints(self, **_: Any) -> Any:
        if not self.is_published:
            return {"publishers": [], "subscribers": [], "settled": True}
        qos = {**QOS, "durability": self.durability}
        publisher = {"node": "n", "namespace": "/", "type": NUMBER, "hash": "", "gid": "1", "qos": qos}
        return {"publishers": [publisher], "subscribers": [], "settled": True}

    def _wait_endpoints(self, **_: Any) -> Any:
        raise BridgeRefused("timeout", "It did not come.")

    def _topics(self, count_most: float = math.inf, **_: Any) -> Any:
        counts = self.present if len(self.present) <= count_most else dict.fromkeys(self.present, (NOT_COUNTED,) * 2)
        topics = [(name, [NUMBER], *counts[name]) for name in self.present]
        return {"settled": True, "topics": topics, "nodes": [("arm", "/"), ("launch_ros_4711", "/")]}

    def _counted(self, topics: list[str], **_: Any) -> Any:
        return {"counted": [self.present[name] for name in topics]}

    def _node(self, **_: Any) -> Any:
        return {"publishers": [], "subscribers": [], "servers": [], "clients": []}

    def _nodes(self, **_: Any) -> Any:
        return {"settled": True, "nodes": []}

    def _definitions(self, types: list[str], **_: Any) -> Any:
        missing = [each for each in types if each != NUMBER]
        return {"missing": missing, "definitions": {NUMBER: {"format": "msg", "text": "int32 data\n"}}}


@pytest.fixture
def bridge() -> SlowBridge:
    return SlowBridge()


async def rounds_of_a_read(bridge: SlowBridge, robot: Robot) -> int:
    before = bridge.rounds
    async with robot.listen("/count") as listening:
        assert listening.type == NUMBER and bridge.open_subscriptions == 1
        return bridge.rounds - before


async def test_the_first_read_of_a_topic_takes_two_round_trips_and_every_other_one(bridge: SlowBridge) -> None:
    robot = Robot(cast(Bridge, bridge))
    await robot.values.learn()  # what is imported for the first one is no round trip
    async with bridge.answering():
        assert [await rounds_of_a_read(bridge, robot) for _ in range(3)] == [2, 1, 1]
    assert bridge.open_subscriptions == 0


async def test_publishers_that_offer_another_qos_meanwhile_are_subscribed_to_anew(bridge: SlowBridge) -> None:
    robot = Robot(cast(Bridge, bridge))
    async with bridge.answering():
        await rounds_of_a_read(bridge, robot)
        bridge.durability = "transient_local"
        assert await rounds_of_a_read(bridge, robot) == 2
        assert await rounds_of_a_read(bridge, robot) == 1
    assert bridge.open_subscriptions == 0
    subscribed = [each for each in bridge.asked if each.startswith("subscribe")]
    assert subscribed == ["subscribe volatile"] * 2 + ["subscribe transient_local"] * 2


async def test_no_subscription_is_left_of_a_topic_that_has_gone(bridge: SlowBridge) -> None:
    robot = Robot(cast(Bridge, bridge))
    async with bridge.answering():
        await rounds_of_a_read(bridge, robot)
        bridge.is_published = False
        with pytest.raises(NotFound):
            await rounds_of_a_read(bridge, robot)
    assert bridge.open_subscriptions == 0


@pytest.mark.parametrize(("limit", "asked"), [(3, ["topics"]), (2, ["topics", "counted"])])
async def test_a_listing_is_one_request_and_of_a_large_graph_only_what_is_shown_is_counted(
    bridge: SlowBridge, limit: int, asked: list[str]
) -> None:
    bridge.present = {"/c": (1, 2), "/a": (3, 0), "/b": (0, 4)}
    robot = Robot(cast("Bridge", bridge))
    async with bridge.answering():
        await list_topics(robot, limit=limit)  # who sees the node for the first time asks what it publishes
        bridge.asked.clear()
        found = await list_topics(robot, limit=limit)
    assert bridge.asked == asked
    assert [(row.topic_name, row.publishers, row.subscribers) for row in found.topics] == [
        ("/a", 3, 0),
        ("/b", 0, 4),
        ("/c", 1, 2),
    ][:limit]
    assert found.total == 3


def test_who_publishes_again_and_again_asks_for_the_endpoints_only_when_one_has_come_or_gone() -> None:
    async def times_asked(*endpoints: tuple[int, int] | None) -> int:
        bridge = SlowBridge()
        robot = Robot(cast("Bridge", bridge))
        async with bridge.answering():
            for counted in endpoints:
                to = await robot.types.destination("/cmd", NUMBER)
                robot.types.note_sent(to, NUMBER, counted)
        return bridge.asked.count("endpoints")

    assert asyncio.run(times_asked((1, 1), (1, 1), (1, 1), (1, 1))) == 2
    assert asyncio.run(times_asked((1, 1), (1, 1), (1, 2), (1, 2), (1, 2))) == 3
    assert asyncio.run(times_asked(None, None, None)) == 3
