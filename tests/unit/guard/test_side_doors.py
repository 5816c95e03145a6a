"""What moves or changes a robot by a way that nobody thinks of is decided alike, whichever way it is asked for.

Each is asked of the server as every command that can mean it, and of the bridge as every request that can carry it.
"""

from __future__ import annotations

import itertools
import json
import random
import re
from collections import Counter
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("rclpy", reason="needs the ROS 2 wheels, for the bridge's side")

from ros2_mcp.guard.policy import Policy
from ros2_mcp.guard.policy_file import PROFILES, compiled, document_of
from ros2_mcp.model import names
from ros2_mcp.model.commands import (
    ChangeState,
    Command,
    Feed,
    Move,
    Play,
    Publish,
    Relay,
    Repeat,
    SendGoal,
    SetParameters,
)
from ros2_mcp.model.errors import BadName
from ros2_mcp.model.qos import QoS
from ros2_mcp_bridge.exit.limiter import Limiter
from ros2_mcp_bridge.request import OperationError, Request
from ros2_mcp_common.policy.verbs import meaning
from support.aliases import KINDS, aliases
from support.limits import without_limiter
from support.noting_bridge import CHOICE, GOAL_ID, LOCAL, call

WIDE = """
policy: 1
name: wide
allow:
  - {publish: "/**/cmd_vel", types: [geometry_msgs/msg/Twist, geometry_msgs/msg/TwistStamped]}
  - {relay: "/**/cmd_vel", types: [geometry_msgs/msg/Twist], from: /teleop}
  - {play: "/**/cmd_vel", types: [geometry_msgs/msg/Twist]}
  - {call: "/**", type: "**"}
"""
"""All services, as somebody may write who does not know what they can do."""
SERVICES = {
    "/container/_container/load_node": "composition_interfaces/srv/LoadNode",
    "/container/_container/unload_node": "composition_interfaces/srv/UnloadNode",
    "/driver/set_parameters": "rcl_interfaces/srv/SetParameters",
    "/driver/set_parameters_atomically": "rcl_interfaces/srv/SetParametersAtomically",
    "/driver/set_logger_levels": "rcl_interfaces/srv/SetLoggerLevels",
    "/driver/change_state": "lifecycle_msgs/srv/ChangeState",
    "/lifecycle_manager/manage_nodes": "nav2_msgs/srv/ManageLifecycleNodes",
    "/collision_monitor/toggle": "nav2_msgs/srv/Toggle",
    "/map_server/load_map": "nav2_msgs/srv/LoadMap",
    "/map_saver/save_map": "nav2_msgs/srv/SaveMap",
    "/set_map": "nav_msgs/srv/SetMap",
    "/load": "nav_msgs/srv/LoadMap",
    "/controller_manager/switch_controller": "controller_manager_msgs/srv/SwitchController",
    "/controller_manager/load_controller": "controller_manager_msgs/srv/LoadController",
    "/controller_manager/unload_controller": "controller_manager_msgs/srv/UnloadController",
    "/controller_manager/set_hardware_component_state": "controller_manager_msgs/srv/SetHardwareComponentState",
    "/slam_toolbox/save_map": "slam_toolbox/srv/SaveMap",
    "/slam_toolbox/serialize_map": "slam_toolbox/srv/SerializePoseGraph",
    "/cartographer/write_state": "cartographer_ros_msgs/srv/WriteState",
    "/rosbag2_player/play_next": "rosbag2_interfaces/srv/PlayNext",
    "/rosbag2_player/set_rate": "rosbag2_interfaces/srv/SetRate",
    "/rosbag2_recorder/resume": "rosbag2_interfaces/srv/Resume",
    "/rosapi/set_param": "rosapi_msgs/srv/SetParam",
    "/rosapi/delete_param": "rosapi_msgs/srv/DeleteParam",
    "/mux/select": "topic_tools_interfaces/srv/MuxSelect",
    "/mux/add": "topic_tools_interfaces/srv/MuxAdd",
    "/spawn_entity": "gazebo_msgs/srv/SpawnEntity",
    "/set_entity_state": "gazebo_msgs/srv/SetEntityState",
    "/world/default/control": "ros_gz_interfaces/srv/ControlWorld",
    "/ekf/set_pose": "robot_localization/srv/SetPose",
    "/apply_planning_scene": "moveit_msgs/srv/ApplyPlanningScene",
    "/servo_node/switch_command_type": "moveit_msgs/srv/ServoCommandType",
    "/mavros/cmd/command": "mavros_msgs/srv/CommandLong",
    "/mavros/cmd/command_int": "mavros_msgs/srv/CommandInt",
    "/mavros/param/set": "mavros_msgs/srv/ParamSetV2",
    "/mavros/ftp/write": "mavros_msgs/srv/FileWrite",
    "/dashboard_client/power_on": "ur_dashboard_msgs/srv/Load",
    "/add_diagnostics": "diagnostic_msgs/srv/AddDiagnostics",
    "/navigate_to_pose/_action/send_goal": "nav2_msgs/action/NavigateToPose_SendGoal",
    "/backup/_action/send_goal": "nav2_msgs/action/BackUp_SendGoal",
    "/arm/follow_joint_trajectory/_action/send_goal": "control_msgs/action/FollowJointTrajectory_SendGoal",
    "/odd_name": "nav2_msgs/action/BackUp_SendGoal",
    "/other": "action_msgs/srv/CancelGoal",
    "/set_parameters_of_mine": "rcl_interfaces/srv/SetParameters",
}
TOPICS = {
    "/goal_pose": "geometry_msgs/msg/PoseStamped",
    "/initialpose": "geometry_msgs/msg/PoseWithCovarianceStamped",
    "/scan": "sensor_msgs/msg/LaserScan",
    "/odom": "nav_msgs/msg/Odometry",
    "/tf": "tf2_msgs/msg/TFMessage",
    "/clock": "rosgraph_msgs/msg/Clock",
    "/map": "nav_msgs/msg/OccupancyGrid",
    "/joy": "sensor_msgs/msg/Joy",
    "/twist_mux/lock": "std_msgs/msg/Bool",
    "/robot_description": "std_msgs/msg/String",
    "/arm_controller/joint_trajectory": "trajectory_msgs/msg/JointTrajectory",
    "/velocity_controller/commands": "std_msgs/msg/Float64MultiArray",
    "/servo_node/delta_joint_cmds": "control_msgs/msg/JointJog",
    "/base/force": "geometry_msgs/msg/Wrench",
    "/mavros/setpoint_raw/local": "mavros_msgs/msg/PositionTarget",
    "/fmu/in/trajectory_setpoint": "px4_msgs/msg/TrajectorySetpoint",
    "/cmd_vel_smoothed": "geometry_msgs/msg/Twist",
    "/diff_drive_controller/cmd_vel_unstamped": "geometry_msgs/msg/Twist",
    "/backup/_action/feedback": "nav2_msgs/action/BackUp_FeedbackMessage",
    "/parameter_events": "rcl_interfaces/msg/ParameterEvent",
}
ALIASES = 5_000
LOOSE = {"lab"}
"""Profiles that are meant to allow many of them, some with a person's consent."""
PURPOSES = {
    ("nav", "/navigate_to_pose/_action/send_goal"),
    ("arm-slow", "/arm/follow_joint_trajectory/_action/send_goal"),
}
"""What a profile is for."""


