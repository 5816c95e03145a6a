"""What the robot's description says of a frame that no transform names."""

from __future__ import annotations

import asyncio

from ros2_mcp.model.aside import load
from ros2_mcp.model.errors import RobotError
from ros2_mcp.model.text import named
from ros2_mcp.ops.pictures.next_message import next_message
from ros2_mcp.ops.results.results import silent
from ros2_mcp.ops.sources.source import Source
from ros2_mcp.world.urdf import Urdf, parse

_TOPIC, _TYPE = "/robot_description", "std_msgs/msg/String"
_LISTEN_S = 1.0
"""It is latched, and comes with the matching."""


async def described_frame(source: Source, frame: str) -> str:
    """In a sentence; empty where there is no description, or it has no such link."""
    await load("ros2_mcp.values.cdr")  # with numpy: not before it is needed
    try:
        await source.type_of(_TOPIC)
        found = await next_message(source.lasting(_LISTEN_S), _TOPIC, _TYPE, silent)
        urdf = await asyncio.to_thread(parse, found.message.data)
    except RobotError:
        return ""
    return link_in_words(urdf, frame)


def link_in_words(urdf: Urdf, frame: str) -> str:
    """What a description says of a link, and so why no transform names it."""
    if frame in urdf.joints and frame not in urdf.links:
        return f"{named(frame)} is a joint of the description; its link is {named(urdf.joints[frame].child)}."
    if frame not in urdf.links:
        return ""
    joint = urdf.above(frame)
    if joint is None:
        return f"The description has the link {named(frame)}, but no state publisher publishes its transforms."
    where = f"The description has {named(frame)} on {named(joint.parent)}, by the joint {named(joint.name)}"
    if joint.kind == "fixed":
        return f"{where}, which is fixed: no state publisher publishes it on /tf_static."
    return f"{where}, which moves: a state publisher publishes it once /joint_states has the joint's position."
