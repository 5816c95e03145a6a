"""The verb of an act: what calling a service means, and which names and types match a pattern.

Server and bridge share it. Needs no ROS.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

Verb = Literal["publish", "relay", "play", "call", "goal", "cancel", "set", "transition", "record", "read"]
"""What is done: `publish` once or repeatedly, `set` parameters, make a `transition` of a lifecycle node, and so on.

`read` is a call of a service that only returns information.
"""

SET_PARAMETERS = "rcl_interfaces/srv/SetParameters"
SET_PARAMETERS_ATOMICALLY = "rcl_interfaces/srv/SetParametersAtomically"
CHANGE_STATE = "lifecycle_msgs/srv/ChangeState"
CANCEL_GOAL = "action_msgs/srv/CancelGoal"
_SEND_GOAL, _GET_RESULT, _ATOMICALLY = "_SendGoal", "_GetResult", "set_parameters_atomically"

READING_TYPES = frozenset(
    {
        "rcl_interfaces/srv/DescribeParameters",
        "rcl_interfaces/srv/GetParameterTypes",
        "rcl_interfaces/srv/GetParameters",
        "rcl_interfaces/srv/ListParameters",
        "lifecycle_msgs/srv/GetAvailableStates",
        "lifecycle_msgs/srv/GetAvailableTransitions",
        "lifecycle_msgs/srv/GetState",
        "controller_manager_msgs/srv/ListControllers",
        "controller_manager_msgs/srv/ListHardwareComponents",
        "type_description_interfaces/srv/GetTypeDescription",
        "lora_msgs/srv/GetMessages",
        "wisevision_msgs/srv/InfluxGetMessages",
    }
)
"""The service types defined to read and to change nothing; the last two belong to the Data Black Box."""

META_TYPES: Sequence[str] = (
    "composition_interfaces/**",
    "controller_manager_msgs/**",
    "rcl_interfaces/srv/SetParameters",
    "rcl_interfaces/srv/SetParametersAtomically",
    "rcl_interfaces/srv/SetLoggerLevels",
    "lifecycle_msgs/srv/ChangeState",
    "nav2_msgs/srv/ManageLifecycleNodes",
    "nav2_msgs/srv/Toggle",
    "nav2_msgs/srv/LoadMap",
    "nav2_msgs/srv/SaveMap",
    "nav_msgs/srv/LoadMap",
    "nav_msgs/srv/SetMap",
    "slam_toolbox/**",
    "cartographer_ros_msgs/**",
    "rosbag2_interfaces/**",
    "topic_tools_interfaces/**",
    "rosapi_msgs/**",
    "rosbridge_msgs/**",
    "gazebo_msgs/**",
    "ros_gz_interfaces/**",
    "simulation_interfaces/**",
    "robot_localization/**",
    "diagnostic_msgs/srv/AddDiagnostics",
    "moveit_msgs/srv/LoadMap",
    "moveit_msgs/srv/SaveMap",
    "moveit_msgs/srv/ApplyPlanningScene",
    "moveit_msgs/srv/ChangeControlDimensions",
    "moveit_msgs/srv/ChangeDriftDimensions",
    "moveit_msgs/srv/SetPlannerParams",
    "moveit_msgs/srv/ServoCommandType",
    "mavros_msgs/srv/FileOpen",
    "mavros_msgs/srv/FileWrite",
    "mavros_msgs/srv/FileRemove",
    "mavros_msgs/srv/FileRename",
    "mavros_msgs/srv/FileTruncate",
    "mavros_msgs/srv/FileMakeDir",
    "mavros_msgs/srv/FileRemoveDir",
    "mavros_msgs/srv/ParamPush",
    "mavros_msgs/srv/ParamSet",
    "mavros_msgs/srv/ParamSetV2",
    "mavros_msgs/srv/CommandLong",
    "mavros_msgs/srv/CommandInt",
    "ur_dashboard_msgs/**",
    "webots_ros2_msgs/**",
    "rmw_dds_common/**",
    "*/action/*_SendGoal",
    "action_msgs/srv/CancelGoal",
)
"""The service types that change what else may happen: they load code, write files, switch controllers or safety
monitors, or are goals and cancellations under a name that is no action's. Only a rule with `meta: true` allows them,
whatever its patterns. Setting parameters and transitions have their own verbs.
"""


def segments_match(pattern: Sequence[str], name: Sequence[str], *, hidden: bool) -> bool:
    """Return whether segments match a pattern: `*` is any one segment, `**` any number of them, also none.

    A segment that begins with an underscore (hidden in ROS) matches a wildcard only if `hidden`.
    """
    # Whether the parts of the pattern so far match the first 0, 1, … segments. So the time is bounded for any pattern
    # and name.
    fits = [True, *(False for _ in name)]
    for part in pattern:
        if part == "**":
            for place, segment in enumerate(name):
                fits[place + 1] = fits[place + 1] or (fits[place] and (hidden or not segment.startswith("_")))
        else:
            is_fit = (fits[place] and _fits(part, segment, hidden) for place, segment in enumerate(name))
            fits = [False, *is_fit]
    return fits[-1]


def _fits(part: str, segment: str, hidden: bool) -> bool:
    """Return whether one segment matches one part of a pattern."""
    if part == "*":
        return hidden or not segment.startswith("_")
    return segment.endswith(part[1:]) if part.startswith("*") else segment == part  # `*_SendGoal`, of types alone


def matches(patterns: Sequence[str], name: str, *, hidden: bool = False) -> bool:
    """Return whether a full name or type matches one of the patterns, segment by segment."""
    parts = name.strip("/").split("/")
    return any(segments_match(pattern.strip("/").split("/"), parts, hidden=hidden) for pattern in patterns)


def only_reads(service_type: str) -> bool:
    """Return whether a service of that type reads and changes nothing; requesting the result of
    a goal counts as reading.
    """
    return service_type in READING_TYPES or ("/action/" in service_type and service_type.endswith(_GET_RESULT))


def is_meta(service_type: str) -> bool:
    """Return whether a service of that type changes what else may happen (`META_TYPES`)."""
    return matches(META_TYPES, service_type, hidden=True)


@dataclass(frozen=True)
class Meaning:
    """What calling a service means: the verb, and the name and type of what it acts on."""

    verb: Verb
    name: str
    type: str


def meaning(service: str, service_type: str) -> Meaning:
    """Return what calling a service of that name and type means, for any kind of call.

    Type and name both count: a service of such a type whose name is not that of an action or
    node is an ordinary `call`.
    """
    subject, _, last = service.rpartition("/")
    subject = subject or "/"
    if only_reads(service_type):
        return Meaning("read", service, service_type)
    if service.endswith("/_action/send_goal") and "/action/" in service_type and service_type.endswith(_SEND_GOAL):
        return Meaning("goal", subject[: -len("/_action")], service_type[: -len(_SEND_GOAL)])
    if service.endswith("/_action/cancel_goal") and service_type == CANCEL_GOAL:
        return Meaning("cancel", subject[: -len("/_action")], service_type)
    if (service_type, last) in ((SET_PARAMETERS, "set_parameters"), (SET_PARAMETERS_ATOMICALLY, _ATOMICALLY)):
        return Meaning("set", subject, service_type)
    if service_type == CHANGE_STATE and last == "change_state":
        return Meaning("transition", subject, service_type)
    return Meaning("call", service, service_type)
