"""A short form for every change: `python -m bench.short` fails if the ratio of a row to its floor has grown by half.

It compares the CPU time of the server and its bridge with that of the floor: on a busy machine both wait, and waiting
does not count. Longer waiting is found by `python -m bench`, which measures the time until the answer and needs a quiet
machine. `ratios.json` has the ratios for comparison; `--record` rewrites it.

Both sides of a ratio are measured alternately. A ratio that looks grown is measured again, and the best of three
counts: noise only lengthens a time.
"""

from __future__ import annotations

import asyncio
import json
import random
import sys
from collections.abc import Awaitable, Callable, Sequence
from pathlib import Path
from typing import Any

from .measure import SET, TOPICS, complete_listing
from .processes import Peer, cpu_seconds, ours, trivial
from .report import Row, table
from .stdio import StdioClient

GROWN = 1.5
_ATTEMPTS = 3
_TURNS = 10
_RATIOS = Path(__file__).with_name("ratios.json")
_HEARD = {"topic_name": "/bench/heard", "message_type": "std_msgs/msg/UInt64", "data": {"data": 1}}


class Used:
    """The CPU time that some processes use for calls."""

    def __init__(self, *pids: int) -> None:
        self._pids = pids
        self._seconds = 0.0
        self._calls = 0

    async def add(self, count: int, call: Callable[[], Awaitable[Any]]) -> None:
        """Make a call `count` times."""
        before = self._so_far()
        for _ in range(count):
            await call()
        self._seconds += self._so_far() - before
        self._calls += count

    @property
    def each_ms(self) -> float:
        return self._seconds / self._calls * 1000

    def _so_far(self) -> float:
        return sum(cpu_seconds(pid) for pid in self._pids)


async def _used_by(us: StdioClient) -> Used:
    """Return the CPU time of the server and its bridge."""
    return Used(us.pid, (await us.call("ros2_status"))["bridge_pid"])


async def _asked(peer: Peer, what: str) -> None:
    await asyncio.to_thread(peer.seconds, what, 1)


async def _start_to_tools_list() -> Row:
    async def start(make: Callable[[], StdioClient]) -> float:
        async with make() as client:
            await client.greet()
            return cpu_seconds(client.pid) * 1000  # of the server alone: the bridge starts in parallel

    used_ms: dict[Any, list[float]] = {ours: [], trivial: []}
    for make in (ours, trivial):
        await start(make)  # compiles what is not compiled yet
    for _ in range(3):
        for make, found in used_ms.items():
            found.append(await start(make))
    return _row("start → tools/list", min(used_ms[ours]), min(used_ms[trivial]))


async def _topic_list() -> Row:
    with Peer("topics", TOPICS):
        async with ours() as us, trivial() as them:
            await us.greet()
            await them.greet()
            await complete_listing(us)
            mine, floor = await _used_by(us), Used(them.pid)
            for _ in range(_TURNS):
                await mine.add(10, lambda: us.call("ros2_topic_list"))
                await floor.add(10, lambda: them.call("ping"))
    return _row(f"ros2_topic_list, {TOPICS} topics", mine.each_ms, floor.each_ms)


async def _service_call() -> Row:
    with Peer("service"), Peer("floor") as node:
        async with ours() as us, trivial() as them:
            await us.greet()
            await them.greet()
            await us.call("ros2_service_call", **SET)
            await _asked(node, "call")
            mine, floor, bare = await _used_by(us), Used(them.pid), Used(node.pid)
            for _ in range(_TURNS):
                await mine.add(10, lambda: us.call("ros2_service_call", **SET))
                await floor.add(10, lambda: them.call("ping"))
                await bare.add(10, lambda: _asked(node, "call"))
    return _row("ros2_service_call", mine.each_ms, floor.each_ms + bare.each_ms)


async def _read_one() -> Row:
    async def read() -> None:
        await asyncio.sleep(random.uniform(0, 0.01))  # a random time between two messages
        await us.call("ros2_topic_subscribe", topic_name="/bench/tick0")

    async def read_bare() -> None:
        await asyncio.sleep(random.uniform(0, 0.01))
        await _asked(node, "read")

    with Peer("ticks", 1, 100), Peer("floor") as node:
        async with ours() as us:
            await us.greet()
            await read()
            await read_bare()
            mine, bare = await _used_by(us), Used(node.pid)
            for _ in range(_TURNS):
                await mine.add(10, read)
                await bare.add(10, read_bare)
    return _row("read one message of 100 Hz", mine.each_ms, bare.each_ms)


async def _acknowledged_publish() -> Row:
    with Peer("heard"), Peer("floor") as node:
        async with ours() as us:
            await us.greet()
            while not (await us.call("ros2_topic_publish", **_HEARD))["acknowledged"]:
                await asyncio.sleep(0.02)
            node.seconds("publish", 20)
            mine, bare = await _used_by(us), Used(node.pid)
            for _ in range(_TURNS):
                await mine.add(10, lambda: us.call("ros2_topic_publish", **_HEARD))
                await bare.add(10, lambda: _asked(node, "publish"))
    return _row("acknowledged publish", mine.each_ms, bare.each_ms)


_MEASUREMENTS = (_start_to_tools_list, _topic_list, _service_call, _read_one, _acknowledged_publish)


def _recorded() -> dict[str, float]:
    return json.loads(_RATIOS.read_text())


def _row(what: str, used_ms: float, floor_ms: float) -> Row:
    recorded = _recorded()[what]
    limit = round(recorded * GROWN, 2)
    return Row(what, used_ms, "ms of processor", limit, floor_ms, f"recorded: {recorded:.2f} ×")


async def _best(measurement: Callable[[], Awaitable[Row]]) -> Row:
    """Return the row with the best ratio of some attempts."""
    rows: list[Row] = []
    for _ in range(_ATTEMPTS):
        rows.append(await measurement())
        if rows[-1].verdict == "ok":
            break
    return min(rows, key=lambda row: row.ratio or 0.0)


async def _all() -> Sequence[Row]:
    rows = [await _best(measurement) for measurement in _MEASUREMENTS]
    assert {row.what for row in rows} == _recorded().keys(), "each recorded ratio is measured"
    return rows


def main() -> None:
    """Print the table; exit with 1 if a ratio has grown by half, unless `--record` is given."""
    rows = asyncio.run(_all())
    print(table(rows))
    if sys.argv[1:] == ["--record"]:
        ratios = {row.what: round(row.ratio or 0.0, 2) for row in rows}
        _RATIOS.write_text(json.dumps(ratios, indent=1, ensure_ascii=False) + "\n")
        return
    grown = [row.what for row in rows if row.verdict != "ok"]
    if grown:
        sys.exit(
            f"Takes half as much processor time again as recorded, against the same floor: {', '.join(grown)}. "
            "See docs/explanation/speed.md"
        )


if __name__ == "__main__":
    main()
