"""Tools that return pictures: plots, maps, point clouds."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field

from ros2_mcp.model.pictures import MAX_SIDE, BirdEyeOptions, Bounds
from ros2_mcp.ops.pictures.cloud import CloudPicture, cloud_picture
from ros2_mcp.ops.pictures.map import MapPicture, map_picture
from ros2_mcp.ops.pictures.plot import Plot, PlotRequest, plot
from ros2_mcp.ops.results.results import Report
from ros2_mcp.ops.sources.source import Source
from ros2_mcp.robot import Robot
from ros2_mcp.tools.arguments import Number, Whole
from ros2_mcp.tools.declare import tool

PLACE = 40

Timeout = Annotated[Number, Field(gt=0, le=600, description="Live: maximum wait in seconds.")]
Pixels = Annotated[Whole, Field(ge=300, le=MAX_SIDE, description="Size of the picture in pixels.")]
Lowest = Annotated[Number | None, Field(description="Lower bound in metres. Default: all but far outliers.")]
Highest = Annotated[Number | None, Field(description="Upper bound in metres. Default: all but far outliers.")]


@tool(
    title="Plot",
    risk="read",
    group="pictures",
    recorded=True,
    by_default=False,
    aliases={"topic_names": "series", "duration": "duration_s"},
    finds="plot, curve, chart, graph over time, trajectory picture",
)
async def ros2_plot(
    report: Report,
    series: Annotated[
        list[str],
        Field(
            min_length=1,
            max_length=24,
            description='Topic:field, such as ["/odom:twist.twist.linear.x"]. A topic or message alone: all numbers.',
        ),
    ],
    duration_s: Annotated[Number, Field(ge=0.1, le=600, description="Live: listening time in seconds.")] = 5.0,
    kind: Annotated[
        Literal["time", "xy"],
        Field(description='"time", or "xy": pairs of series against each other; a position alone is a trajectory.'),
    ] = "time",
    width: Pixels = 1000,
    height: Pixels = 640,
    *,
    source: Source,
) -> Plot:
    """Draw numeric fields over time, or trajectories, as a picture; with minimum, maximum and mean of each."""
    return await plot(source.lasting(duration_s), PlotRequest(series, kind, width, height), report)


@tool(
    title="Map as a picture",
    risk="read",
    group="pictures",
    recorded=True,
    aliases={"timeout": "timeout_s"},
    finds="map picture, occupancy grid, costmap, walls, rooms",
)
async def ros2_get_map_as_image(
    robot: Robot,
    report: Report,
    topic_name: Annotated[str, Field(description="A topic of nav_msgs/OccupancyGrid. Default: the only one.")] = "",
    timeout_s: Timeout = 5.0,
    *,
    source: Source,
) -> MapPicture:
    """Show an occupancy grid as a picture: axes in metres, origin and robot; resolution, size, shares of free, occupied
    and unknown."""
    return await map_picture(robot, source.lasting(timeout_s), topic_name, report)


@tool(
    title="Point cloud from above",
    risk="read",
    group="pictures",
    recorded=True,
    by_default=False,
    finds="point cloud picture, lidar, depth camera from above",
)
async def ros2_get_pointcloud_as_bev(
    report: Report,
    topic_name: Annotated[str, Field(description="A topic of sensor_msgs/PointCloud2. Default: the only one.")] = "",
    resolution: Annotated[Number, Field(ge=0.001, le=100, description="Metres per pixel.")] = 0.05,
    zmin: Annotated[
        Number | None, Field(description="Minimum height in metres, in the picture's frame. Default: all.")
    ] = None,
    zmax: Annotated[
        Number | None, Field(description="Maximum height in metres, in the picture's frame. Default: all.")
    ] = None,
    xmin: Lowest = None,
    xmax: Highest = None,
    ymin: Lowest = None,
    ymax: Highest = None,
    timeout: Timeout = 5.0,
    max_pixels: Annotated[Whole, Field(ge=64, le=16_384, description="Longest side; at most 1568 is drawn.")] = 2048,
    color_mode: Annotated[
        Literal["intensity", "height", "rgb"],
        Field(description="What the colours show; height if the cloud lacks it."),
    ] = "intensity",
    colormap: Annotated[Literal["jet", "gray"], Field(description="Colour scale for intensity and height.")] = "jet",
    *,
    source: Source,
) -> CloudPicture:
    """Show a point cloud from above (bird's-eye view): axes in metres, origin and robot; its extent and scale."""
    bounds = Bounds(min(max_pixels, MAX_SIDE))
    options = BirdEyeOptions(
        resolution_m=resolution,
        x_min_m=xmin,
        x_max_m=xmax,
        y_min_m=ymin,
        y_max_m=ymax,
        z_min_m=zmin,
        z_max_m=zmax,
        color_mode=color_mode,
        colormap=colormap,
        bounds=bounds,
    )
    return await cloud_picture(source.lasting(timeout), topic_name, options, report)
