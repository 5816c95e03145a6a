"""How times and memory grow: `python -m bench.growth topics|nodes|clients [N …]` measures points, `draw` draws them.

Points are kept in docs/explanation/growth.json; a new one takes the place of an old one of the same size. Publishers
and nodes are spread over few processes, as each process is a participant and DDS on one machine has room for about 30.
"""

from __future__ import annotations

import argparse
import asyncio
import json
import os
import platform
import socket
import subprocess
import sys
import tempfile
import time
from collections.abc import Awaitable, Callable, Iterator
from contextlib import AsyncExitStack, ExitStack, contextmanager
from pathlib import Path
from typing import Any

from . import growth_plot
from .http_client import HttpClient
from .measure import timed
from .processes import ENVIRONMENT, Peer, ours, rss_bytes
from .report import p50
from .stdio import CallFailed, StdioClient
from .stopping import TWIST

KEPT = Path(__file__).parents[1] / "docs" / "explanation" / "growth.json"
SIZES = {"topics": (10, 40, 150, 550, 2000), "nodes": (10, 25, 70, 190, 500), "clients": (1, 3, 7, 18, 50)}
PROCESSES = 4
STARTS, CALLS, STOPS = 3, 40, 10
MOVES_S = 0.5
"""Time for which the robot moves before each stop."""
OF_A_TOKEN = 13
"""Number of clients that share a token: one login may have 16 sessions."""
EVERY_S = 0.5
"""Period with which each of the other clients asks for the listing while one client stops the robot."""


@contextmanager
def graph_of(what: str, count: int) -> Iterator[None]:
    """Create `count` topics on 4 nodes, or `count` nodes, in 4 processes."""
    share, more = divmod(count, PROCESSES)
    with ExitStack() as peers:
        first = 0
        for number in range(PROCESSES):
            here = share + (number < more)
            peers.enter_context(Peer(what, here, first))
            first += here
        yield


async def whole(client: Any, what: str, count: int) -> None:
    """Ask until all topics or nodes of the peers are listed."""
    tool, key, pattern = {
        "topics": ("ros2_topic_list", "topics", "/bench/t*"),
        "nodes": ("ros2_node_list", "nodes", "/bench/n*"),
    }[what]
    while len((await client.call(tool, pattern=pattern, limit=2000))[key]) < count:
        await asyncio.sleep(0.02)


