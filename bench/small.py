"""The measurements on a small computer: a quarter of one core for the server with its bridge, and for each floor.

Calls of milliseconds follow each other without a pause, and their mean counts: between two calls a waiting process
would save CPU time that a slow processor does not have. Longer calls are measured as on the whole machine.
"""

from __future__ import annotations

import asyncio
import sys
import time
from collections.abc import Awaitable, Callable, Sequence
from typing import Any

from . import bags, graphs, measure, sights
from .measure import FRAMES, SET, TOPICS, complete_listing, start_to_tools_list, transforms_peer
from .processes import Peer, ours, trivial
from .report import Row
from .slowed import slowed
from .stdio import StdioClient

SHARE = 0.25
_SECONDS = 3.0
_CALLS_OF_BARE = 200


async def rows(full: bool) -> list[Row]:
    """Measure each row slowed down, the longer ones only with `full`; the note has the value with the whole machine."""
    found: list[Row] = []
    for measured in (_start, _list, _service, _publish, _look_up, *(_LONGER if full else ())):
        all_fast = await measured(full)
        with slowed(SHARE):
            all_slow = await measured(full)
        for fast, slow in zip(all_fast, all_slow, strict=True):
            whole = f"{fast.value:.4g} {fast.unit}" if fast.ratio is None else f"{fast.ratio:.2f} ×"
            note = f"with the whole machine {whole}; {slow.note}".rstrip("; ")
            found.append(Row(f"{slow.what}, {SHARE:g} of a core", slow.value, slow.unit, slow.target, slow.floor, note))
            print(*found[-1].cells(), sep="  ", file=sys.stderr, flush=True)
    return found


_LONGER: Sequence[Callable[[bool], Awaitable[list[Row]]]] = (
    lambda _: graphs.large(50),
    lambda _: measure.first_listing(3),
    lambda _: measure.read_one(50),
    lambda _: measure.flooded(10_000, 10),
    lambda _: measure.idle(20),
    lambda _: sights.recording(10, 1),
    lambda _: sights.picture_read(20),
    lambda _: bags.large(full=False),
)


async def _start(full: bool) -> list[Row]:
    return await start_to_tools_list(8 if full else 3)


async def _list(full: bool) -> list[Row]:
    with Peer("topics", TOPICS):
        async with ours() as us, trivial() as them:
            await asyncio.gather(us.greet(), them.greet())
            await complete_listing(us)
            mine, floor = await _mean(lambda: us.call("ros2_topic_list"), full), await _ping(them, full)
    return [Row(f"ros2_topic_list, {TOPICS} topics, mean", mine, "ms", 2, floor)]


async def _service(full: bool) -> list[Row]:
    with Peer("service"), Peer("floor") as bare:
        async with ours() as us, trivial() as them:
            await asyncio.gather(us.greet(), them.greet())
            mine = await _mean(lambda: us.call("ros2_service_call", **SET), full)
            floor = await _ping(them, full) + _mean_of_bare(bare, "call")
    return [Row("ros2_service_call, mean", mine, "ms", 1.3, floor)]


async def _publish(full: bool) -> list[Row]:
    message = {"topic_name": "/bench/heard", "message_type": "std_msgs/msg/UInt64", "data": {"data": 1}}
    with Peer("heard"), Peer("floor") as bare:
        async with ours() as us:
            await us.greet()
            mine = await _mean(lambda: us.call("ros2_topic_publish", **message), full)
            floor = _mean_of_bare(bare, "publish")
    return [Row("acknowledged publish, mean", mine, "ms", floor=floor)]


async def _look_up(full: bool) -> list[Row]:
    asked = {"target": "map", "source": f"on_moving_{FRAMES - 1}"}
    with transforms_peer():
        async with ours() as us, trivial() as them:
            await asyncio.gather(us.greet(), them.greet())
            mine, floor = await _mean(lambda: us.call("ros2_tf_lookup", **asked), full), await _ping(them, full)
    return [Row("ros2_tf_lookup, mean", mine, "ms", 3, floor)]


async def _ping(client: StdioClient, full: bool) -> float:
    return await _mean(lambda: client.call("ping"), full)


async def _mean(call: Callable[[], Awaitable[Any]], full: bool) -> float:
    """Return the mean time of calls without a pause, in ms; the first ones, which import and match, do not count."""
    for _ in range(20):
        await call()
    count, started = 0, time.perf_counter()
    while (elapsed := time.perf_counter() - started) < _SECONDS * (3 if full else 1):
        await call()
        count += 1
    return elapsed / count * 1000


def _mean_of_bare(bare: Peer, what: str) -> float:
    bare.seconds(what, 20)
    seconds = bare.seconds(what, _CALLS_OF_BARE)
    return sum(seconds) / len(seconds) * 1000
