"""A map as a picture with its facts."""

from __future__ import annotations

import asyncio
from dataclasses import asdict, dataclass

from ros2_mcp.model import names
from ros2_mcp.model.pictures import OCCUPANCY_GRID
from ros2_mcp.ops.pictures.next_message import next_message
from ros2_mcp.ops.results import Report, WithPictures, facts, iso_time, silent
from ros2_mcp.ops.sources.source import Source


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
    note: str

    def summary(self) -> str:
        """One line."""
        return f"{self.topic_name}: {self.pictures[0].note} {self.note}".rstrip()


async def map_picture(source: Source, topic: str, report: Report = silent) -> MapPicture:
    """The first map of a topic; a latched one comes at once.

    Raises:
        NotFound: if the topic is not there.
        TypeConflict: if it is no OccupancyGrid.
        TimedOut: if no map came.
        BadData: if the map is empty or does not fit its size.
    """
    from ros2_mcp.codec.maps import map_facts  # with numpy: not before it is needed
    from ros2_mcp.codec.pictures import picture_of

    found = await next_message(source, topic, OCCUPANCY_GRID, report)
    numbers = await asyncio.to_thread(map_facts, found.message)
    picture = await asyncio.to_thread(picture_of, OCCUPANCY_GRID, found.message)
    return MapPicture(
        topic_name=names.absolute(topic),
        **asdict(numbers),
        received_at=iso_time(found.sample.received_ns),
        source=source.words,
        note=found.note,
        pictures=facts([picture]),
        images=[picture],
    )
