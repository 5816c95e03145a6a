"""The newest image of a camera."""

from __future__ import annotations

import asyncio
import base64
from collections import deque
from collections.abc import Sequence
from typing import Any

from ros2_mcp.model.aside import load
from ros2_mcp.model.errors import NotFound, RobotError
from ros2_mcp.model.pictures import COMPRESSED_IMAGE, IMAGE, Bounds
from ros2_mcp.model.text import named
from ros2_mcp.model.times import iso_time
from ros2_mcp.ops.pictures.next_message import next_message
from ros2_mcp.ops.results.results import silent
from ros2_mcp.view.look import Content, Look, PageContext, Panel, Shown, when

_BOUNDS = Bounds(max_side=800, max_bytes=120_000)
"""A panel is some 600 pixels wide, and a chat host passes 130 kB on; a JPEG of 640 × 480 has 40 to 90 kB."""
_MOST_DEPTHS = 15
"""Depth images of the last second, kept for a box that the user picks in an image."""


class ImagePanel(Panel):
    """Shows the image of a camera or depth camera."""

    name = "image"
    shows_types = (IMAGE, COMPRESSED_IMAGE)
    shows_kind = "image"
    period_s = 0.066
    """15 images a second, which is enough for a panel of this size."""

    def __init__(self, page: PageContext) -> None:
        super().__init__(page)
        self._shown = Shown()
        self._depths: deque[tuple[str, str, Any]] = deque(maxlen=_MOST_DEPTHS)
        """Topic, time and message of the last depth images shown."""

    async def show(self, look: Look) -> Content | None:
        """Return the newest image of the chosen camera, or of the first camera."""
        topics = await look.source.publishing(IMAGE, COMPRESSED_IMAGE)
        topic = look.chosen or _preferred(topics)
        if not topic:
            raise NotFound("No camera topic." if look.source.is_live else "The recording has no pictures.")
        source = look.source
        if source.is_live:
            found = await self._shown.newer(look.robot, topic)
            if found is None:
                is_shown = self._shown.sample is not None
                return None if is_shown else {"topic": topic, "topics": topics, "why": _silent(look, topic, topics)}
            sample, newest, listening = found
            message: Any = await asyncio.to_thread(look.robot.values.codec.decode, listening.type, sample.data)
            kind, rate_hz, is_old = listening.type, newest.rate_hz(), listening.is_from_before(sample)
        else:
            kind, rate_hz, is_old = await source.type_of(topic), None, False
            recorded = await next_message(source, topic, kind, silent)
            message, sample = recorded.message, recorded.sample
        picture = await _picture(kind, message)
        at = when(sample, is_old)
        self._keep(topic, at["at_s"], message)
        whole = picture.whole if any(picture.whole) else (picture.width, picture.height)
        return {
            "topic": topic,
            "topics": topics,
            "type": kind,
            **at,
            "rate_hz": rate_hz,
            "mime": picture.mime,
            "width": picture.width,
            "height": picture.height,
            "whole": [message.width, message.height] if kind == IMAGE else list(whole),
            "frame": str(message.header.frame_id),
            "note": picture.note,
            "bulk": base64.b64encode(picture.data).decode("ascii"),
        }

    def _keep(self, topic: str, at_s: float, message: Any) -> None:
        from ros2_mcp.pictures.images import may_be_depth

        if may_be_depth(message):
            told_ns = round(at_s * 1e9)  # as the page sends it back: its times are floats, some 100 ns off
            self._depths.append((topic, iso_time(told_ns), message))

    async def depth_within(self, topic: str, at: str, box: Sequence[int]) -> tuple[float | None, str]:
        """Return the depth in a box of an image that was shown at that time; None, and a reason if known.

        If that image is no longer kept, because the page is slow, the next one is used, and the text says so.
        """
        later = [(time, message) for name, time, message in self._depths if name == topic and time >= at]
        if not later:
            return None, ""
        time, message = later[0]
        from ros2_mcp.world.depths import depth_within

        try:
            depth_m, told = await asyncio.to_thread(depth_within, message, box)
        except RobotError as error:
            return None, str(error)
        return depth_m, told if time == at or depth_m is None else f"{told} in the picture of {time}"


async def _picture(kind: str, message: Any) -> Any:
    await load("ros2_mcp.pictures.messages")
    from ros2_mcp.pictures.messages import picture_of

    return await asyncio.to_thread(picture_of, kind, message, "", _BOUNDS)


def _preferred(topics: list[str]) -> str:
    """Return the first colour camera; compressed and depth images only if there is no other."""
    plain = [name for name in topics if not name.endswith(("/compressed", "/compressedDepth")) and "depth" not in name]
    return next(iter([*plain, *topics]), "")


def _silent(look: Look, topic: str, topics: list[str]) -> str:
    if topic not in topics:
        return f"{named(topic)} has no publisher now."
    failure = look.robot.graph.failure
    return failure or f"{named(topic)} has a publisher, but no picture has come yet."
