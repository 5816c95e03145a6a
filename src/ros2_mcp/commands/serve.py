"""Serve MCP, the main command. The bridge is launched first; the slow imports run while it starts."""

from __future__ import annotations

import asyncio
import gc
import logging
import os
import sys
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from ros2_mcp.commands.endings import when_told_to_end
from ros2_mcp.guard.entrance import Entrance, check_tls, entrance_of
from ros2_mcp.model.text import LAYOUT, visible
from ros2_mcp.settings import Settings
from ros2_mcp_common.allocation import keep_freed_memory

if TYPE_CHECKING:
    from ros2_mcp.link.client import Bridge
    from ros2_mcp.mcp.fleet import Member


_TO_A_PERSON = """\
ros2-mcp waits for an MCP client, which starts it by itself and speaks to it over stdin and stdout; nothing that is
typed here is understood. Ctrl+C ends it.
  ros2-mcp config claude-code     prints what configures a client (config --help names the others)
  ros2-mcp call ros2_topic_list   calls a tool without one
  ros2-mcp --help                 shows everything else
"""
"""Shown when the server is started in a terminal, without a client."""


@dataclass(frozen=True, slots=True)
class Wire:
    """Private duplicates of the process's stdin and stdout, used only for MCP."""

    read_fd: int
    write_fd: int


def claim_wire() -> Wire:
    """Duplicate stdin and stdout for MCP, and replace them: other code reads nothing, and prints to stderr."""
    wire = Wire(os.dup(0), os.dup(1))
    with open(os.devnull, "rb") as nothing:  # noqa: PTH123 - pathlib is not imported yet, and is slow to
        os.dup2(nothing.fileno(), 0)
    os.dup2(2, 1)
    return wire


class LogFormatter(logging.Formatter):
    """Formats log lines with hidden characters escaped: they may contain text of the robot, and be read in
    a terminal.
    """

    def formatMessage(self, record: logging.LogRecord) -> str:
        """Return the message, on one line."""
        return visible(super().formatMessage(record))

    def formatException(self, ei: Any) -> str:
        """Return the traceback, on several lines."""
        return visible(super().formatException(ei), keep=LAYOUT)


def serve(settings: Settings) -> int:
    """Serve until the client disconnects or a signal ends the process. Return the exit code."""
    if settings.is_stdio and sys.stdin and sys.stdin.isatty():
        _say(_TO_A_PERSON)
    entrance = entrance_of(settings) if settings.is_http else None
    check_tls(settings)
    keep_freed_memory()
    gc.disable()  # searching the imported objects, which are never garbage, takes a fifth of the start
    wire = claim_wire() if settings.is_stdio else None
    asyncio.run(_serve(launch(settings), settings, wire, entrance))
    return 0


def launch(settings: Settings) -> Bridge | None:
    """Launch the bridge of a single robot: the bridge starts during the imports. Bridges of several robots start on
    first use.
    """
    from ros2_mcp.compose.entries import entries_of
    from ros2_mcp.guard.policy_file import policy_for
    from ros2_mcp.guard.state import state_of
    from ros2_mcp.link.carriers import start_carrier
    from ros2_mcp.link.client import Bridge

    entries = entries_of(settings)
    if settings.bag or len(entries) > 1:
        return None
    settings = entries[0].settings
    policy = policy_for(settings)
    state = state_of(settings, policy).path
    bridge = Bridge(lambda: start_carrier(settings, state=state, under_policy=policy.in_force))
    bridge.launch()
    return bridge


def _say(text: str) -> None:
    print(text, end="", file=sys.stderr, flush=True)  # noqa: T201 - for a person, whatever the level of the log is


def show_log(settings: Settings) -> None:
    """Show the log on stderr, from the level in the settings."""
    # One line per message, without time and location: it is read in a client's log, which adds its own.
    shown = logging.StreamHandler()
    shown.setFormatter(LogFormatter("%(message)s"))
    logging.basicConfig(level=settings.log_level.upper(), handlers=[shown])


async def _operated_until(ending: asyncio.Event, member: Member) -> None:
    """Let operators of a robot reach the server until it ends."""
    from ros2_mcp.compose.robot import operated  # imported by now

    async with operated(member.robot, member.settings):
        await ending.wait()


async def _serve(bridge: Bridge | None, settings: Settings, wire: Wire | None, entrance: Entrance | None) -> None:
    """Serve in one task group. The bridge is ended, and the robot stopped, before the process ends,
    whatever ends it.
    """
    # Imported here, because the bridge has been launched and starts meanwhile.
    import anyio

    from ros2_mcp.compose.server import assemble
    from ros2_mcp.ops.memory.record import keep_black_box

    assembly = assemble(settings, bridge)
    show_log(settings)
    if wire:
        from ros2_mcp.mcp.transports.stdio import serve_stdio

        serving = serve_stdio(assembly.server, wire.read_fd, wire.write_fd)
    elif settings.socket:
        from ros2_mcp.mcp.transports.sockets import serve_socket

        path = settings.socket.expanduser()
        told = f"ros2-mcp serves MCP at the socket {path}\nWhat a client starts:  ros2-mcp connect {path}\n"
        serving = serve_socket(assembly.server, assembly.leases, path, lambda: _say(told))
    else:
        from ros2_mcp.mcp.transports.http.app import serve_http  # brings uvicorn, which stdio does not need

        assert entrance
        serving = serve_http(
            assembly.server,
            assembly.leases,
            assembly.scopes,
            settings=settings,
            entrance=entrance,
            announce=lambda url: _say(f"ros2-mcp serves MCP at {url}\n{entrance.told}\n"),
        )
    gc.freeze()
    gc.enable()

    ending, failures = asyncio.Event(), list[Exception]()

    async def serve_until_the_client_leaves() -> None:
        try:
            await serving
        except Exception as error:  # noqa: BLE001 - raised below: here it would cancel what stops the robot
            failures.append(error)
        finally:
            ending.set()

    when_told_to_end(ending.set)
    async with anyio.create_task_group() as tasks:
        async with assembly.running():
            if not (assembly.store.subject or assembly.fleet.has_several):  # several wait for their first use
                assembly.robot.log.start()
            for member in assembly.fleet.members.values() if not assembly.store.subject else ():
                tasks.start_soon(keep_black_box, member.robot, member.store, member.settings)
                tasks.start_soon(_operated_until, ending, member)
            tasks.start_soon(serve_until_the_client_leaves)
            await ending.wait()
        if not failures:
            # A thread that writes to a client which does not read cannot be interrupted; the task group would wait for
            # it.
            logging.shutdown()
            os._exit(0)
        tasks.cancel_scope.cancel()
    raise failures[0]
