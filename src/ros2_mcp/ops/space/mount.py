"""The mount of a sensor: the pose of its frame in the frame of the robot's base."""

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
"""Time to wait for frames not used before: static transforms arrive within 0.2 s of matching. A sensor reading should
not be delayed longer for its mount; the next one has it."""
_KNOWN_S = 60.0
"""Time for which a static mount is cached, in s: it changes only if the robot's description does."""
_UNKNOWN_S = 5.0
"""Time for which a frame that was not found is not waited for again, so that a robot without transforms is read
fast."""
_PARTS_NS = ((0, 1), (2_000_000_000, 200_000_000))
"""The parts of a recording that are read, in ns before and after the message: first an empty part that gives static
transforms only, since the seconds around the message may hold hundreds of megabytes of images.
"""


@dataclass(frozen=True, slots=True)
class Mount:
    """The frame of the robot's base, and the pose of a sensor's frame in it; None if the pose is not known."""

    base: str = ""
    pose: Pose | None = None
    is_static: bool = False


_known: WeakKeyDictionary[TransformListener, dict[str, tuple[float, Mount]]] = WeakKeyDictionary()
"""The cached mounts of each robot: time of look-up (monotonic, in s) and mount, by the sensor's frame."""


async def mount_of(source: Source, frame: str, at_ns: int) -> Mount:
    """Return the mount of a sensor's frame; for a frame that moves on the robot, its latest pose.

    Args:
        source: the robot, or a recording.
        frame: the sensor's frame.
        at_ns: of a recording, the time of receipt of the message that is read.
    """
    frame = frame.lstrip("/")
    try:
        if source.transforms:
            return await _live_mount(source, source.transforms, frame)
        for before_ns, after_ns in _PARTS_NS if source.covers_ns else ():  # of a database all messages would be read
            tree = await frames_of(source.part(at_ns - before_ns, at_ns + after_ns))
            mount = _found(tree, frame)
            if mount.pose:
                return mount
    except RobotError:  # no transforms, or tf2_msgs is not installed: values stay in the sensor's own frame
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
