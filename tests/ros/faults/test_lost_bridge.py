"""The bridge dies or hangs during a read: the call says so, and the next one works."""

from __future__ import annotations

import asyncio
import os
import signal
import time

import pytest

from support.agent import Refusal
from support.async_agent import AsyncAgent
from support.standstill import undisturbed_async

LOST = pytest.mark.parametrize(
    ("number", "words"), [(signal.SIGKILL, "died with signal SIGKILL"), (signal.SIGSTOP, "was stopped")]
)


@LOST
async def test_a_bridge_lost_during_a_read_is_told_and_the_next_read_works(
    agent: AsyncAgent, peer, number: signal.Signals, words: str
) -> None:
    topic = f"/steady_{number:d}"
    peer("repeat", topic, "std_msgs/msg/String", 100)
    await agent.knows(topic)
    await told_after_s(agent, topic, number, words)


@pytest.mark.full
@LOST
async def test_a_lost_bridge_is_told_within_a_second(
    agent: AsyncAgent, peer, number: signal.Signals, words: str
) -> None:
    topic = f"/measured_{number:d}"
    peer("repeat", topic, "std_msgs/msg/String", 100)
    await agent.knows(topic)
    assert await undisturbed_async(lambda: told_after_s(agent, topic, number, words)) < 1.0


async def told_after_s(agent: AsyncAgent, topic: str, number: signal.Signals, words: str) -> float:
    """How long after the loss a read is answered that would last for 20 s more; the next one works."""
    before = await agent.call("ros2_status")
    bridge = before["bridge_pid"]
    reading = asyncio.ensure_future(agent.call("ros2_topic_subscribe", topic_name=topic, duration=20))
    while (await agent.call("ros2_status"))["subscriptions"] == before["subscriptions"]:
        await asyncio.sleep(0.02)
    os.kill(bridge, number)
    lost_at = time.monotonic()
    with pytest.raises(Refusal, match=rf"BridgeLost: The bridge \(pid {bridge}\) {words}.*started again"):
        await reading
    told_after = time.monotonic() - lost_at
    again = await agent.call("ros2_topic_subscribe", topic_name=topic, duration=40, message_limit=1)  # a bridge begins
    assert again["count"] == 1
    status = await agent.call("ros2_status")
    assert status["bridge_starts"] == before["bridge_starts"] + 1
    assert words in status["bridge_restarts"][-1]
    return told_after


async def test_all_calls_under_way_hear_of_a_lost_bridge_and_none_hangs(agent: AsyncAgent, peer) -> None:
    peer("repeat", "/busy", "std_msgs/msg/String", 100)

    await agent.knows("/busy")
    calls = [
        agent.call("ros2_topic_echo_wait", topic_name="/never", message_type="std_msgs/msg/String", timeout=50),
        agent.call("ros2_topic_stats", topic_names=["/busy"], duration_s=50),
        agent.call("ros2_topic_subscribe", topic_name="/busy", duration=50),
    ]
    before = await agent.call("ros2_status")
    waiting = asyncio.gather(*calls, return_exceptions=True)
    await all_subscribed(agent, before["subscriptions"])
    os.kill((await agent.call("ros2_status"))["bridge_pid"], signal.SIGKILL)
    failed, measured, read = await asyncio.wait_for(waiting, 30)
    assert "died with signal SIGKILL" in str(failed)
    assert "died with signal SIGKILL" in str(measured)
    assert "died with signal SIGKILL" in str(read)


async def all_subscribed(agent: AsyncAgent, before: int) -> None:
    """Waits until there are more subscriptions than before, and none has been added for half a second: which of the
    calls share one is not known here, and one that begins after the loss would not hear of it.
    """
    loop = asyncio.get_running_loop()
    seen, since = before, loop.time()
    while seen == before or loop.time() - since < 0.5:
        await asyncio.sleep(0.02)
        now = (await agent.call("ros2_status"))["subscriptions"]
        if now != seen:
            seen, since = now, loop.time()
