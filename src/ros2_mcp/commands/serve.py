"""Serve MCP: the main job. The bridge starts first, the heavy imports follow while it comes up."""

from __future__ import annotations

import asyncio
import gc
import logging
import os
import signal
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from ros2_mcp.model.text import LAYOUT, visible
from ros2_mcp.settings import Settings

if TYPE_CHECKING:
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


class LogFormatter(logging.Formatter):
    """Log lines in which nothing is hidden: what they say of a robot's text may be read in a terminal."""

    def formatMessage(self, record: logging.LogRecord) -> str:
        """The message, on one line."""
        return visible(super().formatMessage(record))

    def formatException(self, ei: Any) -> str:
        """The traceback, on several lines."""
        return visible(super().formatException(ei), keep=LAYOUT)


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
    """Serves in one task group. The robot is left in peace before the process ends, whatever ends it."""
    # Imported here because the bridge has been launched now, and comes up meanwhile.
    import anyio

    from ros2_mcp.assembly import assemble
    from ros2_mcp.ops.memory.record import keep_black_box

    assembly = assemble(settings, bridge)
    # One line for each message, without time and place: it is read in a client's log, which adds its own.
    shown = logging.StreamHandler()
    shown.setFormatter(LogFormatter("%(message)s"))
    logging.basicConfig(level=settings.log_level.upper(), handlers=[shown])
    if wire:
        from ros2_mcp.server import serve_stdio

        serving = serve_stdio(assembly.server, wire.read_fd, wire.write_fd)
    else:
        from ros2_mcp.http import serve_http  # brings uvicorn, which stdio does not need

        serving = serve_http(assembly.server, assembly.leases, settings)
    gc.freeze()
    gc.enable()

    ending, failures = asyncio.Event(), list[BaseException]()

    async def serve_until_the_client_leaves() -> None:
        try:
            await serving
        except (Exception, SystemExit) as error:  # noqa: BLE001 - raised below: here it would cancel what stops the robot
            failures.append(error)  # uvicorn exits where it cannot listen
        finally:
            ending.set()

    for number in (signal.SIGTERM, signal.SIGINT, signal.SIGHUP):
        asyncio.get_running_loop().add_signal_handler(number, ending.set)
    async with anyio.create_task_group() as tasks:
        async with assembly.running():
            if not assembly.store.subject:
                assembly.robot.log.start()
                tasks.start_soon(keep_black_box, assembly.robot, assembly.store, settings)
            tasks.start_soon(serve_until_the_client_leaves)
            await ending.wait()
        if not failures:
            # The thread that reads stdin cannot be interrupted, and leaving the group would wait for it.
            logging.shutdown()
            os._exit(0)
        tasks.cancel_scope.cancel()
    raise failures[0]
