"""/imu_driver: the inertial measurement unit."""

# pyright: basic
from __future__ import annotations

from rclpy.qos import qos_profile_sensor_data
from sensor_msgs.msg import Imu

from .convert import diagonal, quaternion
from .part import ERROR, OK, WARN, RobotPart


class ImuDriver(RobotPart):
    """The driver of the IMU."""

    def __init__(self, robot, namespace):
        super().__init__("imu_driver", robot, namespace)
        self.declare_switch("enabled", True, "False: the unit is dead and publishes nothing")
        self.declare_number("rate", 50.0, 1.0, 50.0, "Samples per second [Hz]")
        self.declare_number("gyro_bias", 0.002, -0.5, 0.5, "Constant error of the yaw rate [rad/s]")
        self._publisher = self.create_publisher(Imu, "imu", qos_profile_sensor_data)
        self._message = Imu()
        self._message.orientation_covariance = diagonal(3, {0: 1e-4, 1: 1e-4, 2: 4e-6})
        self._message.angular_velocity_covariance = diagonal(3, {0: 9e-6, 1: 9e-6, 2: 9e-6})
        self._message.linear_acceleration_covariance = diagonal(3, {0: 9e-4, 1: 9e-4, 2: 9e-4})

    def tick(self, stamp):
        """Publish when it is due."""
        if not (self.setting("enabled") and self.is_due(self.setting("rate"))):
            return
        self.robot.gyro_bias = self.setting("gyro_bias")
        yaw, yaw_rate, acceleration = self.robot.inertia()
        message = self.headed(self._message, stamp, "imu_link")
        message.orientation = quaternion(yaw)
        message.angular_velocity.z = yaw_rate
        felt = message.linear_acceleration
        felt.x, felt.y, felt.z = acceleration
        self._publisher.publish(message)

    def diagnosis(self):
        """Return whether the IMU works at its nominal rate."""
        rate = self.setting("rate")
        values = {"rate [Hz]": f"{rate:g}", "nominal rate [Hz]": "50"}
        if not self.setting("enabled"):
            return ERROR, "no data from the IMU", values
        if rate < 40.0:
            return WARN, "slower than its nominal rate", values
        return OK, "measuring", values
