"""The pages of one robot in chats, live and of recordings. The pages communicate through tools of their own."""

from __future__ import annotations

import asyncio
import logging
from collections.abc import Callable, Coroutine, Mapping, Sequence
from pathlib import Path
from typing import Any

from ros2_mcp.model.errors import BadInput
from ros2_mcp.ops.sources.kinds import Sources
from ros2_mcp.view.acting import Acting
from ros2_mcp.view.picks import PickedInBrowser, kept
from ros2_mcp.view.views import PageState, Views, press, update_request

_MOST_RECORDINGS = 4
"""Recordings shown in chats at the same time."""
_logger = logging.getLogger(__name__)


class Tasks:
    """Background work that runs until it ends or the server does."""

    def __init__(self) -> None:
        self._running: set[asyncio.Task[None]] = set()

    def start_soon(self, work: Callable[..., Coroutine[Any, Any, None]], *arguments: object) -> None:
        """Start a task; an exception in it is logged, and ends nothing else."""

        async def run() -> None:
            try:
                await work(*arguments)
            except Exception:  # a failing view must not end the server or other views
                _logger.exception("a page's view failed")

        task = asyncio.ensure_future(run())
        self._running.add(task)
        task.add_done_callback(self._running.discard)

    async def close(self) -> None:
        """Cancel all tasks."""
        running = [*self._running]
        for task in running:
            task.cancel()
        await asyncio.gather(*running, return_exceptions=True)


class Viewing:
    """The pages of one robot, by the recording that they show.

    The empty name is the robot itself, or the recording that stands for it. Sources are opened only when a page asks.
    """

    def __init__(self, sources: Sources, title: str, acting: Acting, prefixes: Sequence[Path] = ()) -> None:
        self._sources, self._title, self._acting = sources, title, acting
        self._prefixes = prefixes
        self._views: dict[str, Views] = {}
        self._tasks = Tasks()

    async def update(self, asked: Mapping[str, Any], bag: str, who: str) -> Mapping[str, Any]:
        """Return what is new for a page opened by `who`.

        Raises `RobotError`, also for a recording that does not exist.
        """
        request = update_request(asked)
        return await (await self._of(bag)).update(request, who)

    async def answer(self, asked: Mapping[str, Any], bag: str) -> Mapping[str, Any]:
        """Return a large part that was offered to a page, or note what was picked there. Raises `RobotError`."""
        return await (await self._of(bag)).answer(asked)

    async def stop(self) -> Mapping[str, Any]:
        """Press the stop button."""
        return await press(self._acting, self._sources.robot)

    def states(self, who: str) -> Sequence[PageState]:
        """Return what the pages of this client show, the newest first."""
        found = [state for views in self._views.values() for state in views.states() if state.who == who]
        return sorted(found, key=lambda state: -state.asked_at)

    def picked_in_browser(self) -> PickedInBrowser | None:
        """Return what was picked on a page of `ros2-mcp view` on this machine."""
        return kept(self._acting.at)

    async def close(self) -> None:
        """Close all pages."""
        for views in self._views.values():
            views.close()
        await self._tasks.close()

    async def _of(self, bag: str) -> Views:
        if bag not in self._views:
            self._make_room()
            source = await self._sources.open(bag)
            title = bag or self._title or self._acting.at.path.name
            # Two pages may have asked at the same time: both use the first one's views.
            views = Views(self._sources.robot, source, title, self._acting, self._tasks, prefixes=self._prefixes)
            self._views.setdefault(bag, views)
        return self._views[bag]

    def _make_room(self) -> None:
        recordings = [bag for bag in self._views if bag]
        if len(recordings) < _MOST_RECORDINGS:
            return
        unused = next((bag for bag in recordings if not self._views[bag].is_open), None)
        if unused is None:
            raise BadInput(f"{_MOST_RECORDINGS} recordings are shown already.", "Close one of their pages.")
        del self._views[unused]
