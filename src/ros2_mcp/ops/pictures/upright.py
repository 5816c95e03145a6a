"""The frame in which a cloud is drawn from above: one whose z axis is up, unlike that of an optical frame."""

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
"""Pose of an optical frame (x right, y down, z ahead) in a frame at the same place with x ahead, y left, z up (REP
103)."""
_OPTICAL_FRAME = "_optical_frame"
_UP = math.cos(math.radians(5.0))
"""Least z component of the z axis of an upright frame: mounts are inaccurate, and robots on ramps lean, by up to 5°.
Seen from above, a wall of 2 m is then 17 cm thick."""
_LOOK_S = 0.05
"""Time to wait for frames that have been waited for already."""


@dataclass(frozen=True, slots=True)
class Upright:
    """The frame that is drawn, the pose of the cloud's own frame in it (None: it is the same), and a note."""

    frame: str
    pose: Pose | None = None
    note: str = ""


async def upright_of(source: Source, frame: str, at_ns: int) -> Upright:
    """Return the cloud's own frame if its z is up; else the robot's base or a world frame, if TF has a transform; else,
    for an optical frame, a frame turned as REP 103 says; else the cloud's own frame, with a note on its z axis. Raises
    no `RobotError`.
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
        note = (
            f"{named(frame)} is rotated as in REP 103, because it has no transform to the base: x ahead of the camera, "
            "y left, z up."
        )
        return Upright(frame, OPTICAL, note)
    of = f"of {named(frame)}" if frame else "of a cloud without a frame"
    note = f"Seen along the z axis {of}, which may not be up: the frame has no transform to the base."
    return Upright(frame, None, note)


def _shown(frame: str, upright: str, pose: Pose) -> Upright:
    if rotated(pose.rotation, (0.0, 0.0, 1.0))[2] >= _UP:
        return Upright(frame)
    return Upright(
        upright, pose, f"Shown in {named(upright)}, whose z axis points up; that of {named(frame)} does not."
    )
