"""Tools that report where things are."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field

from ros2_mcp.ops.results.results import Report
from ros2_mcp.ops.sources.source import Source
from ros2_mcp.ops.space.brief import Part
from ros2_mcp.ops.space.robot import RobotInBrief, in_brief
from ros2_mcp.ops.space.scene import scene
from ros2_mcp.ops.space.scene_picture import ScenePicture, SceneRequest
from ros2_mcp.ops.space.tf_lookup import Lookup, LookupRequest, tf_lookup
from ros2_mcp.ops.space.tf_tree import Tree, tf_tree
from ros2_mcp.robot import Robot
from ros2_mcp.tools.arguments import AtTime, Flag, Number
from ros2_mcp.tools.declare import tool
from ros2_mcp.tools.injection import AtOneTime, RecordingSource

PLACE = 35


@tool(
    title="The robot in brief",
    risk="read",
    recorded=True,
    place=9,
    finds="what robot is this, overview, what can it do, where is it, battery",
    always_loaded=True,
)
async def ros2_robot(
    robot: Robot,
    part: Annotated[Part, Field(description="Only this part, in full. Default: all in brief.")] = "",
    whole: Annotated[Flag, Field(description="All parts in full.")] = False,
    *,
    source: RecordingSource,
) -> RobotInBrief:
    """Start here: kind, size, command inputs, sensors, joints, where it is, and what is unhealthy."""
    return await in_brief(robot, source, part=part, whole=whole)


@tool(
    title="Transform between frames",
    risk="read",
    group="space",
    recorded=True,
    aliases={"target_frame": "target", "source_frame": "source", "frame": "source", "duration": "duration_s"},
    program="tf",
    finds="where is it, position, pose, transform between frames, distance",
)
async def ros2_tf_lookup(
    report: Report,
    target: Annotated[str, Field(description="Such as map.")],
    source: Annotated[str, Field(description="Such as base_link.")] = "",
    time: AtTime = "",
    duration_s: Annotated[Number | None, Field(description="Average over this many seconds.")] = None,
    points: Annotated[
        list[list[Number]] | None, Field(description="Points in source to transform: [x,y,z] or [x,y,z,qx,qy,qz,qw].")
    ] = None,
    field: Annotated[str, Field(description="Or points of a message, such as /plan:poses.")] = "",
    *,
    reading: RecordingSource,
) -> Lookup:
    """Look up the pose of frame source in frame target, its age and the frames between; or why it is unknown."""
    request = LookupRequest(
        target=target, frame=source, time=time, duration_s=duration_s, points=points or (), field=field
    )
    return await tf_lookup(reading, request, report)


@tool(
    title="Scene from above",
    risk="read",
    group="space",
    recorded=True,
    finds="what is around, obstacle in front, free space, laser and map picture from above",
)
async def ros2_scene(
    robot: Robot,
    report: Report,
    frame: Annotated[
        str, Field(description="Frame to draw in. Default: the map's; base_link: as the robot sees it.")
    ] = "",
    grid: Annotated[str, Field(description='Topic of a grid or raw costmap, or "costmap". Default: the map.')] = "",
    radius_m: Annotated[Number | None, Field(gt=0, le=1000, description="Radius around the robot in metres.")] = None,
    *,
    source: AtOneTime,
) -> ScenePicture:
    """Draw the scene from above with lines labelled in metres: map or costmap, robot and heading, scans, paths, goals,
    named places; reports the nearest obstacle and which sides are free."""
    return await scene(robot, source, SceneRequest(frame, grid, radius_m), report)


@tool(
    title="Tree of frames",
    risk="read",
    group="space",
    recorded=True,
    by_default=False,
    aliases={"duration": "duration_s"},
    finds="frames, transform tree, TF problems",
)
async def ros2_tf_tree(
    report: Report,
    frame: Annotated[str, Field(description="Only the frames below this one. Default: all.")] = "",
    duration_s: Annotated[Number, Field(ge=0, le=60, description="Live: listening time in seconds.")] = 3.0,
    picture: Annotated[Flag, Field(description="Also return a picture.")] = True,
    *,
    source: Source,
) -> Tree:
    """Show all coordinate frames (TF) as a tree, as text and as a picture: who publishes each edge, its rate and
    age, and what is wrong: several trees, stale edges, two parents, several publishers of one edge, stamps that jump or
    are missing."""
    return await tf_tree(source, frame, duration_s, picture=picture, report=report)
