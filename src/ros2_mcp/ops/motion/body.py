"""How far a robot reaches around its base: what a guarded drive keeps out of the way of things."""

from __future__ import annotations

from collections.abc import Mapping

from ros2_mcp.model.errors import NotFound, RobotError
from ros2_mcp.model.text import named
from ros2_mcp.ops.space.description import described
from ros2_mcp.robot import Robot
from ros2_mcp.world.footprint import outline, reach

ASSUMED_M = 0.25
"""The radius of a robot that does not tell its size: most small ones are smaller."""
_TYPE = "std_msgs/msg/String"


async def body_of(robot: Robot, base_frame: str, beside: str = "") -> tuple[Mapping[str, float], str]:
    """`front`, `rear`, `side`, `radius` in m from the base's origin, and a sentence on how that is known.

    By the robot's description, of several that which is beside the topic `beside`. Never raises a `RobotError`.
    """
    try:
        return await _described(robot, base_frame.lstrip("/"), beside)
    except RobotError as error:
        why = str(error).rstrip(".")
    assumed: Mapping[str, float] = dict.fromkeys(("front", "rear", "side", "radius"), ASSUMED_M)
    return assumed, f"The robot's size is not known ({why}): {ASSUMED_M:g} m around its base is assumed."


async def _described(robot: Robot, base_frame: str, beside: str) -> tuple[Mapping[str, float], str]:
    rows = [row for row in await robot.graph.topics() if row.publishers and _TYPE in row.types]
    topics = [row.name for row in rows if row.name.endswith("/robot_description")]
    near = [topic for topic in topics if topic.rpartition("/")[0] == beside.rpartition("/")[0]] or topics
    if len(near) > 1:
        raise NotFound("several descriptions are published")
    told_by = named(near[0]) if near else "the parameter robot_description"
    size = reach(outline(await described(robot, near[0] if near else ""), base_frame))
    if size is None:
        raise NotFound(f"{told_by} has no shapes for {named(base_frame)}")
    side_m = max(size.left_m, size.right_m)
    body = {"front": size.front_m, "rear": size.rear_m, "side": side_m, "radius": size.radius_m}
    shape = f"{size.front_m:.2f} m ahead, {size.rear_m:.2f} m back, {side_m:.2f} m to the sides"
    return body, f"The robot's size comes from {told_by}: {shape}."
