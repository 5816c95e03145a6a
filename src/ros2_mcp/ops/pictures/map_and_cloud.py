"""Maps and point clouds as pictures with their facts."""

from __future__ import annotations

import asyncio
from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING, Any

from ros2_mcp.guard.policy import bounded
from ros2_mcp.model import names
from ros2_mcp.model.errors import TimedOut, TypeConflict
from ros2_mcp.model.pictures import OCCUPANCY_GRID, POINT_CLOUD, BirdEyeOptions
from ros2_mcp.ops.results import Report, WithPictures, facts, iso_time, reporting, silent
from ros2_mcp.ops.sources.source import Source, Stream

if TYPE_CHECKING:
    from ros2_mcp.model.samples import Sample


@dataclass(frozen=True, slots=True)
class MapPicture(WithPictures):
    """A map. `width` and `height` in cells; the origin is the pose of the corner of cell (0, 0), lower left in the
    picture; `free`, `occupied` (50 % and more) and `unknown` are shares of all cells."""

    topic_name: str
    frame_id: str
    resolution_m: float
    width: int
    height: int
    origin_x_m: float
    origin_y_m: float
    origin_yaw_rad: float
    free: float
    occupied: float
    unknown: float
    received_at: str
    source: str

    def summary(self) -> str:
        """One line."""
        return f"{self.topic_name}: {self.pictures[0].note}"


@dataclass(frozen=True, slots=True)
class CloudPicture(WithPictures):
    """A point cloud from above, x to the right, y up, of the frame `frame_id`.

    Pixel (column, row) begins at x = `x_min_m` + column · `metres_per_pixel`, y = `y_max_m` - row · `metres_per_pixel`.
    Of `points`, `not_finite` have no place, and `shown` lie within the heights asked for. `color_low` and
    `color_high` are the values at the ends of the colours; null for rgb.
    """

    topic_name: str
    frame_id: str
    points: int
    shown: int
    not_finite: int
    resolution_m: float
    metres_per_pixel: float
    x_min_m: float
    x_max_m: float
    y_min_m: float
    y_max_m: float
    z_min_m: float
    z_max_m: float
    color_mode: str
    color_low: float | None
    color_high: float | None
    received_at: str
    source: str
    note: str

    def summary(self) -> str:
        """One line."""
        return f"{self.topic_name}: {self.shown} of {self.points} points. {self.pictures[0].note} {self.note}".rstrip()


async def map_picture(source: Source, topic: str, report: Report = silent) -> MapPicture:
    """The first map of a topic; a latched one comes at once.

    Raises:
        NotFound: if the topic is not there.
        TypeConflict: if it is no OccupancyGrid.
        TimedOut: if no map came.
        BadData: if the map is empty or does not fit its size.
    """
    from ros2_mcp.codec.maps import map_facts
    from ros2_mcp.codec.pictures import picture_of

    message, sample, topic = await _first(source, topic, OCCUPANCY_GRID, report)
    known = await asyncio.to_thread(map_facts, message)
    picture = await asyncio.to_thread(picture_of, OCCUPANCY_GRID, message)
    return MapPicture(
        topic_name=topic,
        **asdict(known),
        received_at=iso_time(sample.received_ns),
        source=source.words,
        pictures=facts([picture]),
        images=[picture],
    )


async def cloud_picture(source: Source, topic: str, options: BirdEyeOptions, report: Report = silent) -> CloudPicture:
    """The next point cloud of a topic, from above.

    Raises:
        NotFound: if the topic is not there.
        TypeConflict: if it is no PointCloud2.
        TimedOut: if no cloud came.
        BadData: if its data does not fit its layout, or no point is left to show.
        BadValue: if the resolution is out of range.
    """
    from ros2_mcp.codec.bird_eye import bird_eye
    from ros2_mcp.codec.clouds import cloud_of

    bounded("resolution", options.resolution_m, 0.001, 100.0, "m")
    message, sample, topic = await _first(source, topic, POINT_CLOUD, report)
    cloud = await asyncio.to_thread(cloud_of, message)
    seen = await asyncio.to_thread(bird_eye, cloud, options)
    return CloudPicture(
        topic_name=topic,
        frame_id=message.header.frame_id,
        points=cloud.points,
        shown=seen.shown,
        not_finite=cloud.not_finite,
        resolution_m=seen.resolution_m,
        metres_per_pixel=seen.metres_per_pixel,
        x_min_m=seen.x_min_m,
        x_max_m=seen.x_max_m,
        y_min_m=seen.y_min_m,
        y_max_m=seen.y_max_m,
        z_min_m=seen.z_min_m,
        z_max_m=seen.z_max_m,
        color_mode=seen.color_mode,
        color_low=seen.low,
        color_high=seen.high,
        received_at=iso_time(sample.received_ns),
        source=source.words,
        note=seen.note,
        pictures=facts([seen.picture]),
        images=[seen.picture],
    )


async def _first(source: Source, topic: str, wanted: str, report: Report) -> tuple[Any, Sample, str]:
    """The first message of a topic of that type."""
    topic = names.absolute(topic)
    async with (
        reporting(report, source.duration_s, f"waiting for {topic}"),
        source.follow(topic, limit=1) as stream,
    ):
        if stream.type != wanted:
            raise TypeConflict(f"{topic} is a {stream.type}, not a {wanted}.", "ros2_topic_list shows types.")
        sample = await _next(source, stream)
        if sample is None:
            raise TimedOut(f"No message on {topic} ({source.words}).", _reason(stream))
        return await asyncio.to_thread(stream.codec.decode, stream.type, sample.data), sample, topic


async def _next(source: Source, stream: Stream) -> Sample | None:
    """The next message of a recording; live the newest one that waits."""
    async for batch in stream.batches:
        if batch:
            return batch[-1] if source.is_live else batch[0]
    return None


def _reason(stream: Stream) -> str:
    return f"It is published by {', '.join(stream.nodes)}." if stream.publishers else "Nobody publishes on it."
