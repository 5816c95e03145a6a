"""What moves a robot, as its graph tells: by type, by name, and whether a controller takes it now."""

from __future__ import annotations

from collections.abc import Sequence

from ros2_mcp.model.graph import TopicEndpoints
from ros2_mcp.model.qos import Endpoint, QoS
from ros2_mcp.ops.sources.source import GraphSnapshot
from ros2_mcp.ops.space.inputs import (
    CommandInput,
    command_inputs,
    drive_types,
    orders_by_service,
    other_actions,
    topics_without_publisher,
)
from ros2_mcp.ops.space.lines import Named

FLOATS, TRAJECTORY = "std_msgs/msg/Float64MultiArray", "trajectory_msgs/msg/JointTrajectory"


def heard(topic: str, kind: str, node: str, *senders: str) -> TopicEndpoints:
    def end(name: str) -> Endpoint:
        return Endpoint(name, kind, "", "", QoS())

    return TopicEndpoints(topic, list(map(end, senders)), [end(node)])


def graph(*topics: TopicEndpoints) -> GraphSnapshot:
    return GraphSnapshot({one.topic: one for one in topics}, [], {})


def lines(things: Sequence[CommandInput | Named]) -> list[str]:
    return [one.line for one in things]


def test_types_that_are_for_anything_command_by_the_name_of_their_topic() -> None:
    found = command_inputs(
        graph(
            heard("/goal_pose", "geometry_msgs/msg/PoseStamped", "/bt_navigator"),
            heard("/initial_guess", "geometry_msgs/msg/PoseStamped", "/localiser"),
            heard("/commands/motor/speed", "std_msgs/msg/Float64", "/vesc"),
            heard("/temperature", "std_msgs/msg/Float64", "/logger"),
            heard("/cmd_vel", "geometry_msgs/msg/Twist", "/base", "/smoother"),
        ),
        {},
    )
    assert lines(found) == [
        "/cmd_vel Twist → /base (from /smoother)",
        "/goal_pose PoseStamped (goal) → /bt_navigator",
        "/commands/motor/speed Float64 (low level) → /vesc",
    ]


def test_the_input_of_a_controller_that_is_not_active_says_so_and_comes_last() -> None:
    arm, other = "/arm_controller", "/forward_controller"
    present = graph(heard(f"{arm}/joint_trajectory", TRAJECTORY, arm), heard(f"{other}/commands", FLOATS, other))
    states = [{"name": "arm_controller", "state": "inactive"}, {"name": "forward_controller", "state": "active"}]
    assert lines(command_inputs(present, {"/controller_manager": states})) == [
        "/forward_controller/commands Float64MultiArray (low level) → /forward_controller",
        "/arm_controller/joint_trajectory JointTrajectory → /arm_controller, not active",
    ]


def test_movements_come_before_goals_and_goals_before_lower_inputs() -> None:
    action, kind = "/nav/navigate_to_pose", "nav2_msgs/action/NavigateToPose"
    server = Endpoint("/bt_navigator", f"{kind}_FeedbackMessage", "", "", QoS())
    found = command_inputs(
        graph(
            heard("/thrust", "std_msgs/msg/Float32", "/hull"),
            heard("/spot/body_pose", "geometry_msgs/msg/Pose", "/spot"),
            TopicEndpoints(f"{action}/_action/feedback", [server], []),
            heard("/base/reference", "geometry_msgs/msg/TwistStamped", "/base"),
            heard("/arm/servo_node/delta_twist_cmds", "geometry_msgs/msg/TwistStamped", "/servo_node"),
            heard("/place", "geometry_msgs/msg/Pose", "/logger"),
            heard("/wheel/speed", "std_msgs/msg/Float64", "/logger", "/driver"),  # that is told, and not waited for
        ),
        {},
    )
    assert lines(found) == [
        "/base/reference TwistStamped → /base",
        "/arm/servo_node/delta_twist_cmds TwistStamped → /servo_node",
        "/nav/navigate_to_pose NavigateToPose (action) → /bt_navigator",
        "/spot/body_pose Pose (pose) → /spot",
        "/thrust Float32 (low level) → /hull",
    ]
    assert drive_types(found) == ["geometry_msgs/msg/TwistStamped"]  # that of the base: a hand is none


def action(name: str, kind: str, server: str) -> TopicEndpoints:
    end = Endpoint(server, f"{kind}_FeedbackMessage", "", "", QoS())
    return TopicEndpoints(f"{name}/_action/feedback", [end], [])


