"""Tools for navigation with Nav2, and for named places."""

from __future__ import annotations

from typing import Annotated, Any, cast

from pydantic import BeforeValidator, Field
from pydantic_core import PydanticCustomError

from ros2_mcp.model.nav2 import COMPUTE_PATH, DOCK, MANAGE, NAVIGATE, UNDOCK
from ros2_mcp.model.text import excerpt
from ros2_mcp.ops.navigation.check import NavChecked, check_navigation
from ros2_mcp.ops.navigation.dock import DockRequest, NavDocked
from ros2_mcp.ops.navigation.dock import dock as dock_robot
from ros2_mcp.ops.navigation.localize import POSE_ESTIMATE, LocalizeRequest, NavLocalized, localize
from ros2_mcp.ops.navigation.nav_map import MAP_SERVICES, MapRequest, MapVerb, NavMap, nav_map
from ros2_mcp.ops.navigation.navigate import navigate
from ros2_mcp.ops.navigation.navigated import Navigated
from ros2_mcp.ops.navigation.pause import NavPaused, pause
from ros2_mcp.ops.navigation.places import PlaceKept, PlaceList, PlaceRequest, list_places, set_place
from ros2_mcp.ops.navigation.preview import Preview, preview
from ros2_mcp.ops.navigation.probe import NavProbed, probe
from ros2_mcp.ops.navigation.probe import What as Probing
from ros2_mcp.ops.navigation.recover import BACK_UP, CLEAR, DRIVE, SPIN, NavRecovered, StackCommand, What, recover
from ros2_mcp.ops.navigation.route import OnMissed, Routed, route
from ros2_mcp.ops.navigation.route_plan import MOST_LOOPS
from ros2_mcp.ops.results.results import Report
from ros2_mcp.robot import Robot
from ros2_mcp.robot.session import Session
from ros2_mcp.tools.arguments import WHOLE_SENTENCE, Flag, Number, Pattern, Whole
from ros2_mcp.tools.declare import tool
from ros2_mcp_common.policy.velocity import VELOCITY_TYPES
from ros2_mcp_common.wire.limits import MAX_DURATION_S

PLACE = 95


def _as_object(to: Any) -> Any:
    """Convert a name to a place object; reject anything but names and objects."""
    if isinstance(to, (dict, type(None))):
        return cast("Any", to)
    if isinstance(to, str):
        return {"place": to}
    raise _no_place(to)


def _as_object_if_any(to: Any) -> Any:
    """As `_as_object`; an empty value counts as not given, as these tools only read."""
    return _as_object(to) if to else None


def _no_place(to: object) -> PydanticCustomError:
    return PydanticCustomError(
        WHOLE_SENTENCE, '{given} is not a place: write {"x": 1, "y": 0} or its name.', {"given": excerpt(to)}
    )


def _as_list(to: Any) -> Any:
    """Convert a single place to a list of one."""
    if isinstance(to, list):
        if to and not any(isinstance(one, (str, dict, list)) for one in cast("list[Any]", to)):
            raise _no_place(cast("object", to))  # a list of numbers is one place, written wrongly
        return [_as_object(one) for one in cast("list[Any]", to)]
    return to if to is None else [_as_object(to)]


_OTHER_WORDS = {"clear_both": "clear", "backup": "back_up", "drive_on_heading": "drive_ahead", "drive": "drive_ahead"}
"""Words for Nav2's recoveries as others spell them."""


def _as_recovery(what: Any) -> Any:
    return _OTHER_WORDS.get(what, what) if isinstance(what, str) else what


Pose = Annotated[
    dict[str, Any],
    BeforeValidator(_as_object),
    Field(description='{"place": name} or {"x", "y", "yaw_deg", "frame"} (m, degrees; frame: map).'),
]
Action = Annotated[str, Field(description="Name of the action, if there are several.")]
Metres = Annotated[Number | None, Field(description="Metres. Without x and y: the robot's pose.")]


