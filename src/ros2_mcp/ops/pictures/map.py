"""A map as a picture, with its numbers."""

from __future__ import annotations

import asyncio
from dataclasses import asdict, dataclass, field, replace
from typing import TYPE_CHECKING, Any

from ros2_mcp.model.aside import load
from ros2_mcp.model.nav2 import COSTMAP_UPDATE, GRID_UPDATE
from ros2_mcp.model.pictures import BOUNDS, OCCUPANCY_GRID
from ros2_mcp.model.times import seconds_from_start
from ros2_mcp.ops.navigation.costmaps import costmap_of, updates_of
from ros2_mcp.ops.pictures.next_message import Next, next_message
from ros2_mcp.ops.pictures.robot_place import robot_place
from ros2_mcp.ops.results.results import IF_ANY, SAID, Report, WithPictures, facts, iso_time, reporting, silent
from ros2_mcp.ops.sources.only import only_topic
from ros2_mcp.ops.sources.source import Source
from ros2_mcp.robot import Robot

if TYPE_CHECKING:
    from ros2_mcp.world.occupancy import OccupancyGrid


@dataclass(frozen=True, slots=True)
class MapPicture(WithPictures):
    """A map. `width` and `height` are in cells. The origin is the pose of the corner of cell (0, 0), at the lower left
    of the picture; null if it is not finite. `free`, `occupied` (50 % and more) and `unknown` are shares of all cells.

    The upper left pixel of the map is at `left_px`, `top_px`, and a pixel is `metres_per_pixel` wide; outside are the
    axes. The robot's pose in `frame_id` is null if unknown. `seconds_from_start` is the receive time as an offset from
    the start of a recording.
    """

    topic_name: str = field(metadata=SAID)
    frame_id: str
    resolution_m: float
    width: int
    height: int
    origin_x_m: float | None
    origin_y_m: float | None
    origin_yaw_rad: float | None
    free: float
    occupied: float
    unknown: float
    metres_per_pixel: float
    left_px: int
    top_px: int
    robot_x_m: float | None
    robot_y_m: float | None
    robot_yaw_rad: float | None
    received_at: str
    seconds_from_start: float | None
    source: str
    note: str = field(metadata=IF_ANY)

    def summary(self) -> str:
        """Return one line with the notes on the map."""
        begins = f"The map begins at pixel ({self.left_px}, {self.top_px}) of the picture."
        return f"{self.topic_name}: {self.pictures[0].note} {begins} {self.note}".rstrip()


async def map_picture(robot: Robot, source: Source, topic: str, report: Report = silent) -> MapPicture:
    """Draw the map of a topic; without a topic, of the only topic with maps. Its later updates are included live, and
    for a recording without a start time, as of its end.

    Raises:
        NotFound: if the topic is not there, or there is no map.
        BadInput: if no topic is named, and there are several.
        TypeConflict: if it is no OccupancyGrid.
        TimedOut: if no map came.
        BadData: if the map is empty or does not fit its size.
    """
    await load("ros2_mcp.pictures.maps", "ros2_mcp.pictures.raster")  # with numpy: not before it is needed
    from ros2_mcp.pictures.maps import map_drawing
    from ros2_mcp.pictures.raster import finished

    topic, chosen = await only_topic(source, topic, OCCUPANCY_GRID)
    grid, found = await _map(robot, source, topic, report)
    numbers = await asyncio.to_thread(grid.facts)
    told, place, unplaced = dict[str, Any](asdict(numbers)), None, ""
    if grid.unplaced:
        told |= dict.fromkeys(("origin_x_m", "origin_y_m", "origin_yaw_rad"))
        unplaced = f"{grid.unplaced}: the map is drawn without axes, and the robot is not shown."
    else:
        place = await robot_place(source, numbers.frame_id, found.sample.received_ns)
    drawing = await asyncio.to_thread(map_drawing, grid, BOUNDS, place)
    picture = await asyncio.to_thread(finished, drawing.raster, BOUNDS)
    smaller = picture.width / drawing.raster.pixels.shape[1]
    return MapPicture(
        topic_name=await source.name_of(topic),
        **told,
        metres_per_pixel=drawing.metres_per_pixel / smaller,
        left_px=round(drawing.left_px * smaller),
        top_px=round(drawing.top_px * smaller),
        robot_x_m=place and place.x_m,
        robot_y_m=place and place.y_m,
        robot_yaw_rad=place and place.yaw_rad,
        received_at=iso_time(found.sample.received_ns),
        seconds_from_start=seconds_from_start(found.sample.received_ns, source.began_ns),
        source=found.source,
        note=" ".join(filter(None, (unplaced, found.note, chosen))),
        pictures=facts([picture]),
        images=[picture],
    )


async def _map(robot: Robot, source: Source, topic: str, report: Report) -> tuple[OccupancyGrid, Next]:
    """Return the grid with its message; the note reports the updates applied, or that they are not shown."""
    from ros2_mcp.world.occupancy import OccupancyGrid

    name = await source.name_of(topic)
    updates = updates_of(name, await source.publishing(GRID_UPDATE, COSTMAP_UPDATE))
    if updates and (source.is_live or source.from_end):
        async with reporting(report, source.duration_s, f"waiting for {topic}"):
            kept = await costmap_of(robot, source, name, OCCUPANCY_GRID, source.duration_s)
        note = " ".join(filter(None, (kept.skipped, kept.note)))
        return kept.grid, Next(kept.grid, kept.sample, source.words, note, kept.skipped)
    found = await next_message(source, topic, OCCUPANCY_GRID, report)
    if updates:  # those up to the start time may precede it, and are not read
        found = replace(found, note=f"{found.note} Later updates are not shown.".lstrip())
    return await asyncio.to_thread(OccupancyGrid, found.message, needs_place=False), found
