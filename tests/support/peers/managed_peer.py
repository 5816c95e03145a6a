"""A base and an arm below a controller manager like that of ros2_control: a JSON list per line in, a JSON value out.

The manager says which controllers and hardware components are active. An inactive base ignores commands and an inactive
arm rejects goals, each with the line that the real controllers log; below hardware that is not active goals are
accepted, and nothing moves. With its motors off commands and goals are accepted, nothing moves, and the node of the
motors says why. No manager knows the flipper's driver, a lifecycle node that is unconfigured. The base's odometry is
transient_local, as that of a real diff_drive_controller. It knows ROS 2 and nothing of this project.
"""

from __future__ import annotations

import json
import sys
import threading
import time
from typing import Any

import rclpy
from builtin_interfaces.msg import Duration
from control_msgs.action import FollowJointTrajectory
from controller_manager_msgs.msg import ControllerState, HardwareComponentState, HardwareInterface
from controller_manager_msgs.srv import ListControllers, ListHardwareComponents
from geometry_msgs.msg import Twist
from lifecycle_msgs.msg import State
from nav_msgs.msg import Odometry
from rclpy.action import ActionClient, ActionServer, CancelResponse, GoalResponse
from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.executors import MultiThreadedExecutor
from rclpy.lifecycle import LifecycleNode
from rclpy.node import Node
from rclpy.qos import QoSDurabilityPolicy, QoSProfile
from rclpy.signals import SignalHandlerOptions
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray, String
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

STEP_S = 0.02
LATCHED = QoSProfile(depth=1, durability=QoSDurabilityPolicy.TRANSIENT_LOCAL)
DESCRIPTION = """<robot name="arm"><link name="base_link"><collision><geometry><cylinder radius="0.2" length="0.2"/>
</geometry></collision></link><link name="upper"/><joint name="shoulder" type="revolute"><parent link="base_link"/>
<child link="upper"/><axis xyz="0 0 1"/><limit lower="-3" upper="3" velocity="1" effort="1"/></joint></robot>"""
CONTROLLERS = {
    "base_controller": ("diff_drive_controller/DiffDriveController", ["left_wheel/velocity"]),
    "arm_controller": ("joint_trajectory_controller/JointTrajectoryController", ["limiter/shoulder/position"]),
    "limiter": ("admittance_controller/AdmittanceController", ["shoulder/position"]),
    "grip_controller": ("forward_command_controller/ForwardCommandController", ["finger/effort"]),
    "joint_state_broadcaster": ("joint_state_broadcaster/JointStateBroadcaster", []),
}
HARDWARE = {"BaseHW": ["left_wheel/velocity"], "ArmHW": ["shoulder/position"], "GripHW": ["finger/effort"]}
"""Each with the command interfaces that it has."""