@tool(
    title="Navigate",
    risk="actuate",
    does={"goal": (NAVIGATE,)},
    group="motion",
    aliases={"timeout_sec": "timeout_s"},
    program="navigate",
    finds="go to the kitchen, drive to a place or room, navigation, waypoints, Nav2",
)
async def ros2_navigate(
    robot: Robot,
    session: Session,
    report: Report,
    to: Annotated[
        list[dict[str, Any]] | None,
        BeforeValidator(_as_list),
        Field(
            description='Places in order: {"place": name} or {"x", "y", "yaw_deg", "frame"} (m, degrees; frame: map).'
        ),
    ] = None,
    job_id: Annotated[str, Field(description="Wait for this running job instead.")] = "",
    timeout_s: Annotated[Number, Field(ge=0, le=MAX_DURATION_S, description="Maximum wait in seconds.")] = 45.0,
    stop_when_stuck_s: Annotated[
        Number, Field(ge=0, le=MAX_DURATION_S, description="End it after this long without progress; 0: never.")
    ] = 0,
    action_name: Action = "",
) -> Navigated:
    """Drive to places with Nav2, around obstacles. Can move the robot.

    Reports the time taken and how near the robot came; for a failed goal, the cause and what would help. After a
    time-out, call again with the job_id; ros2_stop ends the job.
    """
    return await navigate(
        robot,
        session,
        to,
        action=action_name,
        job_id=job_id,
        timeout_s=timeout_s,
        stuck_s=stop_when_stuck_s or None,
        report=report,
    )


@tool(
    title="Drive a route",
    risk="actuate",
    does={"goal": (NAVIGATE,)},
    group="navigation",
    by_default=False,
    finds="patrol, tour of waypoints, loop, wait at each place, skip a missed place",
)
async def ros2_nav_route(
    robot: Robot,
    session: Session,
    report: Report,
    to: Annotated[
        list[dict[str, Any]] | None,
        BeforeValidator(_as_list),
        Field(
            description='Places in order: {"place": name} or {"x", "y", "yaw_deg", "frame"} (m, degrees; frame: map); '
            '"wait_s" in one replaces wait_s.'
        ),
    ] = None,
    loops: Annotated[Whole, Field(ge=1, le=MOST_LOOPS, description="How often to drive the list.")] = 1,
    wait_s: Annotated[Number, Field(ge=0, le=MAX_DURATION_S, description="Seconds to wait at each place.")] = 0,
    on_missed: Annotated[OnMissed, Field(description="After a place that was not reached.")] = "stop",
    job_id: Annotated[str, Field(description="Wait for this running job instead.")] = "",
    timeout_s: Annotated[Number, Field(ge=0, le=MAX_DURATION_S, description="Maximum wait in seconds.")] = 45.0,
    stop_when_stuck_s: Annotated[
        Number, Field(ge=0, le=MAX_DURATION_S, description="A place counts as missed after this long without progress.")
    ] = 0,
    action_name: Action = "",
) -> Routed:
    """Drive to places in order with Nav2, in loops, with waits. Can move the robot.

    Each place is a goal of its own, and reported as reached or missed, with the cause. An approval covers the whole
    list. After a time-out, call again with the job_id; ros2_nav_pause pauses it, ros2_stop ends it.
    """
    return await route(
        robot,
        session,
        to,
        loops=loops,
        wait_s=wait_s,
        on_missed=on_missed,
        action=action_name,
        job_id=job_id,
        timeout_s=timeout_s,
        stuck_s=stop_when_stuck_s or None,
        report=report,
    )


@tool(
    title="Pause a navigation",
    risk="actuate",
    does={"goal": (NAVIGATE,)},
    group="navigation",
    by_default=False,
    finds="pause driving, hold the robot, continue the route, resume navigation",
)
async def ros2_nav_pause(
    robot: Robot,
    report: Report,
    resume: Annotated[Flag, Field(description="Go on with the rest instead. Can move the robot.")] = False,
    job_id: Annotated[str, Field(description="The navigation, if several run.")] = "",
) -> NavPaused:
    """Pause the running ros2_navigate or ros2_nav_route: cancel its goal, check that the robot stands, and keep the
    rest of the list.

    With resume it goes on, and reports how far the robot was moved meanwhile. A pause ends by itself after an hour.
    """
    return await pause(robot, job_id, resume=resume, report=report)


@tool(
    title="Why it does not navigate",
    risk="read",
    group="navigation",
    by_default=False,
    beside={"ros2_navigate": "Use it before ros2_navigate, or when that fails."},
    finds="why does the robot not move, Nav2 diagnosis, navigation stuck, check before driving",
)
async def ros2_nav_check(
    robot: Robot,
    to: Annotated[
        dict[str, Any] | None,
        BeforeValidator(_as_object_if_any),
        Field(description="Check this goal as well: its place or pose."),
    ] = None,
) -> NavChecked:
    """Find out why a robot with Nav2 does not navigate: reads only, sends no goal, moves nothing.

    Looks at the command chain to the wheels, clocks, frames, servers, sensors, map, localisation and settings. Each
    finding has its cause, the proof in numbers and a remedy, the worst first.
    """
    return await check_navigation(robot, to)


