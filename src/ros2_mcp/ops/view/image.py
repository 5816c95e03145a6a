"""The newest picture of a camera."""

from __future__ import annotations

import asyncio
import base64
from typing import Any

from ros2_mcp.model.aside import load
from ros2_mcp.model.errors import NotFound
from ros2_mcp.model.pictures import COMPRESSED_IMAGE, IMAGE, Bounds
from ros2_mcp.model.text import named
from ros2_mcp.ops.pictures.next_message import next_message
from ros2_mcp.ops.results import silent
from ros2_mcp.ops.view.look import Content, Look, Panel, Shown

_BOUNDS = Bounds(max_side=800, max_bytes=120_000)
"""A panel is some 600 pixels wide, and a chat host passes 130 kB on; JPEG of 640 × 480 has 40 to 90 kB."""


class ImagePanel(Panel):
    """What a camera, or a depth camera, sees."""

    name = "image"
    period_s = 0.066
    """15 pictures a second: more no panel of this size needs."""

    def __init__(self) -> None:
        self._shown = Shown()

    async def show(self, look: Look) -> Content | None:
        """The newest picture of the chosen camera, else of the first one."""
        topics = await look.source.publishing(IMAGE, COMPRESSED_IMAGE)
        topic = look.chosen or _preferred(topics)
        if not topic:
            raise NotFound("Nobody publishes pictures." if look.source.is_live else "The recording has no pictures.")
        source = look.source
        if source.is_live:
            found = await self._shown.newer(look.robot, topic)
            if found is None:
                is_shown = self._shown.sample is not None
                return None if is_shown else {"topic": topic, "topics": topics, "why": _silent(look, topic, topics)}
            sample, newest, listening = found
            message: Any = await asyncio.to_thread(look.robot.values.codec.decode, listening.type, sample.data)
            kind, rate_hz = listening.type, newest.rate_hz()
        else:
            kind, rate_hz = await source.type_of(topic), None
            recorded = await next_message(source, topic, kind, silent)
            message, sample = recorded.message, recorded.sample
        picture = await _picture(kind, message)
        return {
            "topic": topic,
            "topics": topics,
            "type": kind,
            "at_s": sample.received_ns / 1e9,
            "rate_hz": rate_hz,
            "mime": picture.mime,
            "width": picture.width,
            "height": picture.height,
            "note": picture.note,
            "bulk": base64.b64encode(picture.data).decode("ascii"),
        }


async def _picture(kind: str, message: Any) -> Any:
    await load("ros2_mcp.codec.pictures")
    from ros2_mcp.codec.pictures import picture_of

    return await asyncio.to_thread(picture_of, kind, message, "", _BOUNDS)


def _preferred(topics: list[str]) -> str:
    """A camera in colour first: what is compressed or measures depth is chosen by who wants it."""
    plain = [name for name in topics if not name.endswith(("/compressed", "/compressedDepth")) and "depth" not in name]
    return next(iter([*plain, *topics]), "")


def _silent(look: Look, topic: str, topics: list[str]) -> str:
    if topic not in topics:
        return f"Nobody publishes on {named(topic)} now."
    failure = look.robot.graph.failure
    return failure or f"{named(topic)} has a publisher, but no picture has come yet."