def policies() -> dict[str, Policy]:
    texts = {name: Path(path).read_text(encoding="utf-8") for name, path in PROFILES.items()} | {"wide": WIDE}
    documents = {name: document_of(text, name) for name, text in texts.items()}
    return {name: Policy(documents=[document], rules=compiled([document])) for name, document in documents.items()}


POLICIES = policies()


def limiter_of(policy: Policy) -> Limiter:
    limiter = Limiter(True)
    assert policy.rules
    limiter.take(json.dumps(policy.rules.as_json()).encode())
    return limiter


def by_service(service: str, kind: str) -> list[Command[Any]]:
    """Every command that asks for this request."""
    through: dict[str, Any] = {"principal": LOCAL, "timeout_s": 1.0, "value": {}}
    ways: list[Command[Any]] = [call(kind, service, {})]
    meant = meaning(service, kind)
    if meant.verb == "set":
        ways.append(SetParameters(name=meant.name, type=kind, through=service, parameters={}, **through))
    elif meant.verb == "transition":
        ways.append(ChangeState(name=meant.name, type=kind, through=service, transition="configure", **through))
    elif meant.verb == "goal":
        ways.append(SendGoal(name=meant.name, type=meant.type, goal_id=GOAL_ID, **through))
    return ways


def by_topic(topic: str, kind: str) -> dict[str, Command[Any]]:
    """Every command that publishes, by the request that carries it."""
    on: dict[str, Any] = {"principal": LOCAL, "name": topic, "type": kind, "wait_match_s": 0.0}
    return {
        "publish": Publish(choice=CHOICE, **on),
        "repeat": Repeat(choice=CHOICE, **on),
        "move": Move(choice=CHOICE, controller={"kind": "drive"}, **on),
        "relay from": Relay(relay_id="r", qos=QoS(), source="/teleop", duration_s=5.0, **on),
        "relay": Play(relay_id="r", qos=QoS(), bag="b", topic=topic, **on),
        "fed": Feed(principal=LOCAL, name=topic, type=kind, relay_id="r"),
    }