@tool(
    title="Try a small move",
    risk="actuate",
    does={"publish": tuple(VELOCITY_TYPES)},
    group="navigation",
    by_default=False,
    beside={"ros2_nav_check": "Use it when ros2_nav_check finds nothing."},
    finds="odometry wrong direction, lidar mounted wrong, wheels swapped, calibration check",
)
async def ros2_nav_probe(
    robot: Robot,
    session: Session,
    report: Report,
    what: Annotated[Probing, Field(description="Only one of the two.")] = "both",
) -> NavProbed:
    """Drive 0.2 m ahead and turn 30° left, and compare odometry, laser scan and gyro with the command. Moves the robot.

    Finds a lidar that is turned against its transform, odometry with a wrong sign or scale, and exchanged wheels. Needs
    0.5 m free all round the outline.
    """
    return await probe(robot, session, what, report)


@tool(
    title="Preview a path",
    risk="write",
    does={"goal": (COMPUTE_PATH,)},
    group="navigation",
    by_default=False,
    finds="plan a path without moving, route, is a place reachable",
)
async def ros2_nav_preview(
    robot: Robot,
    session: Session,
    report: Report,
    to: Pose,
    start: Annotated[
        dict[str, Any] | None,
        BeforeValidator(_as_object),
        Field(description="Start of the path, in the same form. Default: the robot's pose."),
    ] = None,
    planner_id: Annotated[str, Field(description="Default: Nav2's own.")] = "",
    action_name: Action = "",
) -> Preview:
    """Ask Nav2's planner for the path to a place: picture, length, points, narrowest spot. Nothing moves. If there is
    no path, the result says why."""
    return await preview(robot, session, to, start, planner_id=planner_id, action=action_name, report=report)


@tool(
    title="Tell where the robot is",
    risk="write",
    does={"publish": (POSE_ESTIMATE,)},
    group="navigation",
    by_default=False,
    finds="initial pose, relocalize, AMCL is lost, find the robot on the map",
)
async def ros2_nav_localize(
    robot: Robot,
    session: Session,
    report: Report,
    at: Annotated[
        dict[str, Any] | None,
        BeforeValidator(_as_object),
        Field(description='Where it is: {"place": name} or {"x", "y", "yaw_deg"} in map; with search=true, a guess.'),
    ] = None,
    search: Annotated[Flag, Field(description="Find it on the map by its laser scan.")] = False,
    radius_m: Annotated[
        Number | None, Field(gt=0, le=1000, description="Search radius around at; default 3. Heading: within 60°.")
    ] = None,
    last: Annotated[
        Flag, Field(description="After a restart: use the last pose that was stored, if the scan fits the map there.")
    ] = False,
    topic_name: Annotated[str, Field(description="Default: /initialpose.")] = "",
) -> NavLocalized:
    """Tell localisation where the robot is (initial pose): a given, found or stored pose. Nothing moves.

    Reports whether localisation accepted it, and how well the laser scan fits the map before and after. If several
    poses fit nearly as well, none is published: choose one and give it as `at`.
    """
    request = LocalizeRequest(at=at, search=search, radius_m=radius_m, last=last, topic=topic_name)
    return await localize(robot, session, request, report)


@tool(
    title="Save or load a map",
    risk="write",
    does={"call": MAP_SERVICES},
    group="navigation",
    by_default=False,
    finds="save the map, load or switch the map or floor, map_server, map_saver, slam_toolbox",
)
async def ros2_nav_map(
    robot: Robot,
    session: Session,
    report: Report,
    what: Annotated[MapVerb, Field(description="show: which maps and services there are.")] = "show",
    path: Annotated[
        str, Field(description="On the robot's computer; to save: without ending; to load: the YAML file.")
    ] = "",
    pose_graph: Annotated[Flag, Field(description="slam_toolbox's pose graph, to go on mapping.")] = False,
    at: Annotated[
        dict[str, Any] | None,
        BeforeValidator(_as_object),
        Field(description="Of a loaded pose graph: where the robot is. Default: at its first node."),
    ] = None,
    service_name: Annotated[str, Field(description="Name of the service, if there are several.")] = "",
) -> NavMap:
    """Save or load a map with map_server, map_saver or slam_toolbox, or list what there is. Nothing moves.

    Reports what was verified: the map that is published after loading, and the files where they can be seen from here.
    """
    request = MapRequest(what=what, path=path, pose_graph=pose_graph, at=at, service=service_name)
    return await nav_map(robot, session, request, report)


