"""The embedded black box: chosen topics are always kept, in a ring of files, with no database and no other node."""

from __future__ import annotations

import asyncio
import logging
from typing import TYPE_CHECKING

from ros2_mcp.model import names
from ros2_mcp.model.errors import RobotError
from ros2_mcp.ops.memory import BLACK_BOX, Memory
from ros2_mcp.ops.recording import Recording, Wanted
from ros2_mcp.robot import Robot

if TYPE_CHECKING:
    from pathlib import Path

    from ros2_mcp.bags.recorder import Recorder
    from ros2_mcp.settings import Settings

LARGEST_BYTES = 32_000
"""Larger messages (pictures, clouds) would push all others out of the ring: their topics are kept only by name."""
_logger = logging.getLogger(__name__)


async def keep_black_box(robot: Robot, memory: Memory, settings: Settings) -> None:
    """Begins to keep the topics of the settings, if they name some; what goes wrong is logged."""
    if settings.black_box is None or settings.read_only:
        return
    try:
        topics = [names.absolute(topic) for topic in settings.black_box]
        wanted = Wanted(topics, largest=0 if topics else LARGEST_BYTES)
        folder = memory.record_dir / BLACK_BOX
        recorder = await asyncio.to_thread(_open, folder, settings)
        recording = memory.running[BLACK_BOX] = Recording(robot, BLACK_BOX, folder, recorder, wanted)
        await recording.begin()
    except (RobotError, OSError) as error:
        _logger.warning("the black box keeps nothing: %s", error)


def _open(folder: Path, settings: Settings) -> Recorder:
    from ros2_mcp.bags.recorder import Recorder
    from ros2_mcp.bags.ring import RingWriter

    return Recorder(RingWriter(folder, settings.black_box_bytes, settings.black_box_hours * 3600.0), folder)