class Robot:
    """Its public methods are the commands."""

    def __init__(self) -> None:
        rclpy.init(signal_handler_options=SignalHandlerOptions.NO)
        self._state = dict.fromkeys(CONTROLLERS, "active")
        self._hardware = dict.fromkeys(HARDWARE, "active")
        self._speed = self._x = self._at = self._target = 0.0
        self._result_late_s = 0.0
        self._cancels = 0
        self._motors_off = False
        self._nodes = {name: Node(name) for name in ("controller_manager", "motor_driver", *CONTROLLERS)}
        host, base, arm = (self._nodes[name] for name in ("controller_manager", "base_controller", "arm_controller"))
        host.create_service(ListControllers, "~/list_controllers", self._list_controllers)
        host.create_service(ListHardwareComponents, "~/list_hardware_components", self._list_hardware)
        self._odometry = base.create_publisher(Odometry, "/odom", LATCHED)
        base.create_subscription(Twist, "/cmd_vel", self._on_velocity, 10)
        grip = self._nodes["grip_controller"]
        grip.create_subscription(Float64MultiArray, "/grip_controller/commands", lambda _: None, 10)
        arm.declare_parameter("joints", ["shoulder"])
        self._server = ActionServer(
            arm,
            FollowJointTrajectory,
            "~/follow_joint_trajectory",
            execute_callback=self._follow,
            goal_callback=self._judge,
            cancel_callback=self._on_cancel,
            callback_group=ReentrantCallbackGroup(),
        )
        self._joints = self._nodes["joint_state_broadcaster"].create_publisher(JointState, "/joint_states", 10)
        self._description = host.create_publisher(String, "/robot_description", LATCHED)
        self._description.publish(String(data=DESCRIPTION))
        other = Node("another_client")
        self._client = ActionClient(other, FollowJointTrajectory, "/arm_controller/follow_joint_trajectory")
        self._sent: Any = None
        flipper = LifecycleNode("flipper_driver")
        flipper.create_subscription(Float64MultiArray, "/flipper/commands", lambda _: None, 10)
        executor = MultiThreadedExecutor()
        executor.add_node(flipper)
        for node in (*self._nodes.values(), other):
            executor.add_node(node)
        threading.Thread(target=executor.spin, daemon=True).start()
        threading.Thread(target=self._live, daemon=True).start()

    def put(self, result_late_s: float = 0.0, *, motors_off: bool = False, **states: str) -> None:
        """All active but these controllers and hardware components; the arm's results come so late."""
        self._motors_off = motors_off
        for name in CONTROLLERS:
            self._state[name] = states.get(name, "active")
        for name in HARDWARE:
            self._hardware[name] = states.get(name, "active")
        self._result_late_s = result_late_s
        self._speed, self._cancels = 0.0, 0

    def send(self, target: float, seconds: int) -> str:
        """Send the arm a goal as another client does; its id, once it is accepted."""
        goal = FollowJointTrajectory.Goal()
        point = JointTrajectoryPoint(positions=[target], time_from_start=Duration(sec=seconds))
        goal.trajectory = JointTrajectory(joint_names=["shoulder"], points=[point])
        sent = self._client.send_goal_async(goal)
        while not sent.done():
            time.sleep(STEP_S)
        self._sent = sent.result()
        return bytes(self._sent.goal_id.uuid).hex()

    def cancel(self) -> None:
        """Cancel that goal, and wait for its end."""
        ended = self._sent.get_result_async()
        self._sent.cancel_goal_async()
        while not ended.done():
            time.sleep(STEP_S)

    def cancels(self) -> int:
        """How many cancellations came since `put`."""
        return self._cancels

    def _on_cancel(self, _: Any) -> CancelResponse:
        self._cancels += 1
        return CancelResponse.ACCEPT

    def _list_controllers(self, _: Any, answer: Any) -> Any:
        for name, (kind, interfaces) in CONTROLLERS.items():
            is_active = self._state[name] == "active"
            claimed = interfaces if is_active else []
            answer.controller.append(
                ControllerState(
                    name=name,
                    state=self._state[name],
                    type=kind,
                    claimed_interfaces=claimed,
                    required_command_interfaces=interfaces,
                )
            )
        return answer

    def _list_hardware(self, _: Any, answer: Any) -> Any:
        for name, interfaces in HARDWARE.items():
            there = [HardwareInterface(name=one, is_available=self._hardware[name] == "active") for one in interfaces]
            state = State(label=self._hardware[name])
            answer.component.append(HardwareComponentState(name=name, state=state, command_interfaces=there))
        return answer

    def _on_velocity(self, command: Twist) -> None:
        if self._state["base_controller"] != "active":
            self._nodes["base_controller"].get_logger().warning("Can't accept new commands. subscriber is inactive")
        elif self._has_power() and self._hardware["BaseHW"] == "active":
            self._speed = command.linear.x

    def _has_power(self) -> bool:
        if self._motors_off:
            self._nodes["motor_driver"].get_logger().warning("motors are disabled: release the emergency stop")
        return not self._motors_off

    def _judge(self, _: Any) -> GoalResponse:
        if self._state["arm_controller"] == "active":
            return GoalResponse.ACCEPT
        text = "Can't accept new action goals. Controller is not running."
        self._nodes["arm_controller"].get_logger().error(text)
        return GoalResponse.REJECT

    def _follow(self, handle: Any) -> Any:
        point = handle.request.trajectory.points[-1]
        takes_s = point.time_from_start.sec + point.time_from_start.nanosec * 1e-9
        end, moves = time.monotonic() + takes_s, self._has_power() and self._hardware["ArmHW"] == "active"
        start, target = self._at, point.positions[0]
        while time.monotonic() < end:
            if handle.is_cancel_requested:
                handle.canceled()
                return FollowJointTrajectory.Result(error_code=0)
            if moves:
                self._at = target + (start - target) * max(0.0, end - time.monotonic()) / takes_s
            time.sleep(STEP_S)
        self._at = target if moves else self._at
        time.sleep(self._result_late_s)
        if not moves:
            handle.abort()
            return FollowJointTrajectory.Result(error_code=-4, error_string="shoulder path error")
        handle.succeed()
        return FollowJointTrajectory.Result(error_code=0)

    def _live(self) -> None:
        while True:
            time.sleep(STEP_S)
            self._x += self._speed * STEP_S
            stamp = self._nodes["base_controller"].get_clock().now().to_msg()
            if self._state["base_controller"] == "active":
                odometry = Odometry(child_frame_id="base_link")
                odometry.header.frame_id, odometry.header.stamp = "odom", stamp
                odometry.pose.pose.position.x = self._x
                odometry.pose.pose.orientation.w = 1.0
                odometry.twist.twist.linear.x = self._speed
                self._odometry.publish(odometry)
            joints = JointState(name=["shoulder"], position=[self._at])
            joints.header.stamp = stamp
            self._joints.publish(joints)


def main() -> None:
    robot = Robot()
    print('"ready"', flush=True)
    for line in sys.stdin:
        command, arguments = json.loads(line)
        print(json.dumps(getattr(robot, command)(**arguments)), flush=True)


if __name__ == "__main__":
    main()
