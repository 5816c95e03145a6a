"""A point cloud from above as a picture, with its numbers."""

from __future__ import annotations

import asyncio
from dataclasses import asdict, dataclass, field, replace
from typing import Any

from ros2_mcp.guard.policy import bounded
from ros2_mcp.model.aside import load
from ros2_mcp.model.pictures import POINT_CLOUD, BirdEyeOptions
from ros2_mcp.model.times import seconds_from_start
from ros2_mcp.ops.pictures.next_message import next_message
from ros2_mcp.ops.pictures.robot_place import robot_place
from ros2_mcp.ops.pictures.upright import upright_of
from ros2_mcp.ops.results.results import IF_ANY, SAID, Report, WithPictures, facts, iso_time, silent
from ros2_mcp.ops.sources.only import only_topic
from ros2_mcp.ops.sources.source import Source


@dataclass(frozen=True, slots=True, kw_only=True)
class CloudPicture(WithPictures):
    """A point cloud from above, x to the right, y up, in the frame `frame_id`. Its z axis points up, unless `note` says
    that it may not, or that an optical frame was rotated.

    Pixel (`left_px` + column, `top_px` + row) has its corner at x = `x_min_m` + column · `metres_per_pixel`, y =
    `y_max_m` - row · `metres_per_pixel`; outside are the axes. Of all `points`, `not_finite` have no position, and
    `shown` lie within the requested limits (without limits: all except far outliers). The robot's pose is null if
    unknown. `color_low` and `color_high` are the values at the ends of the colour scale; null for rgb.
    `seconds_from_start` is the receive time as an offset from the start of a recording.
    """

    topic_name: str = field(metadata=SAID)
    frame_id: str
    points: int = field(metadata=SAID)
    shown: int = field(metadata=SAID)
    not_finite: int
    resolution_m: float
    metres_per_pixel: float
    left_px: int
    top_px: int
    x_min_m: float
    x_max_m: float
    y_min_m: float
    y_max_m: float
    z_min_m: float
    z_max_m: float
    color_mode: str
    color_low: float | None
    color_high: float | None
    robot_x_m: float | None
    robot_y_m: float | None
    robot_yaw_rad: float | None
    received_at: str
    seconds_from_start: float | None
    source: str
    note: str = field(metadata=IF_ANY)

    def summary(self) -> str:
        """Return one line with the points shown and the notes."""
        return f"{self.topic_name}: {self.shown} of {self.points} points. {self.pictures[0].note} {self.note}".rstrip()


async def cloud_picture(source: Source, topic: str, options: BirdEyeOptions, report: Report = silent) -> CloudPicture:
    """Draw the next point cloud of a topic from above; without a topic, of the only topic with clouds.

    Raises:
        NotFound: if the topic is not there, or there is no cloud.
        BadInput: if no topic is named, and there are several.
        TypeConflict: if it is no PointCloud2.
        TimedOut: if no cloud came.
        BadData: if its data does not fit its layout, or no point is left to show.
        BadValue: if the resolution is out of range.
    """
    # with numpy: not before it is needed
    await load("ros2_mcp.pictures.bird_eye", "ros2_mcp.world.clouds", "ros2_mcp.world.scans")
    from ros2_mcp.pictures.bird_eye import bird_eye
    from ros2_mcp.world.clouds import cloud_of
    from ros2_mcp.world.scans import moved

    bounded("resolution", options.resolution_m, 0.001, 100.0, "m")
    topic, chosen = await only_topic(source, topic, POINT_CLOUD)
    found = await next_message(source, topic, POINT_CLOUD, report)
    cloud = await asyncio.to_thread(cloud_of, found.message)
    upright = await upright_of(source, found.message.header.frame_id, found.sample.received_ns)
    if upright.pose is not None:
        cloud = replace(cloud, xyz=await asyncio.to_thread(moved, cloud.xyz, upright.pose))
    is_turned_alone = upright.pose is not None and upright.frame == found.message.header.frame_id
    place = None if is_turned_alone else await robot_place(source, upright.frame, found.sample.received_ns)
    seen = await asyncio.to_thread(bird_eye, cloud, options, place)
    numbers: dict[str, Any] = asdict(seen.numbers)
    numbers["note"] = " ".join(filter(None, (numbers["note"], upright.note, found.note, chosen)))
    return CloudPicture(
        topic_name=await source.name_of(topic),
        frame_id=upright.frame,
        points=cloud.points,
        not_finite=cloud.not_finite,
        **numbers,
        robot_x_m=place and place.x_m,
        robot_y_m=place and place.y_m,
        robot_yaw_rad=place and place.yaw_rad,
        received_at=iso_time(found.sample.received_ns),
        seconds_from_start=seconds_from_start(found.sample.received_ns, source.began_ns),
        source=found.source,
        pictures=facts([seen.picture]),
        images=[seen.picture],
    )
