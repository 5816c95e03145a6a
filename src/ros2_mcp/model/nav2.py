"""Nav2's interfaces: its types, the servers of its error codes, and the codes in words.

Codes are those of the actions' definitions (nav2_msgs, from Iron to Kilted; Humble has none). If Nav2 runs several
servers, a goal of `NavigateToPose` ends with the code of the one that failed.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from ros2_mcp.model.graph import TopicEndpoints

NAVIGATE = "nav2_msgs/action/NavigateToPose"
COMPUTE_PATH = "nav2_msgs/action/ComputePathToPose"
FOLLOW_WAYPOINTS = "nav2_msgs/action/FollowWaypoints"
THROUGH_POSES = "nav2_msgs/action/NavigateThroughPoses"
DOCK = "nav2_msgs/action/DockRobot"
UNDOCK = "nav2_msgs/action/UndockRobot"
NAVIGATORS = frozenset({NAVIGATE, THROUGH_POSES, FOLLOW_WAYPOINTS})
"""Actions whose servers send goals to other servers of Nav2."""
BELOW = frozenset(
    f"nav2_msgs/action/{name}"
    for name in (
        *("FollowPath", "ComputePathToPose", "ComputePathThroughPoses", "SmoothPath", "ComputeAndTrackRoute"),
        *("Spin", "BackUp", "DriveOnHeading", "AssistedTeleop", "Wait", "DockRobot", "UndockRobot"),
    )
)
"""Actions of the servers that execute a navigator's decisions."""
CANNOT_MOVE = frozenset(
    {
        *(f"nav2_msgs/action/{name}" for name in ("ComputePathToPose", "ComputePathThroughPoses", "SmoothPath")),
        *("nav2_msgs/action/ComputeRoute", "tf2_msgs/action/LookupTransform"),
    }
)
"""Actions that only compute and do not move the robot."""
NO_PROGRESS = 105
"""The controller's code for a robot that made no progress."""
MANAGE = "nav2_msgs/srv/ManageLifecycleNodes"
"""The service by which a lifecycle manager starts and stops its nodes together."""
LOAD_MAP, SAVE_MAP = "nav2_msgs/srv/LoadMap", "nav2_msgs/srv/SaveMap"
"""Services of map_server and map_saver."""
SLAM_SAVE_MAP, SAVE_POSE_GRAPH, LOAD_POSE_GRAPH = (
    f"slam_toolbox/srv/{name}" for name in ("SaveMap", "SerializePoseGraph", "DeserializePoseGraph")
)
POSE_STAMPED = "geometry_msgs/msg/PoseStamped"
PATH = "nav_msgs/msg/Path"
COSTMAP = "nav2_msgs/msg/Costmap"
COSTMAP_UPDATE = "nav2_msgs/msg/CostmapUpdate"
GRID_UPDATE = "map_msgs/msg/OccupancyGridUpdate"

SERVERS: Mapping[range, str] = {
    range(100, 200): "controller_server",
    range(200, 400): "planner_server",
    range(400, 500): "route_server",
    range(500, 600): "smoother_server",
    range(600, 700): "waypoint_follower",
    range(700, 800): "behavior_server",
    range(900, 1000): "docking_server",
    range(9000, 9200): "bt_navigator",
}
"""The server of each range of codes."""

NAVIGATION_NODES = (
    *("bt_navigator", "planner_server", "controller_server", "smoother_server", "behavior_server", "route_server"),
    *("global_costmap", "local_costmap", "velocity_smoother", "collision_monitor", "map_server", "amcl"),
    *("waypoint_follower", "lifecycle_manager_navigation", "lifecycle_manager_localization", "slam_toolbox"),
)
"""Names of Nav2's nodes."""


COSTMAPS = ("global_costmap", "local_costmap")
"""Nodes with a lifecycle of their own that live within the planner's and the controller's server, which change it: no
servers."""


def is_drawn_by_nav2(topic: TopicEndpoints) -> bool:
    """Return whether only Nav2's own nodes publish the topic.

    Clouds and markers of its costmaps are for display, and are not sensor data.
    """
    nodes = {one.node for one in topic.publishers}
    return bool(nodes) and all(not set(node.split("/")).isdisjoint(NAVIGATION_NODES) for node in nodes)


