"""Opening what has to be ended, in calls that can be cancelled."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from typing import TypeVar

from ros2_mcp.ops.memory import Ending

_Opened = TypeVar("_Opened", bound=Ending)


async def opened(open_it: Callable[[], _Opened]) -> _Opened:
    """What a thread opens; it is ended as soon as it is open where the caller was cancelled meanwhile."""
    opening = asyncio.ensure_future(asyncio.to_thread(open_it))
    try:
        return await asyncio.shield(opening)
    except asyncio.CancelledError:
        await asyncio.shield(_end(opening))
        raise


async def _end(opening: asyncio.Future[_Opened]) -> None:
    await asyncio.wait({opening})
    if not opening.cancelled() and not opening.exception():
        await opening.result().end()
