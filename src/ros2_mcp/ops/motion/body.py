"""The extent of a robot around its base, which a guarded drive keeps clear of obstacles."""

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
"""The radius assumed for a robot without a usable description: most small robots are smaller."""
_ASSUMED_TOP_M = 1.0
"""The height assumed for such a robot: anything lower that overhangs its path counts as an obstacle."""
_GROUND_M = 0.05
"""Points of a cloud count as obstacles from this height above the robot's lowest point. Below lies the ground, with the
noise of depth cameras (1 % of the distance) and the thresholds that wheels roll over."""
_HEADROOM_M = 0.05
"""Anything up to this height above the robot's highest point still counts as an obstacle."""
_CORNERS = 24
"""Corners of the polygon for the assumed circle: 1 % too small at most."""
_TYPE = "std_msgs/msg/String"


@dataclass(frozen=True, slots=True)
class Body:
    """The extent of a robot from the origin of its base, in m: `sides` as `front`, `rear`, `side` and `radius`; the
    corners of its `outline`, counter-clockwise; and the range of `heights` in which something is an obstacle.
    `known_by` is a sentence with the source.
    """

    sides: Mapping[str, float]
    outline: Sequence[Point]
    heights: tuple[float, float]
    known_by: str


async def body_of(robot: Robot, base_frame: str, beside: str = "") -> Body:
    """Return the body around the frame `base_frame`, by the robot's description; if there are several, by the
    description in the namespace of the topic `beside`. Without a usable description, return a circle of `ASSUMED_M`.
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
