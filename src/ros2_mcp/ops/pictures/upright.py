"""In which frame a cloud is seen from above: one whose z is up, as that of an optical frame is not."""

from __future__ import annotations

import math
from contextlib import suppress
from dataclasses import dataclass

from ros2_mcp.model.errors import RobotError
from ros2_mcp.model.poses import Pose, rotated
from ros2_mcp.model.text import named
from ros2_mcp.ops.sources.source import Source
from ros2_mcp.ops.space.frames import WORLDS, frames_of
from ros2_mcp.ops.space.mount import mount_of

OPTICAL = Pose(rotation=(-0.5, 0.5, -0.5, 0.5))
"""Of an optical frame (x to the right, y down, z ahead) in one at its place with x ahead, y left and z up: REP 103."""
_OPTICAL_FRAME = "_optical_frame"
_UP = math.cos(math.radians(5.0))
"""A frame whose z leans by less is upright: so much a mount is off, or a robot on a ramp leans. From above a wall of
2 m is then 17 cm thick."""
_LOOK_S = 0.05
"""For frames that have been waited for already."""


@dataclass(frozen=True, slots=True)
class Upright:
    """The frame that is shown, the `pose` in it of the cloud's own frame (None: it is that), and what is to be said."""

    frame: str
    pose: Pose | None = None
    note: str = ""


async def upright_of(source: Source, frame: str, at_ns: int) -> Upright:
    """The cloud's own frame where its z is up; else the robot's base or a world, by the transforms; else, of an optical
    frame, what REP 103 says; else the cloud's own frame, with a note on whose z is up. Raises no `RobotError`.
    """
    bare = frame.lstrip("/")
    if bare in WORLDS:
        return Upright(frame)
    mount = await mount_of(source, bare, at_ns)
    if mount.pose is not None:
        return _shown(frame, mount.base, mount.pose)
    with suppress(RobotError):
        tree = await frames_of(source, until=lambda _: True, patience_s=_LOOK_S)
        for world in WORLDS:
            if (located := tree.newest(world, bare)) is not None:
                return _shown(frame, world, located.pose)
    if bare.endswith(_OPTICAL_FRAME):
        note = f"{named(frame)} is turned by REP 103, as nobody tells where it is: x ahead of the camera, y left, z up."
        return Upright(frame, OPTICAL, note)
    of = f"of {named(frame)}" if frame else "of a cloud without a frame"
    return Upright(frame, None, f"Seen along the z axis {of}, which may not be up: nobody tells where that frame is.")


def _shown(frame: str, upright: str, pose: Pose) -> Upright:
    if rotated(pose.rotation, (0.0, 0.0, 1.0))[2] >= _UP:
        return Upright(frame)
    return Upright(upright, pose, f"Shown in {named(upright)}, whose z is up: that of {named(frame)} is not.")
