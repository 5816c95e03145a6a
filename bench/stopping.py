"""The duration of a stop: from a client's call to the zero at a subscriber in another process."""

from __future__ import annotations

import asyncio
import json
import time
from typing import Any

from .processes import Peer, ours
from .report import Row, p50, p99
from .stdio import CallFailed, StdioClient

TWIST, STRING = "geometry_msgs/msg/Twist", "std_msgs/msg/String"
DRIVEN, OTHERS, SUBSCRIPTIONS = 50, 150, 50
"""Number of repeats on velocity topics (a server drives at most 64), of repeats on other topics, and of subscriptions
meanwhile."""
TICKS, TICKS_HZ = 10, 20
AFTER_S = 1.0
"""Wait once all velocity topics are driven, for the repeats on other topics, which are called later."""
LONG_S = 3600.0


async def round_of(client: StdioClient, peer: Peer, driven: int, others: int = 0) -> float:
    """Return the time in s from the call of a stop until every driven topic has had its first zero."""
    velocities: list[dict[str, Any]] = [
        {"topic_name": f"/bench/vel{number}", "message_type": TWIST, "data": {"linear": {"x": 0.1}}, "frequency": 20}
        for number in range(driven)
    ]
    texts: list[dict[str, Any]] = [
        {"topic_name": f"/bench/text{number}", "message_type": STRING, "data": {"data": "x"}, "frequency": 5}
        for number in range(others)
    ]
    repeats = [
        asyncio.ensure_future(client.call("ros2_topic_publish", **one, duration=LONG_S))
        for one in [*velocities, *texts]
    ]
    await asyncio.to_thread(peer.ask, f"moving {driven}")
    await asyncio.sleep(AFTER_S)
    started = time.monotonic()
    stopping = asyncio.ensure_future(client.call("ros2_stop"))
    zero_at = float(json.loads(await asyncio.to_thread(peer.ask, "zeros")))
    await asyncio.wait({stopping, *repeats})
    return zero_at - started


async def stop_to_zero(full: bool) -> list[Row]:
    """Measure the targets of issue 12: at most 50 ms for 99 of 100 stops, and 200 ms with 200 repeats and 50
    subscriptions."""
    with Peer("driven", DRIVEN) as peer, Peer("ticks", TICKS, TICKS_HZ):
        async with ours() as us:
            await us.greet()
            idle = [await round_of(us, peer, 1) for _ in range(300 if full else 100)]
        async with ours() as us:
            await us.greet()
            reading = [asyncio.ensure_future(_read(us, number)) for number in range(SUBSCRIPTIONS)]
            busy = [await round_of(us, peer, DRIVEN, OTHERS) for _ in range(100 if full else 10)]
            for one in reading:
                one.cancel()
    return [
        Row("ros2_stop → zero at a subscriber, p99", p99(idle), "ms", 50, note=f"p50 {p50(idle):.1f} ms"),
        Row(
            f"the same, {DRIVEN + OTHERS} repeats, {SUBSCRIPTIONS} subscriptions, last of {DRIVEN} topics, p99",
            p99(busy),
            "ms",
            200,
            note=f"p50 {p50(busy):.1f} ms",
        ),
    ]


async def _read(client: StdioClient, number: int) -> None:
    """Read a topic until the call fails or is cancelled."""
    while True:
        try:
            await client.call("ros2_topic_subscribe", topic_name=f"/bench/tick{number % TICKS}", duration=60)
        except CallFailed:
            return