def server_says(policy: Policy, command: Command[Any]) -> bool:
    return policy.decide(command).verdict != "refused"


def bridge_says(limiter: Limiter, op: str, **header: str) -> bool:
    """Whether name and type may leave; what a value of them may be is not the question here."""
    request = Request({"id": 1, "op": op.partition(" ")[0], "qos": {}, **header}, b"")
    try:
        limiter.topic(request) if "topic" in header else limiter.calling(request)
    except OperationError as refused:
        assert refused.kind == "refused"
        return False
    return True


@pytest.mark.parametrize("name", POLICIES)
def test_a_service_is_decided_alike_by_every_way(name: str) -> None:
    policy, limiter = POLICIES[name], limiter_of(POLICIES[name])
    for service, kind in SERVICES.items():
        said = {server_says(policy, command) for command in by_service(service, kind)}
        if name not in LOOSE and (name, service) not in PURPOSES:
            assert said == {False}, service
        # a value is asked for only where the name may pass, so that the bridge may be stricter there, and never laxer
        assert bridge_says(limiter, "call", service=service, type=kind) in ({True, False} if said == {True} else said)


@pytest.mark.parametrize("name", POLICIES)
def test_a_topic_is_decided_alike_by_every_way(name: str) -> None:
    policy, limiter = POLICIES[name], limiter_of(POLICIES[name])
    for topic, kind in TOPICS.items():
        for op, command in by_topic(topic, kind).items():
            source = {"source": "/teleop"} if op == "relay from" else {}
            ours = bridge_says(limiter, "relay" if op == "fed" else op, topic=topic, type=kind, **source)
            theirs = server_says(policy, command)
            assert ours == theirs or (op in ("relay", "fed") and ours), (topic, op)
            if name not in LOOSE and not topic.startswith("/mavros") and not topic.startswith("/arm"):
                assert not (ours or theirs), (topic, op)


def resolved(name: str, kind: str) -> tuple[str, str] | None:
    """What the server takes a name and a type for; None where it takes them for nothing."""
    try:
        return names.absolute(name), names.interface_type(kind, "msg")
    except BadName:
        return None


def test_a_spelling_is_decided_as_what_it_is_resolved_to_in_server_and_bridge() -> None:
    """Whatever is allowed is a `cmd_vel` of a type with limits, and is called so where the bridge is asked."""
    policy = POLICIES["wide"]
    limiter, counts = limiter_of(policy), Counter[str]()
    for name, kind, is_right in itertools.islice(aliases(random.Random(5)), ALIASES):
        meant = resolved(name, kind)
        assert meant or not is_right
        if meant is None:
            counts["no name"] += 1
            continue
        for op, command in by_topic(*meant).items():
            if op == "fed":
                continue
            source = {"source": "/teleop"} if op == "relay from" else {}
            ours = bridge_says(limiter, op, topic=meant[0], type=meant[1], **source)
            assert ours == server_says(policy, command) or (op == "relay" and ours), (meant, op)
            assert not ours or (re.fullmatch(r"(/[a-z]\w*)*/cmd_vel", meant[0]) and meant[1] in KINDS), meant
            counts["allowed" if ours else "refused"] += 1
    assert min(counts[what] for what in ("no name", "allowed", "refused")) > ALIASES / 10, counts


def test_there_are_sixty_and_more() -> None:
    assert len(SERVICES) + len(TOPICS) >= 60


def test_without_the_limiter_they_would_be_noticed() -> None:
    with without_limiter():
        assert bridge_says(limiter_of(POLICIES["wide"]), "publish", topic="/joy", type=TOPICS["/joy"])
