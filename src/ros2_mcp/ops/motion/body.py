"""How far a robot reaches around its base: what a guarded drive keeps out of the way of things."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from ros2_mcp.model.errors import NotFound, RobotError
from ros2_mcp.model.text import named
from ros2_mcp.ops.space.description import described
from ros2_mcp.robot import Robot
from ros2_mcp.world.footprint import Point, heights, outline, reach

ASSUMED_M = 0.25
"""The radius of a robot that does not tell its size: most small ones are smaller."""
_ASSUMED_TOP_M = 1.0
"""The height of such a robot: what hangs lower over its way counts as an obstacle."""
_GROUND_M = 0.05
"""So much above the lowest point of the robot points of a cloud are an obstacle: below lies the ground, with the noise
of depth cameras (1 % of the distance) and the thresholds that wheels roll over."""
_HEADROOM_M = 0.05
"""What is so much above the robot's highest point is still in its way."""
_CORNERS = 24
"""Of the circle around a robot that does not tell its size: 1 % too small at most."""
_TYPE = "std_msgs/msg/String"


@dataclass(frozen=True, slots=True)
class Body:
    """How far a robot reaches from its base's origin, in m: `sides` as `front`, `rear`, `side` and `radius`; the
    corners of its `outline`, counter-clockwise; and between which `heights` something is in its way. `known_by` is a
    sentence on how that is known.
    """

    sides: Mapping[str, float]
    outline: Sequence[Point]
    heights: tuple[float, float]
    known_by: str


async def body_of(robot: Robot, base_frame: str, beside: str = "") -> Body:
    """That of the frame `base_frame`, by the robot's description, of several that which is beside the topic `beside`.
    Never raises a `RobotError`.
    """
    try:
        return await _described(robot, base_frame.lstrip("/"), beside)
    except RobotError as error:
        why = str(error).rstrip(".")
    turns = [2 * math.pi * number / _CORNERS for number in range(_CORNERS)]
    return Body(
        dict.fromkeys(("front", "rear", "side", "radius"), ASSUMED_M),
        [(ASSUMED_M * math.cos(turn), ASSUMED_M * math.sin(turn)) for turn in turns],
        (_GROUND_M, _ASSUMED_TOP_M),
        f"The robot's size is not known ({why}): {ASSUMED_M:g} m around its base is assumed.",
    )


async def _described(robot: Robot, base_frame: str, beside: str) -> Body:
    rows = [row for row in await robot.graph.topics() if row.publishers and _TYPE in row.types]
    topics = [row.name for row in rows if row.name.endswith("/robot_description")]
    near = [topic for topic in topics if topic.rpartition("/")[0] == beside.rpartition("/")[0]] or topics
    if len(near) > 1:
        raise NotFound("several descriptions are published")
    told_by = named(near[0]) if near else "the parameter robot_description"
    urdf = await described(robot, near[0] if near else "")
    around = outline(urdf, base_frame)
    size, tall = reach(around), heights(urdf, base_frame)
    if size is None or tall is None:
        raise NotFound(f"{told_by} has no shapes for {named(base_frame)}")
    side_m = max(size.left_m, size.right_m)
    sides = {"front": size.front_m, "rear": size.rear_m, "side": side_m, "radius": size.radius_m}
    shape = f"{size.front_m:.2f} m ahead, {size.rear_m:.2f} m back, {side_m:.2f} m to the sides"
    between = tall[0] + _GROUND_M, tall[1] + _HEADROOM_M
    return Body(sides, around, between, f"The robot's size comes from {told_by}: {shape}.")
