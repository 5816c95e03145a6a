"""Serve MCP: the main job. The bridge starts first, the heavy imports follow while it comes up."""

from __future__ import annotations

import asyncio
import gc
import logging
import os
import signal
from collections.abc import Awaitable
from dataclasses import dataclass
from typing import TYPE_CHECKING

from ros2_mcp.settings import Settings

if TYPE_CHECKING:
    from ros2_mcp.link.client import Bridge
    from ros2_mcp.ops.memory import Memory
    from ros2_mcp.robot import Robot


@dataclass(frozen=True, slots=True)
class Wire:
    """Private duplicates of the process's stdin and stdout, for MCP alone."""

    read_fd: int
    write_fd: int


def claim_wire() -> Wire:
    """Moves stdin and stdout aside: whatever else reads or prints gets nothing and stderr."""
    wire = Wire(os.dup(0), os.dup(1))
    with open(os.devnull, "rb") as nothing:  # noqa: PTH123 - pathlib is not imported yet, and is slow to
        os.dup2(nothing.fileno(), 0)
    os.dup2(2, 1)
    return wire


def serve(settings: Settings) -> int:
    """Serves until the client goes away or the process is told to end."""
    gc.disable()  # looking for garbage among what is imported, where there is none, is a fifth of the start
    wire = claim_wire() if settings.transport == "stdio" else None
    bridge = None if settings.bag else launch(settings)
    asyncio.run(_serve(bridge, settings, wire))
    return 0


def launch(settings: Settings) -> Bridge:
    """Starts the bridge; it comes up while the rest is imported."""
    from ros2_mcp.link.carriers import start_carrier
    from ros2_mcp.link.client import Bridge

    bridge = Bridge(lambda: start_carrier(settings))
    bridge.launch()
    return bridge


async def _serve(bridge: Bridge | None, settings: Settings, wire: Wire | None) -> None:
    from ros2_mcp.guard.policy import Policy
    from ros2_mcp.http import serve_http
    from ros2_mcp.ops.memory import Memory
    from ros2_mcp.ops.recorded_robot import recorded_robot
    from ros2_mcp.robot import Robot
    from ros2_mcp.server import build_server, serve_stdio

    memory = Memory(settings.record_dir, settings.bag_dir, settings.bag)
    if bridge is None:
        robot = recorded_robot(memory, settings.result_bytes)
    else:
        robot = Robot(bridge, Policy(settings.read_only), settings.result_bytes)
    server = build_server(
        robot, groups=settings.tools, log_level=settings.log_level.upper(), settings=settings, memory=memory
    )
    gc.freeze()
    gc.enable()
    running = serve_stdio(server, wire.read_fd, wire.write_fd) if wire else serve_http(server, settings)
    await _until_told_to_end(robot, memory, settings, running)


async def _until_told_to_end(robot: Robot, memory: Memory, settings: Settings, running: Awaitable[None]) -> None:
    from ros2_mcp.ops.recording import keep_black_box

    told_to_end = asyncio.Event()
    background: list[asyncio.Task[None]] = []
    for number in (signal.SIGTERM, signal.SIGINT, signal.SIGHUP):
        asyncio.get_running_loop().add_signal_handler(number, told_to_end.set)
    if not memory.subject:
        await robot.bridge.attach()
        robot.log.start()
        background.append(asyncio.create_task(keep_black_box(robot, memory, settings)))
    serving = asyncio.ensure_future(running)
    ending = asyncio.create_task(told_to_end.wait())
    try:
        await asyncio.wait({serving, ending}, return_when=asyncio.FIRST_COMPLETED)
    finally:
        for task in background:
            task.cancel()
        await robot.jobs.close()
        await memory.close()
        await robot.bridge.close()
    if serving.done():
        serving.result()
    # The robot is left in peace. The thread that reads stdin cannot be interrupted, and asyncio would wait for it.
    logging.shutdown()
    os._exit(0)
