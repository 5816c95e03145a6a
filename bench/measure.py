"""The measurements. What is compared is measured alternately, so that other load on the machine affects both."""

from __future__ import annotations

import asyncio
import random
import sys
import time
from collections.abc import Awaitable, Callable
from contextlib import ExitStack
from pathlib import Path
from typing import Any

from ros2_mcp_interfaces import build, default_cache

from . import slowed
from .processes import ENVIRONMENT, Peer, counts, cpu_seconds, ours, rss_bytes, trivial
from .report import Row, p50, p99
from .stdio import StdioClient

TOPICS = 40
MANY_TOPICS = 236
PROCESSES = 4
FRAMES = 10
SET = {"service_type": "std_srvs/srv/SetBool", "service_name": "/bench/set", "fields": {"data": True}}


async def timed(call: Awaitable[Any]) -> float:
    started = time.perf_counter()
    await call
    return time.perf_counter() - started


async def start_to_tools_list(rounds: int) -> list[Row]:
    async def start(make: Callable[[], StdioClient]) -> float:
        client, started = make(), time.perf_counter()
        async with client:
            await client.greet()
            return time.perf_counter() - started

    times: dict[Any, list[float]] = {ours: [], trivial: []}
    for make in (ours, trivial):
        await start(make)  # compiles what is not compiled yet
    for _ in range(rounds):
        for make, seconds in times.items():
            seconds.append(await start(make))
    return [Row("start → tools/list, p50", p50(times[ours]), "ms", 1.2, p50(times[trivial]))]


async def topic_list(rounds: int) -> list[Row]:
    mine, floor = [], []
    with Peer("topics", TOPICS):
        async with ours() as us, trivial() as them:
            await us.greet()
            await them.greet()
            await complete_listing(us)
            for _ in range(rounds):
                mine.append(await timed(us.call("ros2_topic_list")))
                floor.append(await timed(them.call("ping")))
    return [
        Row(f"ros2_topic_list, {TOPICS} topics, p50", p50(mine), "ms", 2, p50(floor)),
        Row(f"ros2_topic_list, {TOPICS} topics, p99", p99(mine), "ms", 3, p99(floor)),
    ]


async def complete_listing(client: StdioClient) -> int:
    """Ask until every topic of the peer is listed; return how often an incomplete listing was called settled."""
    untrue = 0
    while True:
        listing = await client.call("ros2_topic_list", pattern="/bench/t*")
        if len(listing["topics"]) >= TOPICS:
            return untrue
        untrue += listing["settled"]
        await asyncio.sleep(0.02)


