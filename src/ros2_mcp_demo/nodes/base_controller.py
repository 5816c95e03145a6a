"""/base_controller: follows velocity commands; publishes odometry, wheel angles and the robot's mode."""

# pyright: basic
from __future__ import annotations

import math
import time

from geometry_msgs.msg import Twist
from nav_msgs.msg import Odometry
from sensor_msgs.msg import JointState
from std_msgs.msg import String
from std_srvs.srv import SetBool, Trigger

from .. import optional
from ..base import Pose
from ..simulation import AUTONOMOUS, MANUAL, MODES
from .convert import diagonal, place, transform
from .part import OK, WARN, RobotPart

POSE_COVARIANCE = diagonal(6, {0: 1e-3, 1: 1e-3, 2: 1e6, 3: 1e6, 4: 1e6, 5: 3e-3})
TWIST_COVARIANCE = diagonal(6, {0: 1e-4, 1: 1e6, 2: 1e6, 3: 1e6, 4: 1e6, 5: 4e-4})


class BaseController(RobotPart):
    """The driver of the differential-drive base."""

    def __init__(self, robot, namespace):
        super().__init__("base_controller", robot, namespace)
        self.declare_number("max_linear_speed", 0.5, 0.0, 1.0, "Fastest driving speed [m/s]")
        self.declare_number("max_angular_speed", 1.5, 0.0, 3.0, "Fastest turning speed [rad/s]")
        self.declare_number("cmd_vel_timeout", 0.5, 0.1, 5.0, "Stop when no command came for so long [s]")
        self.declare_number("odom_rate", 25.0, 1.0, 50.0, "Rate of /odom, /tf and /joint_states [Hz]")
        self.declare_fact("serial_number", "RB1-000742", "Serial number of the base")
        self._commanded_at = -math.inf
        self._commanded = (0.0, 0.0)
        self._odometry = Odometry(child_frame_id=self.frame("base_link"))
        self._odometry.pose.covariance = POSE_COVARIANCE
        self._odometry.twist.covariance = TWIST_COVARIANCE
        self._joint_state = JointState(name=[self.frame("left_wheel_joint"), self.frame("right_wheel_joint")])
        self._odom = self.create_publisher(Odometry, "odom", 10)
        self._joints = self.create_publisher(JointState, "joint_states", 10)
        self._tf = optional.tf2_msgs and self.create_publisher(optional.tf2_msgs.TFMessage, "/tf", 100)
        self._mode = self.create_latched_publisher(String, "mode")
        self._published_mode = None
        self.create_subscription(Twist, "cmd_vel", self._on_command, 10)
        self.create_subscription(Twist, "cmd_vel_nav", self._on_navigation_command, 10)
        self.create_service(Trigger, "reset_odometry", self._reset_odometry)
        self.create_service(SetBool, "enable_motors", self._enable_motors)
        if optional.demo_services:
            self.create_service(optional.demo_services.SetMode, "set_mode", self._set_mode)

    def tick(self, stamp):
        """Stop without recent commands; publish what is due."""
        fastest, turning = self.setting("max_linear_speed"), self.setting("max_angular_speed")
        is_fresh = time.monotonic() - self._commanded_at <= self.setting("cmd_vel_timeout")
        linear, angular = self._commanded if is_fresh else (0.0, 0.0)
        self.robot.commanded = max(-fastest, min(fastest, linear)), max(-turning, min(turning, angular))
        if self.is_due(self.setting("odom_rate")):
            self._publish(stamp)
        if self.robot.mode != self._published_mode:
            self._published_mode = self.robot.mode
            self._mode.publish(String(data=self._published_mode))

    def diagnosis(self):
        """Return the state of the base."""
        base = self.robot.base
        values = {
            "mode": self.robot.mode,
            "motors": "enabled" if self.robot.motors_enabled else "disabled",
            "commanded speed [m/s]": f"{self.robot.commanded[0]:.2f}",
            "speed [m/s]": f"{base.linear:.2f}",
            "travelled [m]": f"{base.travelled:.2f}",
        }
        if base.blocked:
            return WARN, "base blocked: it is commanded to drive but stands against something", values
        if not self.robot.motors_enabled:
            return WARN, "motors are disabled", values
        return OK, "driving" if self.robot.is_moving() else "standing", values

    def _on_command(self, command):
        """Follow a manual command, which takes over from navigation."""
        if self.robot.mode == AUTONOMOUS:
            self.robot.mode = MANUAL
            self.get_logger().warning("/cmd_vel takes over: mode manual")
        self._take(command)

    def _on_navigation_command(self, command):
        if self.robot.mode == AUTONOMOUS:
            self._take(command)
        elif command.linear.x or command.angular.z:
            text = f"commands of navigation are ignored: the mode is {self.robot.mode}"
            self.get_logger().warning(text, throttle_duration_sec=5.0)

    def _take(self, command):
        if not (math.isfinite(command.linear.x) and math.isfinite(command.angular.z)):
            self.get_logger().error("a velocity command that is not finite was ignored")
            return
        reason = self.robot.why_not_driving()
        if reason and (command.linear.x or command.angular.z):
            self.get_logger().warning(f"velocity commands are ignored: {reason}", throttle_duration_sec=5.0)
        self._commanded = (command.linear.x, command.angular.z)
        self._commanded_at = time.monotonic()

    def _publish(self, stamp):
        base, message = self.robot.base, self.headed(self._odometry, stamp, "odom")
        place(message.pose.pose, base.odometry)
        message.twist.twist.linear.x = base.counts * base.linear
        message.twist.twist.angular.z = base.turns * base.angular * (-1 if base.are_exchanged else 1)
        self._odom.publish(message)
        self._joint_state.header.stamp = stamp
        self._joint_state.position = [base.left.angle, base.right.angle]
        self._joint_state.velocity = [base.left.velocity, base.right.velocity]
        self._joints.publish(self._joint_state)
        if self._tf:
            pose = base.odometry
            moved = transform(stamp, self.frame("odom"), self.frame("base_link"), pose.x, pose.y, yaw=pose.yaw)
            self._tf.publish(optional.tf2_msgs.TFMessage(transforms=[moved]))

    def _reset_odometry(self, _, response):
        self.robot.base.odometry = Pose()
        response.success, response.message = True, "odometry starts again at (0, 0), heading 0"
        return response

    def _enable_motors(self, request, response):
        self.robot.motors_enabled = request.data
        message = "motors enabled" if request.data else "motors disabled: the base brakes and stays"
        response.success, response.message = True, message
        return response

    def _set_mode(self, request, response):
        response.previous_mode = self.robot.mode
        response.success = request.mode in MODES
        if response.success:
            self.robot.mode = request.mode
            self._commanded = (0.0, 0.0)
            response.message = f"mode is now {request.mode}"
        else:
            response.message = f"there is no mode {request.mode!r}; the modes are {', '.join(MODES)}"
        return response
