"""`ros2-mcp view`: the page that shows what the agent sees, in a browser on this machine."""

from __future__ import annotations

import asyncio
import secrets
import socket
import sys
from collections.abc import Generator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from ros2_mcp.commands.endings import when_told_to_end
from ros2_mcp.commands.serve import launch, show_log
from ros2_mcp.guard.state import StateFolder
from ros2_mcp.model.text import visible
from ros2_mcp.settings import Settings

if TYPE_CHECKING:
    import uvicorn

    from ros2_mcp.view.local import LocalPage

_TOKEN_BYTES = 32
_FRAMES_IDLE_S = 4.0
"""Transforms are dropped after so long without a request: an open page requests them five times a second, and a closed
one must cost nothing ten seconds later.
"""
_LAST_S = 16
"""The longest wait for running requests at the end, in s: a stop waits 15 s for the last server."""


def view(settings: Settings, state: Path, port: int = 0) -> int:
    """Show the page until a signal ends the process. Return the exit code.

    Args:
        settings: the settings of one robot, or with `bag` of a recording.
        state: the state folder of the robot that the button stops.
        port: the port on 127.0.0.1; 0 chooses a free one.
    """
    settings = replace(settings, read_only=True)
    show_log(settings)
    asyncio.run(_view(settings, StateFolder(state), port))
    return 0


async def _view(settings: Settings, state: StateFolder, port: int) -> None:
    bridge = launch(settings)
    # Imported here, because the bridge has been launched and starts meanwhile.
    import anyio

    from ros2_mcp.compose.robot import robot_for, running, store_for
    from ros2_mcp.compose.server import SOURCE_KINDS
    from ros2_mcp.ops.sources.kinds import Sources
    from ros2_mcp.view.acting import Acting
    from ros2_mcp.view.local import LocalPage
    from ros2_mcp.view.mesh_files import prefixes_of
    from ros2_mcp.view.views import Views

    ending = asyncio.Event()
    when_told_to_end(ending.set)
    store = store_for(settings)
    robot = robot_for(settings, store, bridge)
    robot.transforms.idle_s = _FRAMES_IDLE_S
    listener = socket.create_server(("127.0.0.1", port))
    token = secrets.token_urlsafe(_TOKEN_BYTES)
    async with running(robot, store), anyio.create_task_group() as tasks:
        source = await Sources(robot, store, SOURCE_KINDS).open()
        title = settings.bag.name if settings.bag else state.path.name
        views = Views(robot, source, title, Acting(state), tasks, in_browser=True, prefixes=prefixes_of(settings))
        taken = listener.getsockname()[1]
        server = _server(LocalPage(views, token, taken))

        async def serve() -> None:
            await server.serve([listener])
            tasks.cancel_scope.cancel()

        tasks.start_soon(serve)
        _say(f"The page of {visible(title)}, for this machine alone (Ctrl+C ends it):\n  {_address(taken, token)}\n")
        await ending.wait()
        views.close()  # a page waits for updates for a second or more
        server.should_exit = True  # a running stop is finished


def _address(port: int, token: str) -> str:
    """Return the page's URL. Browsers do not send the part after #."""
    return f"http://127.0.0.1:{port}/#{token}"


def _server(app: LocalPage) -> uvicorn.Server:
    import uvicorn

    class Server(uvicorn.Server):
        """A server that leaves signals to this command: the command ends the server."""

        @contextmanager
        def capture_signals(self) -> Generator[None, None, None]:
            """Capture no signals."""
            yield

    config = uvicorn.Config(
        app,
        ws="none",
        lifespan="off",
        log_level="warning",
        access_log=False,
        server_header=False,
        proxy_headers=False,
        timeout_graceful_shutdown=_LAST_S,
    )
    return Server(config)


def _say(text: str) -> None:
    print(text, end="", file=sys.stdout, flush=True)  # noqa: T201 - the address, for a person
