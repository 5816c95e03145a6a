"""Where a sensor sits on the robot: the pose of its frame in the frame of the base."""

from __future__ import annotations

from dataclasses import dataclass
from time import monotonic
from weakref import WeakKeyDictionary

from ros2_mcp.model.errors import RobotError
from ros2_mcp.model.poses import Pose
from ros2_mcp.ops.sources.source import Source
from ros2_mcp.ops.space.frames import frames_of
from ros2_mcp.robot.transforms import TransformListener
from ros2_mcp.world.transforms import FrameTree

_PATIENCE_S = 0.6
"""For frames that nobody has asked for yet: what is static comes within 0.2 s of matching. A reading of a sensor should
not wait longer for where it sits; the next one has it."""
_KNOWN_S = 60.0
"""Mounts change with the robot's description alone, and pan-tilt heads do not turn the robot's scanner."""
_UNKNOWN_S = 5.0
"""So long a frame that was not found is not waited for again: a robot without transforms is read as fast as before."""
_PARTS_NS = ((0, 1), (2_000_000_000, 200_000_000))
"""Of a recording, before and after the message: first nothing but what is static and was told earlier, as the seconds
around it may be hundreds of megabytes of pictures."""


@dataclass(frozen=True, slots=True)
class Mount:
    """The frame of the robot's base, and the pose of a sensor's frame in it; None where that is not known."""

    base: str = ""
    pose: Pose | None = None
    is_static: bool = False


_known: WeakKeyDictionary[TransformListener, dict[str, tuple[float, Mount]]] = WeakKeyDictionary()
"""Of each robot: when it was found (monotonic, in s), and what, by the frame of the sensor."""


async def mount_of(source: Source, frame: str, at_ns: int) -> Mount:
    """Where a sensor's frame is in the robot's base; one that moves on the robot as it was last told.

    Args:
        source: the robot, or a recording.
        frame: that of the sensor.
        at_ns: of a recording, the time of receipt of the message that is read.
    """
    frame = frame.lstrip("/")
    try:
        if source.transforms:
            return await _live_mount(source, source.transforms, frame)
        for before_ns, after_ns in _PARTS_NS if source.covers_ns else ():  # a database would be asked for all it has
            tree = await frames_of(source.part(at_ns - before_ns, at_ns + after_ns))
            mount = _found(tree, frame)
            if mount.pose:
                return mount
    except RobotError:  # no transforms on this robot, or no types of them: the sensor's own frame is told instead
        pass
    return Mount()


async def _live_mount(source: Source, listener: TransformListener, frame: str) -> Mount:
    known = _known.setdefault(listener, {})
    if frame in known:
        found_at, mount = known[frame]
        if monotonic() - found_at < (_KNOWN_S if mount.is_static else 0.0 if mount.pose else _UNKNOWN_S):
            return mount
    known[frame] = monotonic(), Mount()
    tree = await frames_of(source, until=lambda tree: _found(tree, frame).pose is not None, patience_s=_PATIENCE_S)
    known[frame] = monotonic(), _found(tree, frame)
    return known[frame][1]


def _found(tree: FrameTree, frame: str) -> Mount:
    located = tree.newest(tree.base, frame) if tree.base and frame in tree.frames else None
    if located is None:
        return Mount(tree.base)
    return Mount(tree.base, located.pose, is_static=located.stamp_ns is None)
