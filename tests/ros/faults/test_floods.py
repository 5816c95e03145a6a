"""Many messages and many reads: every message is accounted for, and nothing is left behind."""

from __future__ import annotations

import base64
from typing import Any

import pytest

from support.agent import FULL
from support.async_agent import AsyncAgent
from support.faulty_peer import count_threads_and_files, parent_of


@pytest.mark.promise("README", "every answer is measured, bounded and checked")
@pytest.mark.parametrize(
    ("rate_hz", "seconds", "size"),
    [pytest.param(5000, 10 if FULL else 1, 40, id="small and fast"), pytest.param(300, 1.2, 256_000, id="large")],
)
async def test_every_message_of_a_flood_is_received_or_counted(
    agent: AsyncAgent, peer, rate_hz: int, seconds: float, size: int
) -> None:
    count = int(rate_hz * seconds)

    topic, spare_s = f"/flood_{size}", 12  # a machine that is held up sends and takes it at a fraction of the rate
    flood = peer("flood", topic, rate_hz, count, size)

    await agent.knows(topic)
    duration = seconds + spare_s
    bounds = {"duration": duration, "message_limit": count}
    result = await agent.call("ros2_topic_subscribe", topic_name=topic, fields=["data[0:4]"], **bounds)
    assert int(flood.line()) == count
    numbers = [_number(message) for message in result["messages"]]
    assert result["received"] + result["lost"] == count
    assert numbers == sorted(set(numbers))
    assert numbers[-1] == count - 1
    if not result["dropped"] and not result["lost"]:
        assert numbers[0] == 0
    if size > 100_000:
        assert result["dropped"] > 0, "64 MB are kept at most"
        assert numbers[0] >= result["dropped"]


def _number(message: dict[str, Any]) -> int:
    """The four bytes with which the peer numbers its messages."""
    data = message["data[0:4]"] if "data[0:4]" in message else message["data"]
    return int.from_bytes(base64.b64decode(data) if isinstance(data, str) else bytes(data), "big")


@pytest.mark.full
@pytest.mark.timeout(1800 if FULL else 60)
async def test_reading_again_and_again_leaves_no_entities_threads_or_files(start_agent, peer) -> None:
    peer("repeat", "/steady", "std_msgs/msg/String", 500)

    async with start_agent() as agent:
        await agent.knows("/steady")
        await read(agent, 20)
        before = await everything_open(agent)
        await read(agent, 10_000 if FULL else 300)
        assert await everything_open(agent) == before


async def read(agent: AsyncAgent, times: int) -> None:
    for _ in range(times):
        assert (await agent.call("ros2_topic_subscribe", topic_name="/steady"))["count"] == 1


async def everything_open(agent: AsyncAgent) -> dict[str, Any]:
    status = await agent.call("ros2_status")
    bridge = int(status["bridge_pid"])
    entities = {name: status[name] for name in ("subscriptions", "publishers", "service_clients")}
    both = {"bridge": count_threads_and_files(bridge), "server": count_threads_and_files(parent_of(bridge))}
    return {**entities, **both}
