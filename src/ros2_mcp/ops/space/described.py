"""Explain from the robot's description (URDF) why a frame has no transform."""

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
"""Time to wait for the description: it is latched, and arrives as soon as the subscription matches."""


async def described_frame(source: Source, frame: str) -> str:
    """Explain in a sentence why `frame` has no transform; empty if no description is found, or it has no such link."""
    await load("ros2_mcp.values.cdr")  # with numpy: not before it is needed
    try:
        await source.type_of(_TOPIC)
        found = await next_message(source.lasting(_LISTEN_S), _TOPIC, _TYPE, silent)
        urdf = await asyncio.to_thread(parse, found.message.data)
    except RobotError:
        return ""
    return link_in_words(urdf, frame)


def link_in_words(urdf: Urdf, frame: str) -> str:
    """Describe the link `frame` of a description: its parent and joint, and which transforms are not published."""
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