async def first_listing(rounds: int) -> list[Row]:
    times, floor, untrue = [], [], 0
    share = TOPICS // PROCESSES
    with ExitStack() as peers:
        for number in range(PROCESSES):
            peers.enter_context(Peer("topics", share, share * number))
        for _ in range(rounds):
            client, started = ours(), time.perf_counter()
            async with client:
                await client.greet()
                untrue += await complete_listing(client)
                times.append(time.perf_counter() - started)
            floor.append(await discovery())
    times.sort()
    floor.sort()
    in_19_of_20 = times[rounds - 1 - rounds // 20]  # with fewer than 20 rounds the slowest
    spread = "{}; bare rclpy {}".format(*(", ".join(f"{s:.2f}" for s in found) for found in (times, floor)))
    return [
        Row(f"start → listing with all of {PROCESSES} processes, 19 of 20", in_19_of_20, "s", 1.0, note=spread),
        Row(f"incomplete, but called settled, in {rounds} starts", untrue, "times", 0),
    ]


async def discovery() -> float:
    """Return the time in s that a fresh process with bare rclpy needs to discover all topics."""
    started = time.perf_counter()
    command = slowed.command([sys.executable, str(Path(__file__).parent / "discovery.py"), str(TOPICS)])
    pipe = asyncio.subprocess.PIPE
    process = await asyncio.create_subprocess_exec(*command, env=ENVIRONMENT, stdout=pipe)
    assert process.stdout
    await process.stdout.readline()
    complete_s = time.perf_counter() - started
    await process.wait()
    return complete_s


async def read_one(rounds: int) -> list[Row]:
    mine, floor = [], []
    with Peer("ticks", 1, 100), Peer("floor") as bare:
        async with ours() as us:
            await us.greet()
            await us.call("ros2_topic_subscribe", topic_name="/bench/tick0")
            for _ in range(rounds):  # each read begins at a random time between two messages
                await asyncio.sleep(random.uniform(0, 0.01))
                mine.append(await timed(us.call("ros2_topic_subscribe", topic_name="/bench/tick0")))
                await asyncio.sleep(random.uniform(0, 0.01))
                floor += bare.seconds("read", 1)
    return [
        Row("read one message of 100 Hz, p50", p50(mine), "ms", 1.5, p50(floor)),
        Row("read one message of 100 Hz, p99", p99(mine), "ms", floor=p99(floor)),
    ]


async def while_subscribed(rounds: int) -> list[Row]:
    quiet, one, ten = [], [], []
    with Peer("ticks", 10, 100):
        async with ours() as us:
            await us.greet()
            await us.call("ros2_topic_subscribe", topic_name="/bench/tick0")
            for _ in range(rounds):
                quiet += await listings_during(us, asyncio.sleep(3))
                one += await listings_during(us, subscriptions(us, 1))
                ten += await listings_during(us, subscriptions(us, 10))
    floor = p50(quiet)
    return [
        Row("ros2_topic_list during a subscription of 3 s, p50", p50(one), "ms", 2, floor),
        Row("ros2_topic_list during ten of them, p50", p50(ten), "ms", 2, floor),
    ]


async def subscriptions(client: StdioClient, count: int) -> None:
    names = [f"/bench/tick{number}" for number in range(count)]
    await asyncio.gather(*(client.call("ros2_topic_subscribe", topic_name=name, duration=3) for name in names))


async def listings_during(client: StdioClient, other: Awaitable[Any]) -> list[float]:
    """Return the times of topic listings, about 30 a second, while `other` runs."""
    task, seconds = asyncio.ensure_future(other), []
    while not task.done():
        seconds.append(await timed(client.call("ros2_topic_list")))
        await asyncio.sleep(0.02)
    await task
    return seconds


async def flooded(rate_hz: int, duration_s: int) -> list[Row]:
    count = rate_hz * duration_s
    with Peer("flood", rate_hz, count) as peer, Peer("drained") as bare:
        async with ours() as us:
            await us.greet()
            await us.call("ros2_get_message_fields", message_type="std_msgs/msg/UInt64")
            quiet = await listings_during(us, asyncio.sleep(duration_s / 2))
            draining = asyncio.ensure_future(asyncio.to_thread(bare.ask, str(duration_s + 2)))
            beside_bare = await listings_during(us, draining)
            missed_by_bare = int(peer.line()) - int(await draining)
            before = rss_bytes(us.pid)
            reading = asyncio.ensure_future(
                us.call("ros2_topic_subscribe", topic_name="/bench/flood", duration=duration_s + 2)
            )
            busy = await listings_during(us, asyncio.wait({reading}))
            grown = (rss_bytes(us.pid) - before) / 1e6
            result = await reading
        sent = int(peer.line())
    unaccounted = sent - result["received"] - (result["lost"] or 0)
    found = f"sent {sent}, received {result['received']}, lost {result['lost']}, dropped {result['dropped']}"
    found += f"; bare rclpy missed {missed_by_bare} of them"
    beside = f"while bare rclpy drains it: {p50(beside_bare):.1f}, {p99(beside_bare):.1f} ms"
    return [
        Row(f"{rate_hz} Hz for {duration_s} s: messages unaccounted for", abs(unaccounted), "", 0, note=found),
        Row("ros2_topic_list meanwhile, p50", p50(busy), "ms", floor=p50(quiet)),
        Row("ros2_topic_list meanwhile, p99", p99(busy), "ms", 2, p99(quiet), note=f"p50 and p99 {beside}"),
        Row("growth of the server's memory by it", grown, "MB", 100),
    ]


async def service_calls(rounds: int) -> list[Row]:
    mine, floor, bare = [], [], []
    with Peer("service"), Peer("floor") as node:
        async with ours() as us, trivial() as them:
            await us.greet()
            await them.greet()
            await us.call("ros2_service_call", **SET)
            for _ in range(rounds):
                mine.append(await timed(us.call("ros2_service_call", **SET)))
                floor.append(await timed(them.call("ping")))
                bare += node.seconds("call", 1)
    parts = f"trivial tool {p50(floor):.2f} + rclpy {p50(bare):.2f} ms"
    return [Row("ros2_service_call, p50", p50(mine), "ms", 1.3, p50(floor) + p50(bare), note=parts)]


async def acknowledged_publish(rounds: int) -> list[Row]:
    """Measure the time from the call to the answer that every subscriber has acknowledged; the floor does the same in
    bare rclpy."""
    message = {"topic_name": "/bench/heard", "message_type": "std_msgs/msg/UInt64", "data": {"data": 1}}
    mine, floor, unacknowledged = [], [], 0
    with Peer("heard"), Peer("floor") as bare:
        async with ours() as us:
            await us.greet()
            while not (await us.call("ros2_topic_publish", **message))["acknowledged"]:
                await asyncio.sleep(0.02)
            bare.seconds("publish", 20)
            for _ in range(rounds):
                started = time.perf_counter()
                published = await us.call("ros2_topic_publish", **message)
                mine.append(time.perf_counter() - started)
                unacknowledged += not published["acknowledged"]
                floor += bare.seconds("publish", 1)
    return [
        Row("acknowledged publish, p50", p50(mine), "ms", 5, note=f"bare rclpy: {p50(floor):.1f} ms"),
        Row("acknowledged publish, p50 beside bare rclpy", p50(mine), "ms", floor=p50(floor)),
        Row("not acknowledged", unacknowledged, "times", 0),
    ]


async def idle(duration_s: float) -> list[Row]:
    """Measure the server and its bridge without calls; the floor is the trivial tool and a bare node."""
    with Peer("topics", MANY_TOPICS), Peer("floor") as bare:
        async with ours() as us, trivial() as them:
            await us.greet()
            await them.greet()
            asked = {"pattern": "/bench/t*", "limit": MANY_TOPICS}
            while len((await us.call("ros2_topic_list", **asked))["topics"]) < MANY_TOPICS:
                await asyncio.sleep(0.1)
            await asyncio.sleep(3)  # work that follows the first listing
            pids = us.pid, (await us.call("ros2_status"))["bridge_pid"], them.pid, bare.pid
            await asyncio.sleep(3)  # work that follows the status
            before = [cpu_seconds(pid) for pid in pids]
            await asyncio.sleep(duration_s)
            used = [(cpu_seconds(pid) - then) / duration_s * 100 for pid, then in zip(pids, before, strict=True)]
            memory = [rss_bytes(pid) / 1e6 for pid in pids]
    parts = "server {:.0f}, bridge {:.0f}; SDK {:.0f}, bare rclpy {:.0f} MB".format(*memory)
    cpu = "server {:.2f}, bridge {:.2f}; SDK {:.2f}, bare rclpy {:.2f} %".format(*used)
    return [
        Row(f"memory, idle, {MANY_TOPICS} topics", sum(memory[:2]), "MB", 145, note=parts),
        Row(f"processor, idle, {MANY_TOPICS} topics", sum(used[:2]), "% of a core", 0.2, note=cpu),
    ]


def transforms_peer() -> Peer:
    """Return a peer that publishes a chain of frames at 50 Hz."""
    tf2_msgs = Path(__file__).parents[1] / "src" / "ros2_mcp_demo" / "interfaces" / "tf2_msgs"
    return Peer("frames", FRAMES, 50, prefixes=build([tf2_msgs], default_cache(), lambda _line: None))


async def look_up(rounds: int) -> list[Row]:
    """Measure a transform across ten moving edges, published at 50 Hz."""
    asked = {"target": "map", "source": f"on_moving_{FRAMES - 1}"}
    mine, floor = [], []
    with transforms_peer():
        async with ours() as us, trivial() as them:
            await us.greet()
            await them.greet()
            await us.call("ros2_tf_lookup", **asked)
            for _ in range(rounds):
                mine.append(await timed(us.call("ros2_tf_lookup", **asked)))
                floor.append(await timed(them.call("ping")))
    return [Row(f"ros2_tf_lookup, warm, {FRAMES} moving edges, p50", p50(mine), "ms", 3, p50(floor))]


async def many_calls(count: int) -> list[Row]:
    with Peer("service"):
        async with ours() as us:
            await us.greet()
            await us.call("ros2_service_call", **SET)
            started = time.perf_counter()
            burst = (us.call("ros2_service_call", **SET) for _ in range(100))
            answers = await asyncio.gather(*burst, return_exceptions=True)
            elapsed = time.perf_counter() - started
            before = await everything_open(us)
            for _ in range(count):
                await us.call("ros2_service_call", **SET)
            after = await everything_open(us)
    unanswered = sum(isinstance(answer, BaseException) for answer in answers)
    changed = {name: (before[name], after[name]) for name in before if before[name] != after[name]}
    return [
        Row("100 calls in flight: unanswered", unanswered, "", 0, note=f"all in {elapsed * 1000:.0f} ms"),
        Row(f"{count} calls: counts that changed", len(changed), "", 0, note=str(changed or before)),
    ]


async def everything_open(client: StdioClient) -> dict[str, int]:
    """Return the bridge's entities, and the threads and open files of both processes."""
    status = await client.call("ros2_status")
    server, bridge = counts(client.pid), counts(status["bridge_pid"])
    entities = {name: status[name] for name in ("subscriptions", "publishers", "service_clients")}
    return {
        **entities,
        "threads": server[0],
        "files": server[1],
        "bridge_threads": bridge[0],
        "bridge_files": bridge[1],
    }


async def sandbox(rounds: int) -> list[Row]:
    """Measure a program from its call to its answer, and a call from the program and back, compared with a trivial
    tool."""
    calls = 200
    loop = f"import robot\nfor _ in range({calls}):\n    robot.mean([1.0, 2.0])\n"
    whole, floor, out_and_back = [], [], []
    async with ours() as us, trivial() as them:
        await us.greet()
        await them.greet()
        await us.call("ros2_program_run", program="1 + 1")
        for _ in range(rounds):
            one = await timed(us.call("ros2_program_run", program="1 + 1"))
            many = await timed(us.call("ros2_program_run", program=loop))
            whole.append(one)
            out_and_back.append((many - one) / calls)
            floor.append(await timed(them.call("ping")))
    return [
        Row("ros2_program_run of a program without calls, p50", p50(whole), "ms", floor=p50(floor)),
        Row("a call of a program's, out and back, p50", p50(out_and_back), "ms"),
    ]
