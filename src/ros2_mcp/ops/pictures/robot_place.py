"""The robot's pose in the frame of a picture: from TF, else from a localisation topic."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from typing import Any

from ros2_mcp.model.aside import aside, load
from ros2_mcp.model.errors import RobotError
from ros2_mcp.model.pictures import RobotPlace
from ros2_mcp.model.poses import Pose
from ros2_mcp.model.samples import Sample
from ros2_mcp.ops.sources.source import Source, Stream
from ros2_mcp.ops.space.ages import stamp_ns
from ros2_mcp.ops.space.frames import frames_of
from ros2_mcp.world.transforms import FrameTree, Located, pose_of

_LISTEN_S = 0.6
"""Time to wait for a transform or a pose: matching takes up to 0.2 s, moving frames are published at 5 Hz or more,
static frames are latched.
"""
_BEFORE_NS, _AFTER_NS = 10_000_000_000, 200_000_000
"""The part of a recording that is read around a time, in ns: as much as tf2 keeps, and one more message of a slow
publisher."""
_MOST = 200
"""The most messages of a recording that are read: localisation publishes the pose at 10 Hz."""
LOCALISED = ("/amcl_pose", "/pose")
"""Topics on which localisation (Nav2's amcl, slam_toolbox) publishes the robot's pose, with this type."""
LOCALISED_TYPE = "geometry_msgs/msg/PoseWithCovarianceStamped"


async def robot_place(source: Source, frame: str, near_ns: int | None = None) -> RobotPlace | None:
    """Return the robot's pose in that frame; None if it is not published.

    For a recording read from a start time on, it is the pose at `near_ns`, the receive time of the picture's message.
    """
    await load("ros2_mcp.values.cdr")  # with numpy: not before it is needed
    if near_ns is not None and source.covers_ns and not source.from_end:
        near_ns = max(near_ns, source.covers_ns[0])
        source = source.part(near_ns - _BEFORE_NS, near_ns + _AFTER_NS)
    frame = frame.lstrip("/")
    with suppress(RobotError):
        tree = await frames_of(source, until=lambda tree: _found(tree, frame) is not None, patience_s=_LISTEN_S)
        if found := _found(tree, frame):
            return placed(found.pose, found.stamp_ns)
    for topic in LOCALISED:
        said = [
            message for message in await _messages(source, topic, LOCALISED_TYPE) if message.header.frame_id == frame
        ]
        if said:
            with suppress(ValueError):  # the pose has values that are not finite
                return placed(pose_of(said[-1].pose.pose), stamp_ns(said[-1].header))
    return None


def placed(pose: Pose, stamp_ns: int | None) -> RobotPlace:
    """Return a pose as the place of the robot, with the stamp of its transform or message in ns (None: static)."""
    x_m, y_m, z_m = pose.translation
    return RobotPlace(x_m, y_m, pose.yaw_rad, z_m, stamp_ns)


def _found(tree: FrameTree, frame: str) -> Located | None:
    return tree.newest(frame, tree.base) if tree.base and frame in tree.frames else None


async def _messages(source: Source, topic: str, type_name: str) -> list[Any]:
    """Return the decoded messages of a topic; empty if the topic is not found or has another type."""
    found: list[Any] = []
    with suppress(RobotError):
        if await source.type_of(topic) == type_name:
            async with source.lasting(_LISTEN_S).follow(topic, limit=_MOST) as stream:
                async for batch in stream.batches:
                    size = sum(len(sample.data) for sample in batch)
                    found += await aside(size, _decoded, stream, batch)
    return found


def _decoded(stream: Stream, samples: Sequence[Sample]) -> list[Any]:
    return [stream.codec.decode(stream.type, sample.data) for sample in samples]
