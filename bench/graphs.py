"""Listings of a large graph, compared with the trivial tool."""

from __future__ import annotations

import asyncio
import json

from .measure import timed
from .processes import Peer, ours, trivial
from .report import Row, p50, p99

NODES, TOPICS_EACH = 200, 5
TOPICS = NODES * TOPICS_EACH


async def large(rounds: int) -> list[Row]:
    """Measure `ros2_topic_list` without arguments, with 1,000 topics on 200 nodes."""
    mine, floor = [], []
    with Peer("many", NODES, TOPICS_EACH):
        async with ours() as us, trivial() as them:
            await us.greet()
            await them.greet()
            while (await us.call("ros2_topic_list"))["total"] < TOPICS:
                await asyncio.sleep(0.1)
            for _ in range(rounds):
                mine.append(await timed(us.call("ros2_topic_list")))
                floor.append(await timed(them.call("ping")))
            size = len(json.dumps(await us.request("tools/call", name="ros2_topic_list", arguments={})))
    note = f"p99 {p99(mine):.1f} ms, {size / 1000:.0f} kB; trivial tool {p50(floor):.2f} ms"
    return [Row(f"ros2_topic_list, {TOPICS} topics on {NODES} nodes, p50", p50(mine), "ms", 10, note=note)]
