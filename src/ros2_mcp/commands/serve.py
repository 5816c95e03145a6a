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
    from ros2_mcp.assembly import Assembly
    from ros2_mcp.link.client import Bridge


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
    asyncio.run(_serve(launch(settings), settings, wire))
    return 0


def launch(settings: Settings) -> Bridge | None:
    """Starts the bridge, if there is a robot; it comes up while the rest is imported."""
    from ros2_mcp.link.carriers import start_carrier
    from ros2_mcp.link.client import Bridge

    if settings.bag:
        return None
    bridge = Bridge(lambda: start_carrier(settings))
    bridge.launch()
    return bridge


async def _serve(bridge: Bridge | None, settings: Settings, wire: Wire | None) -> None:
    from ros2_mcp.assembly import assemble

    assembly = assemble(settings, bridge)
    # One line for each message, without time and place: it is read in a client's log, which adds its own.
    logging.basicConfig(level=settings.log_level.upper(), format="%(message)s")
    if wire:
        from ros2_mcp.server import serve_stdio

        running = serve_stdio(assembly.server, wire.read_fd, wire.write_fd)
    else:
        from ros2_mcp.http import serve_http  # brings uvicorn, which stdio does not need

        running = serve_http(assembly.server, settings)
    gc.freeze()
    gc.enable()
    await _until_told_to_end(assembly, running)


async def _until_told_to_end(assembly: Assembly, running: Awaitable[None]) -> None:
    from ros2_mcp.ops.memory.record import keep_black_box

    told_to_end = asyncio.Event()
    background: list[asyncio.Task[None]] = []
    for number in (signal.SIGTERM, signal.SIGINT, signal.SIGHUP):
        asyncio.get_running_loop().add_signal_handler(number, told_to_end.set)
    async with assembly.running():
        if not assembly.store.subject:
            assembly.robot.log.start()
            keeping = keep_black_box(assembly.robot, assembly.store, assembly.settings)
            background.append(asyncio.create_task(keeping))
        serving = asyncio.ensure_future(running)
        ending = asyncio.create_task(told_to_end.wait())
        try:
            await asyncio.wait({serving, ending}, return_when=asyncio.FIRST_COMPLETED)
        finally:
            for task in background:
                task.cancel()
    if serving.done():
        serving.result()
    # The robot is left in peace. The thread that reads stdin cannot be interrupted, and asyncio would wait for it.
    logging.shutdown()
    os._exit(0)
