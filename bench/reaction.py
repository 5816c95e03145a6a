"""The reaction time of a program to a message: from the peer's publish to the peer's receipt of the answer."""

from __future__ import annotations

import asyncio
import json

from .processes import Peer, ours
from .report import Row, p50, p99
from .stdio import CallFailed, StdioClient

HZ = 100
SOME = 10
"""Every tenth message meets the condition."""
BAR_MS = 1000 / HZ + 5
WARM_S, LONG_S = 5.0, 10.0
PROGRAM = f"""import robot
for message in robot.messages("/bench/tick@", duration=60):
    if message["data"] // COUNT % {SOME} == 0:
        robot.publish("/bench/back@", message_type="std_msgs/msg/UInt64", data={{"data": message["data"]}})
"""


async def reactions(client: StdioClient, peer: Peer, programs: int, seconds: float) -> list[float]:
    """Return the times in s from message to answer, with `programs` programs at once."""
    running = [
        asyncio.ensure_future(
            client.call(
                "ros2_program_run",
                program=PROGRAM.replace("@", str(number)).replace("COUNT", str(programs)),
                timeout=60,
            )
        )
        for number in range(programs)
    ]
    try:
        await asyncio.sleep(WARM_S)
        await asyncio.to_thread(peer.ask, "forget")
        await asyncio.sleep(seconds)
        return json.loads(await asyncio.to_thread(peer.ask, "tell"))
    finally:
        for one in running:
            one.cancel()
        for one in running:
            try:
                await one
            except (asyncio.CancelledError, CallFailed) as error:
                print(repr(error)[:500])


async def of_programs(full: bool) -> list[Row]:
    """Measure the target of issue 15: one period and 5 ms for 99 of 100, with ten programs at once."""
    rows: list[Row] = []
    for programs in (1, 10):
        with Peer("reactions", programs, HZ) as peer:
            async with ours() as us:
                await us.greet()
                took_s = await reactions(us, peer, programs, LONG_S * (6 if full else 1))
        what = f"message of {HZ} Hz → reaction of a program, {programs} at once, p99"
        note = f"p50 {p50(took_s):.1f} ms, {len(took_s)} reactions" if took_s else "no reaction"
        rows.append(Row(what, p99(took_s) if took_s else float("inf"), "ms", BAR_MS, note=note))
    return rows