async def on_graph(what: str, count: int) -> dict[str, float]:
    """Measure one point of the growth with topics or nodes."""
    starts: list[float] = []
    with graph_of(what, count):
        for _ in range(STARTS):
            client, started = ours(), time.perf_counter()
            async with client:
                await client.greet()
                await whole(client, what, count)
                starts.append(time.perf_counter() - started)
        async with ours() as us:
            await us.greet()
            await whole(us, what, count)
            point = {"first_s": round(sorted(starts)[STARTS // 2], 3), "slowest_first_s": round(max(starts), 3)}
            point |= await answers(us)
            with Peer("driven", 1) as peer:
                point |= await stops(us, peer)
                asking = asyncio.ensure_future(keep_listing(us))
                point |= {key.replace("stop", "stop_beside"): value for key, value in (await stops(us, peer)).items()}
                asking.cancel()
                await asyncio.wait({asking})
            return point | await memory(us.pid, us)


async def answers(client: Any) -> dict[str, float]:
    """Return the median times of the calls that list something."""
    asked: dict[str, Callable[[], Awaitable[Any]]] = {
        "topic_list_ms": lambda: client.call("ros2_topic_list", limit=2000),
        "topic_list_default_ms": lambda: client.call("ros2_topic_list"),
        "node_list_ms": lambda: client.call("ros2_node_list", limit=2000),
        "robot_ms": lambda: client.call("ros2_robot"),
    }
    found: dict[str, float] = {}
    for name, call in asked.items():
        await call()
        seconds: list[float] = []
        ends = time.perf_counter() + 6
        while len(seconds) < CALLS and time.perf_counter() < ends:
            seconds.append(await timed(call()))
        found[name] = round(p50(seconds), 2)
    return found


async def stops(client: Any, peer: Peer, moving: Any = None) -> dict[str, float]:
    """Return the time from the call of ros2_stop to the zero at a subscriber in another process: the median and the
    slowest.

    `moving` is the client that drives the robot; None: the same client, which can then make two calls at a time.
    """
    drive = {"topic_name": "/bench/vel0", "message_type": TWIST, "data": {"linear": {"x": 0.1}}, "frequency": 20}
    seconds: list[float] = []
    for _ in range(STOPS):
        repeat = asyncio.ensure_future((moving or client).call("ros2_topic_publish", **drive, duration=60))
        await asyncio.to_thread(peer.ask, "moving 1")
        await asyncio.sleep(MOVES_S)
        started = time.monotonic()
        stopping = asyncio.ensure_future(client.call("ros2_stop"))
        seconds.append(float(json.loads(await asyncio.to_thread(peer.ask, "zeros"))) - started)
        await asyncio.wait({stopping, repeat})
    return {"stop_ms": round(p50(seconds), 2), "slowest_stop_ms": round(max(seconds) * 1000, 2)}


async def keep_listing(client: StdioClient) -> None:
    """Request one whole listing after the other."""
    while True:
        await client.call("ros2_topic_list", limit=2000)


async def memory(server: int, client: Any) -> dict[str, float]:
    """Return the resident memory of the server, of its bridge, and of the other processes below the server (the
    stopper)."""
    bridge = (await client.call("ros2_status"))["bridge_pid"]
    others = [pid for pid in descendants(server) if pid != bridge]
    sizes = rss_bytes(server), rss_bytes(bridge), sum(rss_bytes(pid) for pid in others)
    return dict(zip(("server_mb", "bridge_mb", "stopper_mb"), (round(size / 1e6, 1) for size in sizes), strict=True))


def descendants(pid: int) -> list[int]:
    """Return the processes below a process."""
    listed = subprocess.run(["ps", "-e", "-o", "pid=,ppid="], check=True, capture_output=True, text=True).stdout
    above = [tuple(map(int, line.split())) for line in listed.splitlines()]
    found = [pid]
    for one in found:
        found += [child for child, parent in above if parent == one]
    return found[1:]


@contextmanager
def serving(tokens: int) -> Iterator[tuple[int, int, list[str]]]:
    """Start our server over HTTP; yield its process id, its port, and `tokens` tokens."""
    with tempfile.TemporaryDirectory() as folder, socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
        free.close()
        us = [sys.executable, "-m", "ros2_mcp", "--token-file", f"{folder}/tokens"]
        made = [
            subprocess.run([*us, "token", f"bench{number}"], check=True, capture_output=True, text=True).stdout.strip()
            for number in range(tokens)
        ]
        process = subprocess.Popen(
            [*us, "--transport", "streamable-http", "--port", str(port)], env=ENVIRONMENT, stderr=subprocess.DEVNULL
        )
        try:
            while process.poll() is None:
                with socket.socket() as knock:
                    if knock.connect_ex(("127.0.0.1", port)) == 0:
                        break
                time.sleep(0.05)
            yield process.pid, port, made
        finally:
            process.terminate()
            process.wait(20)


async def with_clients(count: int) -> dict[str, float]:
    """Measure one point of the growth with clients: sessions of one HTTP server with 40 topics. One more client drives
    the robot."""
    tokens = -(-(count + 1) // OF_A_TOKEN)
    with graph_of("topics", 40), serving(tokens) as (pid, port, made), Peer("driven", 1) as peer:
        async with AsyncExitStack() as stack:
            driver, first, *others = [
                await stack.enter_async_context(HttpClient(port, made[number // OF_A_TOKEN]))
                for number in range(count + 1)
            ]
            await whole(first, "topics", 40)
            for one in (first, *others):
                await one.call("ros2_topic_list")
            point = {name: value for name, value in (await answers(first)).items() if name != "topic_list_ms"}
            bursts = [await burst([first, *others]) for _ in range(10)]
            point["all_at_once_ms"] = round(p50([seconds for seconds, _ in bursts]), 2)
            point["refused"] = sum(refused for _, refused in bursts) / len(bursts)
            point |= await stops(first, peer, driver)
            asking = [asyncio.ensure_future(keep_asking(one, number / count)) for number, one in enumerate(others)]
            point |= {
                key.replace("stop", "stop_beside"): value for key, value in (await stops(first, peer, driver)).items()
            }
            point |= await memory(pid, first)
            for one in asking:
                one.cancel()
            await asyncio.wait(asking) if asking else None
            return point


async def burst(clients: list[HttpClient]) -> tuple[float, int]:
    """Let every client request the listing at the same time; return the time until all have it, and the number of
    refusals.

    A server executes 32 calls at a time; a refused client asks again at once.
    """
    refused = 0

    async def listing(client: HttpClient) -> None:
        nonlocal refused
        while True:
            try:
                await client.call("ros2_topic_list")
                return
            except CallFailed:
                refused += 1

    started = time.perf_counter()
    await asyncio.gather(*map(listing, clients))
    return time.perf_counter() - started, refused


async def keep_asking(client: HttpClient, phase: float) -> None:
    """Request the listing every half second, each client with another phase."""
    due = time.monotonic() + phase * EVERY_S
    while True:
        await asyncio.sleep(due - time.monotonic())
        await client.call("ros2_topic_list")
        due = max(due + EVERY_S, time.monotonic())


def keep(what: str, point: dict[str, float]) -> None:
    """Add a point to the file; it replaces one of the same size."""
    found: dict[str, Any] = json.loads(KEPT.read_text()) if KEPT.exists() else {}
    points = {each["n"]: each for each in found.get(what, ())} | {point["n"]: point}
    found["machine"] = f"{os.cpu_count()} processors, Python {platform.python_version()}"
    found[what] = [points[size] for size in sorted(points)]
    text = (
        json.dumps(found, ensure_ascii=False).replace("[{", "[\n  {").replace("}, {", "},\n  {").replace("], ", "],\n ")
    )
    KEPT.write_text(text + "\n")


def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m bench.growth", description=__doc__)
    parser.add_argument("what", choices=[*SIZES, "draw"])
    parser.add_argument("sizes", nargs="*", type=int, metavar="N")
    arguments = parser.parse_args()
    if arguments.what == "draw":
        print(growth_plot.draw(json.loads(KEPT.read_text()), KEPT.parent))
        return
    for size in arguments.sizes or SIZES[arguments.what]:
        measured = with_clients(size) if arguments.what == "clients" else on_graph(arguments.what, size)
        point = {"n": size, **asyncio.run(measured), "load": round(os.getloadavg()[0], 1)}
        print(json.dumps(point), flush=True)
        keep(arguments.what, point)


if __name__ == "__main__":
    main()