@tool(
    title="Dock or undock",
    risk="actuate",
    does={"goal": (DOCK, UNDOCK)},
    group="navigation",
    by_default=False,
    finds="go to the charging dock or station, charge, dock, undock, leave the dock",
)
async def ros2_nav_dock(
    robot: Robot,
    session: Session,
    report: Report,
    dock: Annotated[str, Field(description="Name of a dock that Nav2 knows. Default: the only one.")] = "",
    at: Annotated[
        dict[str, Any] | None,
        BeforeValidator(_as_object),
        Field(description="Instead: the pose or place of a dock."),
    ] = None,
    dock_type: Annotated[
        str, Field(description="Type of the dock. With `at` or `undock`, needed if Nav2 has several.")
    ] = "",
    undock: Annotated[Flag, Field(description="Leave the dock instead.")] = False,
    job_id: Annotated[str, Field(description="Wait for this running docking instead.")] = "",
    timeout_s: Annotated[Number, Field(ge=0, le=MAX_DURATION_S, description="Maximum wait in seconds.")] = 45.0,
    action_name: Action = "",
) -> NavDocked:
    """Dock or undock with Nav2's docking server. Can move the robot.

    Reports the states it went through, retries, and what was measured: distance from the dock's pose, motion by
    odometry, and whether the battery says that it charges. After a time-out, call again with the job_id; ros2_stop ends
    it.
    """
    request = DockRequest(dock=dock, at=at, dock_type=dock_type, undock=undock, job_id=job_id, action=action_name)
    return await dock_robot(robot, session, request, timeout_s, report)


@tool(
    title="Free the robot",
    risk="actuate",
    does={"goal": (SPIN, BACK_UP, DRIVE), "call": (CLEAR, MANAGE)},
    group="navigation",
    by_default=False,
    finds="robot is stuck, clear costmap, back up, spin, pause or restart Nav2",
)
async def ros2_nav_recover(
    robot: Robot,
    session: Session,
    report: Report,
    what: Annotated[
        What | None,
        BeforeValidator(_as_recovery),
        Field(description="Clear costmaps (both, or one), or make a short move with collision checks."),
    ] = None,
    amount: Annotated[
        Number | None, Field(description="Of a move: m, default 0.3; of spin: degrees left, default 90.")
    ] = None,
    stack: Annotated[StackCommand | None, Field(description="Instead: command all of Nav2's servers.")] = None,
    node_name: Annotated[str, Field(description="The lifecycle manager, if there are several.")] = "",
) -> NavRecovered:
    """Use Nav2's own recoveries: clear costmaps, back up, spin, drive ahead; or bring up, shut down, pause or resume
    its servers. Can move the robot.

    Reports what was measured: cells cleared, distance and angle by odometry, servers active.
    """
    return await recover(robot, session, what or "", stack=stack or "", amount=amount, node=node_name, report=report)


@tool(
    title="List places", risk="read", group="space", by_default=False, finds="named places, rooms, where is the kitchen"
)
async def ros2_place_list(robot: Robot, pattern: Pattern = "") -> PlaceList:
    """List the named places with their poses and their distances from the robot."""
    return await list_places(robot, pattern)


@tool(
    title="Save a place",
    risk="write",
    group="space",
    by_default=False,
    beside={"ros2_navigate": "ros2_navigate drives to one by its name."},
    finds="remember this place, name or save a location",
)
async def ros2_place_set(
    robot: Robot,
    session: Session,
    name: Annotated[str, Field(description="Name of the place, such as door.")],
    x: Metres = None,
    y: Metres = None,
    yaw_deg: Annotated[Number | None, Field(description="Heading in degrees. Default: any, or the robot's.")] = None,
    frame: Annotated[str, Field(description="Coordinate frame.")] = "map",
    remove: Annotated[Flag, Field(description="Delete the place instead.")] = False,
) -> PlaceKept:
    """Save a place (a pose with a name), or delete a place. Places outlive this server."""
    request = PlaceRequest(name=name, x_m=x, y_m=y, yaw_deg=yaw_deg, frame=frame, remove=remove)
    return await set_place(robot, session, request)