def test_what_a_driver_tells_is_no_input_and_turning_alone_and_joysticks_are_told_as_such() -> None:
    found = command_inputs(
        graph(
            heard("/sensors/servo_position_command", "std_msgs/msg/Float64", "/odometry", "/vesc"),
            heard("/uav/setpoint_attitude/cmd_vel", "geometry_msgs/msg/TwistStamped", "/uav"),
            heard("/uav/setpoint_velocity/cmd_vel", "geometry_msgs/msg/TwistStamped", "/uav"),
            heard("/joy", "sensor_msgs/msg/Joy", "/teleop", "/joy_node"),
            heard("/joint_command", "sensor_msgs/msg/JointState", "/simulator"),
            heard("/joint_states", "sensor_msgs/msg/JointState", "/robot_state_publisher", "/simulator"),
        ),
        {},
    )
    assert lines(found) == [
        "/uav/setpoint_velocity/cmd_vel TwistStamped → /uav",
        "/uav/setpoint_attitude/cmd_vel TwistStamped (body rates) → /uav",
        "/joint_command JointState (joints) → /simulator",
        "/joy Joy (joystick) → /teleop (from /joy_node)",
    ]


def test_actions_that_move_it_are_inputs_and_others_are_named() -> None:
    arm = "/arm_controller/follow_joint_trajectory"
    present = graph(
        heard("/arm_controller/joint_trajectory", TRAJECTORY, "/arm_controller"),
        action(arm, "control_msgs/action/FollowJointTrajectory", "/arm_controller"),
        action("/gripper/cmd", "control_msgs/action/GripperCommand", "/gripper"),
        action("/move_action", "moveit_msgs/action/MoveGroup", "/move_group"),
        *(action(f"/{name}", f"nav2_msgs/action/{name}", "/behaviors") for name in ("Spin", "BackUp", "Wait")),
        action("/undock", "maker_msgs/action/Undock", "/dock"),
    )
    found = command_inputs(present, {"/controller_manager": [{"name": "gripper", "state": "inactive"}]})
    assert lines(found) == [
        "/move_action MoveGroup (action) → /move_group",
        f"{arm} FollowJointTrajectory (action, or topic joint_trajectory) → /arm_controller",
        "/gripper/cmd GripperCommand (action) → /gripper, not active",
    ]
    assert lines(other_actions(present, found)) == [
        "/undock Undock → /dock",
        "/Spin Spin → /behaviors",
        "/BackUp BackUp → /behaviors",
        "/Wait Wait → /behaviors",
    ], "those that every Nav2 has are needed least"


def test_topics_on_which_somebody_waits_for_orders_are_named_and_sensors_that_are_missing_are_not() -> None:
    present = graph(
        heard("/cmd_vel", "geometry_msgs/msg/Twist", "/driver"),
        heard("/joint_angles", "naoqi_bridge_msgs/msg/JointAnglesWithSpeed", "/driver"),
        heard("/initialpose", "geometry_msgs/msg/PoseWithCovarianceStamped", "/amcl"),
        heard("/setpoint_raw/local", "mavros_msgs/msg/PositionTarget", "/mavros", "/planner"),
        heard("/scan", "sensor_msgs/msg/LaserScan", "/slam"),
        heard("/speech", "std_msgs/msg/String", "/driver"),
        heard("/chatter", "std_msgs/msg/String", "/listener", "/talker"),
    )
    assert lines(topics_without_publisher(present, command_inputs(present, {}))) == [
        "/setpoint_raw/local PositionTarget → /mavros",
        "/joint_angles JointAnglesWithSpeed → /driver",
        "/initialpose PoseWithCovarianceStamped → /amcl",
        "/speech String → /driver",
    ]


def test_of_many_senders_the_first_three_are_named() -> None:
    present = graph(heard("/cmd_vel", "geometry_msgs/msg/Twist", "/base", "/a", "/b", "/c", "/d"))
    told = lines(command_inputs(present, {}))
    assert told == ["/cmd_vel Twist → /base (from /a, /b, /c and 1 more)"]


def test_services_by_which_a_robot_is_told_to_do_something_are_named_and_those_of_programs_are_not() -> None:
    services = {
        "/spot/stand": ["std_srvs/srv/Trigger"],
        "/spot/sit": ["std_srvs/srv/Trigger"],
        "/spot/get_parameters": ["rcl_interfaces/srv/GetParameters"],
        "/spot/list_graphs": ["spot_msgs/srv/ListGraph"],
        "/manager/list_controllers": ["controller_manager_msgs/srv/ListControllers"],
        "/mavros/set_mode": ["mavros_msgs/srv/SetMode"],
    }
    found = orders_by_service(GraphSnapshot({}, [], services))
    assert lines(found) == ["/mavros/set_mode SetMode", "/spot/sit Trigger", "/spot/stand Trigger"]
