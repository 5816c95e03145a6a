"""The meaning of a sensor message as seen from the robot's base, for every result that shows such messages."""

from __future__ import annotations

from contextlib import suppress
from typing import Any

from ros2_mcp.model.aside import aside, load
from ros2_mcp.model.errors import BadData, RobotError
from ros2_mcp.model.meanings import DepthMeaning, Meaning, ScanMeaning
from ros2_mcp.model.pictures import COMPRESSED_IMAGE, IMAGE, LASER_SCAN, POINT_CLOUD
from ros2_mcp.ops.pictures.next_message import next_message
from ros2_mcp.ops.results.results import silent
from ros2_mcp.ops.sources.selection import Fitted
from ros2_mcp.ops.sources.source import Source, Stream
from ros2_mcp.ops.space.mount import mount_of

_CAMERA_INFO = "sensor_msgs/msg/CameraInfo"
_INFO_S = 1.0
"""Time to wait for a CameraInfo: it is published with each image, at 5 Hz or more."""
_DEPTHS = frozenset({"32FC1", "16UC1"})
"""Encodings of depth images (REP 118)."""

_COMPRESSED = "compressedDepth"
"""The word in the format of compressed depth images (image_transport's compressed_depth)."""

Intrinsics = tuple[float, float, float, float]


async def meaning_of_newest(source: Source, stream: Stream, fitted: Fitted) -> Meaning | None:
    """Return the meaning of the newest message shown; None if no message is shown."""
    if not fitted.messages:
        return None
    return await meaning_of(source, stream.topic, stream.type, fitted.messages[-1], fitted.samples[-1].received_ns)


async def meaning_of(source: Source, topic: str, type_name: str, message: Any, at_ns: int) -> Meaning | None:
    """Return the meaning of a message received at `at_ns`, or the reason why it is unknown; None for messages that are
    neither scans, point clouds nor depth images.
    """
    is_depth = (type_name == IMAGE and message.encoding in _DEPTHS) or (
        type_name == COMPRESSED_IMAGE
        and (_COMPRESSED in message.format or message.format.partition(";")[0].strip() in _DEPTHS)
    )
    if type_name not in (LASER_SCAN, POINT_CLOUD) and not is_depth:
        return None
    await load("ros2_mcp.world.scans", "ros2_mcp.world.depths")  # with numpy: not before it is needed
    from ros2_mcp.world.depths import cloud_meaning, depth_meaning
    from ros2_mcp.world.scans import scan_meaning

    mount = await mount_of(source, message.header.frame_id, at_ns)
    where = mount.pose, mount.base
    try:
        if type_name == LASER_SCAN:
            scan: ScanMeaning = await aside(4 * len(message.ranges), scan_meaning, message, *where)
            return Meaning(scan=scan)
        depth: DepthMeaning | None
        if type_name == POINT_CLOUD:
            depth = await aside(len(message.data), cloud_meaning, message, *where)
        else:
            intrinsics = await _intrinsics(source, topic, message)
            depth = await aside(len(message.data), depth_meaning, message, intrinsics, *where)
        return Meaning(depth=depth) if depth else None
    except BadData as error:
        return Meaning(unknown=str(error))
    except RobotError:
        return None


async def _intrinsics(source: Source, topic: str, image: Any) -> Intrinsics | None:
    """Return the intrinsics of the camera that took the image: from the CameraInfo with the same frame and size whose
    topic name begins most like the image's; None if there is none.
    """
    from ros2_mcp.world.depths import intrinsics_of

    with suppress(RobotError):
        infos = await source.publishing(_CAMERA_INFO)
        for name in sorted(infos, key=lambda name: -_alike(name, topic)):
            if _alike(name, topic) < 2:  # only the root "/" in common: the info of another camera
                break
            with suppress(RobotError):
                info = (await next_message(source.lasting(_INFO_S), name, _CAMERA_INFO, silent)).message
                size = getattr(image, "width", info.width), getattr(image, "height", info.height)  # none if compressed
                if info.header.frame_id == image.header.frame_id and (info.width, info.height) == size:
                    return intrinsics_of(info)
    return None


def _alike(one: str, other: str) -> int:
    """Return the number of leading parts that two topic names have in common."""
    count = 0
    for part, like in zip(one.split("/"), other.split("/"), strict=False):
        if part != like:
            break
        count += 1
    return count
