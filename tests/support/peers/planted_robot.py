"""A robot that is well, with what looks like a fault and is none, until a line comes on its input: then it has every
fault that a health check is to name, each on a node or a topic of its own.
"""

from __future__ import annotations

import contextlib
import math
import sys
import threading

import rclpy
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from nav_msgs.msg import Odometry
from rcl_interfaces.msg import ParameterDescriptor
from rclpy.action import ActionServer
from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor
from rclpy.lifecycle import LifecycleNode
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.qos import DurabilityPolicy, QoSProfile
from sensor_msgs.msg import FluidPressure, JointState, LaserScan
from std_msgs.msg import String
from std_srvs.srv import Empty, Trigger
from test_msgs.action import Fibonacci

from support.leaving import leave_on_sigterm

LATCHED = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)


class Robot:
    """Its nodes, and what each publishes now."""

    def __init__(self) -> None:
        self.executor = SingleThreadedExecutor()
        self.kept: list[object] = []
        self.is_planted = False
        base, lidar, arm = self.node("base"), self.node("lidar"), self.node("arm")
        self.odometry = base.create_publisher(Odometry, "odom", 10)
        self.scan = lidar.create_publisher(LaserScan, "scan", 10)
        self.pressure = lidar.create_publisher(FluidPressure, "pressure", 10)
        self.diagnostics = base.create_publisher(DiagnosticArray, "/diagnostics", 10)
        self.joints = [arm.create_publisher(JointState, "joint_states", 10)]
        self.kept += [
            base.create_publisher(String, "news", 10),
            base.create_service(Trigger, "reset", lambda _request, response: response),
            base.create_timer(0.1, self.tick),
            base.create_timer(0.5, self.report),
            base.create_publisher(String, "map_name", LATCHED),
        ]
        self.kept[-1].publish(String(data="hall"))
        within = ParameterDescriptor(description="Share of the speed, between 0 and 1")
        self.kept.append(base.declare_parameter("share", 0.5, within))
        self.lifecycle("driver_that_works")

    def node(self, name: str, **options: object) -> Node:
        made = Node(name, **options)
        self.executor.add_node(made)
        self.kept.append(made)
        return made

    def lifecycle(self, name: str, *, works: bool = True) -> None:
        made = LifecycleNode(name)
        self.executor.add_node(made)
        self.kept.append(made)
        if works:
            made.trigger_configure()
            made.trigger_activate()

    def tick(self) -> None:
        """Ten times a second."""
        odometry = Odometry()
        odometry.pose.pose.orientation.w = 1.0
        odometry.pose.pose.position.x = math.nan if self.is_planted else 1.0
        self.odometry.publish(odometry)
        self.scan.publish(LaserScan())
        for at, publisher in enumerate(self.joints):
            publisher.publish(JointState(name=["elbow"], position=[float(at)]))
        if not self.is_planted:
            self.pressure.publish(FluidPressure())

    def report(self) -> None:
        """Twice a second."""
        state = "unconfigured" if self.is_planted else "active"
        status = DiagnosticStatus(name="hardware: parts", message="all parts told", level=DiagnosticStatus.OK)
        status.values = [KeyValue(key="ArmHW", value=state)]
        self.diagnostics.publish(DiagnosticArray(status=[status]))

    def plant(self) -> None:
        """Everything at once."""
        first, second = self.node("driver_a"), self.node("driver_b")
        for each in (first, second):
            self.kept.append(each.create_service(Trigger, "home", lambda _request, response: response))
            self.kept.append(ActionServer(each, Fibonacci, "dock", lambda goal: goal.succeed() or Fibonacci.Result()))
        self.kept.append(first.create_service(Trigger, "tare", lambda _request, response: response))
        self.joints.append(self.node("second_arm").create_publisher(JointState, "joint_states", 10))
        simulated = [Parameter("use_sim_time", Parameter.Type.BOOL, True)]
        self.node("by_another_clock", parameter_overrides=simulated)
        self.lifecycle("driver_never_configured", works=False)
        tuned = self.node("tuned")
        described = ParameterDescriptor(description="Share of the speed, between 0 and 1")
        self.kept.append(tuned.declare_parameter("share", 1.5, described))
        self.kept.append(first.create_publisher(String, "chatter", 10))
        self.kept.append(second.create_subscription(String, "chatter_remapped", lambda _: None, 10))
        waiting = self.node("waits_for_description")
        self.kept.append(waiting.create_subscription(String, "robot_description", lambda _: None, LATCHED))
        self.kept.append(waiting.create_publisher(JointState, "gripper/joint_states", 10))
        self.is_planted = True


def main() -> None:
    leave_on_sigterm()
    rclpy.init()
    if "rival" in sys.argv:  # a process of its own: Fast DDS refuses two types of one name in one process
        rival = Node("rival")
        service = rival.create_service(Empty, "tare", lambda _request, response: response)
        print("ready", service.service_name, flush=True)
        sys.stdin.read()
        rclpy.try_shutdown()
        return
    robot = Robot()

    def spin() -> None:
        with contextlib.suppress(ExternalShutdownException):
            robot.executor.spin()

    spinning = threading.Thread(target=spin)
    spinning.start()
    print("ready", flush=True)
    for _ in sys.stdin:
        robot.executor.create_task(robot.plant)
    rclpy.try_shutdown()
    spinning.join()


if __name__ == "__main__":
    main()
