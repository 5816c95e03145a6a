"""Where the robot is in the frame of a picture: out of the transforms, else out of what a localisation says."""

from __future__ import annotations

import asyncio
from contextlib import suppress
from typing import Any

from ros2_mcp.model.errors import RobotError
from ros2_mcp.model.pictures import Place
from ros2_mcp.ops.sources.source import Source

_LISTEN_S = 0.6
"""Matching takes up to 0.2 s; what moves is sent at 5 Hz at least, what is static comes at once."""
_MOST = 200
"""Messages of a recording that are looked at: of the largest robots, the transforms of a second."""
_POSES = ("/amcl_pose", "/pose")
"""Where localisation says the robot's pose, as Nav2's and slam_toolbox do, with this type."""
_TF = "tf2_msgs/msg/TFMessage"
_POSE = "geometry_msgs/msg/PoseWithCovarianceStamped"


async def robot_place(source: Source, frame: str) -> Place | None:
    """Where the robot is in that frame; None where nobody says."""
    from ros2_mcp.codec.transforms import Frames, place_of  # with numpy: not before it is needed

    static, moving = await asyncio.gather(*(_messages(source, topic, _TF) for topic in ("/tf_static", "/tf")))
    if place := Frames([*static, *moving]).robot_in(frame):
        return place
    for topic in _POSES:
        said = [message for message in await _messages(source, topic, _POSE) if message.header.frame_id == frame]
        if said:
            return place_of(said[-1].pose.pose)
    return None


async def _messages(source: Source, topic: str, type_name: str) -> list[Any]:
    """The messages of a topic, decoded; none if it is not there, or not of that type."""
    found: list[Any] = []
    with suppress(RobotError):
        if await source.type_of(topic) == type_name:
            async with source.lasting(_LISTEN_S).follow(topic, limit=_MOST) as stream:
                async for batch in stream.batches:
                    found += [stream.codec.decode(stream.type, sample.data) for sample in batch]
    return found
