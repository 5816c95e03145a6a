"""The robot's pose by its transforms, and how old it is."""

from __future__ import annotations

from dataclasses import dataclass

from ros2_mcp.model.aside import load
from ros2_mcp.model.errors import RobotError
from ros2_mcp.model.text import named
from ros2_mcp.ops.sources.live import Live
from ros2_mcp.robot import Robot

STALE_S = 1.0
"""Nav2 accepts transforms that are some tenths of a second old; localisation publishes them ten times a second."""
_OTHER_CLOCK_S = 1e6
"""A stamp more than eleven days off belongs to another clock: simulated time begins at zero."""


@dataclass(frozen=True, slots=True)
class Whereabouts:
    """The robot's pose in `frame`: m, radians, and its age in s; None if unknown.

    `base` is the frame of the robot's body. `trouble` describes the problem: no transform, or an old one.
    """

    frame: str
    base: str = ""
    x_m: float | None = None
    y_m: float | None = None
    yaw_rad: float | None = None
    age_s: float | None = None
    trouble: str = ""

    @property
    def is_known(self) -> bool:
        """Whether there is a pose, however old."""
        return self.x_m is not None


async def whereabouts(robot: Robot, frame: str) -> Whereabouts:
    """Return the robot's pose in a frame. Raises no `RobotError`: problems are described in `trouble`."""
    await load("ros2_mcp.values.cdr")  # with numpy: not before it is needed
    from ros2_mcp.ops.space.frames import frames_of
    from ros2_mcp.world.no_transform import why_none

    try:
        tree = await frames_of(
            Live(robot), until=lambda tree: bool(tree.base) and tree.find(frame, tree.base) is not None
        )
        base = tree.base or "base_link"
        found = tree.find(frame, base)
        if found is None:
            return Whereabouts(frame, base, trouble=str(why_none(tree, frame, base, None)))
    except RobotError as error:
        return Whereabouts(frame, trouble=str(error))
    x_m, y_m, _ = found.pose.translation
    moving = [edge for edge in found.edges if edge.moving]
    # By receipt: AMCL stamps its transform a second ahead on purpose, and stamps of another clock cannot be compared.
    late_s = [edge.lag_ns / 1e9 for edge in moving]
    ages = [
        (robot.now_ns() - edge.last_received_ns) / 1e9 + (lag_s if 0 < lag_s < _OTHER_CLOCK_S else 0.0)
        for edge, lag_s in zip(moving, late_s, strict=True)
    ]
    age_s = max(ages, default=None)
    trouble = ""
    if age_s is not None and age_s > STALE_S:
        oldest = moving[ages.index(age_s)]
        trouble = (
            f"the transform from {named(frame)} to {named(base)} is {age_s:.1f} s old: that of "
            f"{named(oldest.child)} is not sent any more"
        )
    return Whereabouts(frame, base, x_m, y_m, found.pose.yaw_rad, age_s, trouble)


async def in_frame(robot: Robot, frame: str, x_m: float, y_m: float, within: str) -> tuple[float, float] | None:
    """Transform a point (m) from `frame` to `within`, as of now; None if there is no transform."""
    if frame == within:
        return x_m, y_m
    from ros2_mcp.ops.space.frames import pose_in

    try:
        found = await pose_in(Live(robot), within, frame)
    except RobotError:
        return None
    x, y, _ = found.pose.applied((x_m, y_m, 0.0))
    return x, y


async def why_not_in_frame(robot: Robot, frame: str, within: str) -> str:
    """Say why there is no transform between two frames; "" if there is a transform."""
    from ros2_mcp.ops.space.frames import pose_in

    try:
        await pose_in(Live(robot), within, frame)
    except RobotError as error:
        return error.message
    return ""