@dataclass(frozen=True, slots=True)
class ErrorCode:
    """One code: its name in the definitions, its meaning, and a remedy."""

    name: str
    meaning: str
    helps: str


_SEE_LOG = "Read the last log lines of that server (here, or ros2_log_read)."
_LOCALISE = "Check localisation: ros2_tf_lookup of the base in map; set the initial pose, or restart localisation."
_OCCUPIED_GOAL = "Choose a goal farther from obstacles; if nothing is there, clear the costmap."
_OUTSIDE = "Give a pose on the map: ros2_get_map_as_image shows its extent."
_FREE_START = "Drive the robot away from the obstacle; if nothing is there, clear the costmap."
_NO_WAY = "Clear the way, choose a reachable goal, or clear the costmap if the obstacle has gone."
_SERVERS_ACTIVE = "Check that all servers are active: ros2_lifecycle_state."
_MOVES = "Check whether something blocks the base, its motors are on, and no other node commands it."

_PLANNING: Mapping[int, ErrorCode] = {
    0: ErrorCode("UNKNOWN", "planning failed for a reason without a code", _SEE_LOG),
    1: ErrorCode("INVALID_PLANNER", "no planner has that name", "Leave planner_id out."),
    2: ErrorCode("TF_ERROR", "the planner lacks a transform", _LOCALISE),
    3: ErrorCode("START_OUTSIDE_MAP", "the robot is outside the costmap", _LOCALISE),
    4: ErrorCode("GOAL_OUTSIDE_MAP", "the goal is outside the costmap", _OUTSIDE),
    5: ErrorCode("START_OCCUPIED", "the robot is in an occupied cell of the costmap", _FREE_START),
    6: ErrorCode("GOAL_OCCUPIED", "the goal is in an occupied cell of the costmap", _OCCUPIED_GOAL),
    7: ErrorCode("TIMEOUT", "planning took too long", "Try a nearer goal, or allow the planner more time."),
    8: ErrorCode("NO_VALID_PATH", "the planner found no path to the goal", _NO_WAY),
    9: ErrorCode("NO_VIAPOINTS_GIVEN", "no poses were given", "Give at least one pose."),
}
CODES: Mapping[int, ErrorCode] = {
    1: ErrorCode("GOAL_REJECTED", "a server rejected its goal", _SEE_LOG),
    2: ErrorCode(
        "SEND_GOAL_FAILURE",
        "the goal could not be sent to a server",
        _SERVERS_ACTIVE,
    ),
    100: ErrorCode("UNKNOWN", "following the path failed for a reason without a code", _SEE_LOG),
    101: ErrorCode("INVALID_CONTROLLER", "no controller has that name", "Check the behaviour tree."),
    102: ErrorCode("TF_ERROR", "the controller lacks a transform", _LOCALISE),
    103: ErrorCode("INVALID_PATH", "the path to follow is not valid", _SEE_LOG),
    104: ErrorCode("PATIENCE_EXCEEDED", "the controller found no valid velocity for too long", _MOVES),
    105: ErrorCode("FAILED_TO_MAKE_PROGRESS", "the robot made no progress", _MOVES),
    106: ErrorCode("NO_VALID_CONTROL", "every velocity would lead into an obstacle, or off the path", _MOVES),
    107: ErrorCode("CONTROLLER_TIMED_OUT", "the costmap was not updated in time", "Check whether the sensors publish."),
    108: ErrorCode("TIMEOUT", "following the path took too long", _MOVES),
    **{200 + code: meaning for code, meaning in _PLANNING.items()},
    **{300 + code: meaning for code, meaning in _PLANNING.items()},
    400: ErrorCode("UNKNOWN", "routing failed for a reason without a code", _SEE_LOG),
    401: ErrorCode("TF_ERROR", "the route server lacks a transform", _LOCALISE),
    402: ErrorCode("NO_VALID_GRAPH", "the route server has no valid graph", "Load a graph into the route server."),
    403: ErrorCode(
        "INDETERMINANT_NODES_ON_GRAPH",
        "start or goal matches no single node of the graph",
        "Give the ids of the nodes.",
    ),
    404: ErrorCode("TIMEOUT", "routing took too long", "Try a nearer goal."),
    405: ErrorCode("NO_VALID_ROUTE", "the graph has no route to the goal", _NO_WAY),
    500: ErrorCode("UNKNOWN", "smoothing failed for a reason without a code", _SEE_LOG),
    501: ErrorCode("INVALID_SMOOTHER", "no smoother has that name", "Check the behaviour tree."),
    502: ErrorCode("TIMEOUT", "smoothing took too long", "Allow the smoother more time."),
    503: ErrorCode("SMOOTHED_PATH_IN_COLLISION", "the smoothed path touches an obstacle", _NO_WAY),
    504: ErrorCode("FAILED_TO_SMOOTH_PATH", "the path could not be smoothed", _SEE_LOG),
    505: ErrorCode("INVALID_PATH", "the path to smooth is not valid", _SEE_LOG),
    700: ErrorCode("UNKNOWN", "the turn on the spot failed for a reason without a code", _SEE_LOG),
    701: ErrorCode("TIMEOUT", "the turn on the spot took too long", _MOVES),
    702: ErrorCode("TF_ERROR", "the turn on the spot lacks a transform", _LOCALISE),
    703: ErrorCode("COLLISION_AHEAD", "the turn on the spot would touch an obstacle", _FREE_START),
    711: ErrorCode("TIMEOUT", "backing up took too long", _MOVES),
    712: ErrorCode("TF_ERROR", "backing up lacks a transform", _LOCALISE),
    714: ErrorCode("COLLISION_AHEAD", "backing up would touch an obstacle", _FREE_START),
    721: ErrorCode("TIMEOUT", "driving ahead took too long", _MOVES),
    723: ErrorCode("COLLISION_AHEAD", "driving ahead would touch an obstacle", _FREE_START),
    901: ErrorCode("DOCK_NOT_IN_DB", "the docking server knows no dock of that name", "Give a dock that it knows."),
    902: ErrorCode("DOCK_NOT_VALID", "the dock has no type that the server knows", "Give dock_type."),
    903: ErrorCode("FAILED_TO_STAGE", "the drive to the staging pose of the dock failed", "See ros2_nav_check."),
    904: ErrorCode("FAILED_TO_DETECT_DOCK", "the dock was not seen", "Check whether the sensor sees the dock."),
    905: ErrorCode("FAILED_TO_CONTROL", "the last approach to the dock, or leaving it, failed", _MOVES),
    906: ErrorCode("FAILED_TO_CHARGE", "the robot is at the dock, but does not charge", "Check the power of the dock."),
    907: ErrorCode("TIMEOUT", "docking took too long", _MOVES),
    999: ErrorCode("UNKNOWN", "docking failed for a reason without a code", _SEE_LOG),
    9000: ErrorCode("UNKNOWN", "navigation failed for a reason without a code", _SEE_LOG),
    9001: ErrorCode("FAILED_TO_LOAD_BEHAVIOR_TREE", "the behaviour tree cannot be loaded", "Check its file."),
    9002: ErrorCode("TF_ERROR", "the navigator lacks a transform", _LOCALISE),
    9003: ErrorCode(
        "TIMEOUT",
        "a server did not answer the navigator in time",
        _SERVERS_ACTIVE,
    ),
}
"""Meaning of each code; 0 is no error."""


def server_of(code: int) -> str:
    """Return the server of a code; empty if it is not known."""
    return next((server for codes, server in SERVERS.items() if code in codes), "")


def in_words(code: int) -> str:
    """Describe a code, such as `GOAL_OCCUPIED (206): the goal is in an occupied cell of the costmap`; empty for 0."""
    if not code:
        return ""
    known = CODES.get(code)
    return f"{known.name} ({code}): {known.meaning}" if known else f"error code {code}, which Nav2 does not define"
