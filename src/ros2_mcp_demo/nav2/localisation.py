"""Localisation as in Nav2: map_server, AMCL, and the nodes of the costmaps."""

# pyright: basic
from __future__ import annotations

import array
import math
import random

from geometry_msgs.msg import PoseWithCovarianceStamped
from nav_msgs.msg import OccupancyGrid
from rclpy.qos import DurabilityPolicy, QoSProfile, qos_profile_sensor_data
from sensor_msgs.msg import LaserScan

from .. import optional
from ..base import Pose, wrapped
from ..nodes.convert import diagonal, place, transform
from ..nodes.lifecycle_part import LifecyclePart
from ..nodes.part import RobotPart
from ..simulation import MAP_RESOLUTION
from .servers import Managed, declare

RATE = 5.0
TOLERANCE_S = 1.0
"""Time by which AMCL stamps its transform in the future."""
DEVIATION_M = (0.30, 0.45)
"""Standard deviations that a healthy AMCL reports."""
UNKNOWN_FROM_M = 4.9
"""The x in m from which the map is unknown, if that fault is planted."""
LATCHED = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)


class MapServer(Managed, LifecyclePart):
    """Publishes the map when it is activated: latched or, with a planted fault, volatile."""

    def __init__(self, robot, namespace):
        super().__init__("map_server", robot, namespace)
        declare(self, {"yaml_filename": "room.yaml", "frame_id": "map"})
        self._publisher = self.create_publisher(OccupancyGrid, "map", LATCHED)

    def publish_as(self, durability):
        """Publish with another durability from now on."""
        self.destroy_publisher(self._publisher)
        self._publisher = self.create_publisher(OccupancyGrid, "map", QoSProfile(depth=1, durability=durability))
        self.publish()

    def on_activate(self, state):
        """Publish the map."""
        done = super().on_activate(state)
        self.publish()
        return done

    def publish(self):
        """Publish the map."""
        cells, origin = self.robot.map
        stamp = self.get_clock().now().to_msg()
        message = self.headed(OccupancyGrid(), stamp, "map")
        message.info.map_load_time, message.info.resolution = stamp, MAP_RESOLUTION
        message.info.height, message.info.width = cells.shape
        message.info.origin.position.x, message.info.origin.position.y = origin
        message.data = array.array("b", cells.tobytes())
        self._publisher.publish(message)


class Amcl(Managed, LifecyclePart):
    """Localises with each scan only; its transform is stamped in the future. `off` is the planted error (m, m, rad)."""

    def __init__(self, robot, namespace, **parameters):
        super().__init__("amcl", robot, namespace)
        declare(self, parameters)
        self.is_told = True
        self.off = (0.0, 0.0, 0.0)
        self.deviation_m = 0.0
        self._random = random.Random(3)
        self._pose = self.create_publisher(PoseWithCovarianceStamped, "amcl_pose", LATCHED)
        self._tf = self.create_publisher(optional.tf2_msgs.TFMessage, "/tf", 100)
        self.create_subscription(OccupancyGrid, "map", lambda _: None, LATCHED)
        self.create_subscription(LaserScan, "scan", self._see, qos_profile_sensor_data)
        self.create_subscription(PoseWithCovarianceStamped, "initialpose", self._hear, 10)

    def _hear(self, _):
        self.is_told = True

    def _see(self, scan):
        if not (self.is_active and self.is_told and self.is_due(RATE)):
            return
        believed = self.robot.localize(0.01)
        dx, dy, turn = self.off
        pose = Pose(believed.x + dx, believed.y + dy, wrapped(believed.yaw + turn))
        deviation = self.deviation_m or self._random.uniform(*DEVIATION_M)
        message = self.headed(PoseWithCovarianceStamped(), scan.header.stamp, "map")
        message.pose.covariance = diagonal(6, {0: deviation**2, 1: deviation**2, 5: 0.07})
        place(message.pose.pose, pose)
        self._pose.publish(message)
        odometry = self.robot.base.odometry
        yaw = wrapped(pose.yaw - odometry.yaw)
        x = pose.x - math.cos(yaw) * odometry.x + math.sin(yaw) * odometry.y
        y = pose.y - math.sin(yaw) * odometry.x - math.cos(yaw) * odometry.y
        stamp = type(scan.header.stamp)(sec=scan.header.stamp.sec + int(TOLERANCE_S), nanosec=scan.header.stamp.nanosec)
        correction = transform(stamp, self.frame("map"), self.frame("odom"), x, y, yaw=yaw)
        self._tf.publish(optional.tf2_msgs.TFMessage(transforms=[correction]))


class Costmap(RobotPart):
    """The node of a costmap with its parameters: subscribes to the scan, the global one also to the map."""

    def __init__(self, name, robot, namespace, **parameters):
        super().__init__(name, robot, f"{namespace}/{name}")
        declare(self, parameters)
        self.grids = self.create_publisher(OccupancyGrid, "costmap", LATCHED)
        self._scans = None
        self.listen("../scan")
        if name == "global_costmap":
            self.create_subscription(OccupancyGrid, f"{namespace}/map", lambda _: None, LATCHED)

    def listen(self, topic):
        """Subscribe to the scan on a topic; `../` leaves the node's own namespace."""
        if self._scans:
            self.destroy_subscription(self._scans)
        outside = self.get_namespace().rpartition("/")[0]
        name = f"{outside}/{topic[3:]}" if topic.startswith("../") else topic
        self._scans = self.create_subscription(LaserScan, name, lambda _: None, qos_profile_sensor_data)


class LocalCostmap(Costmap):
    """The costmap around the robot."""

    def tick(self, stamp):
        """Publish the cells that the scan hits, once a second."""
        if not self.is_due(1.0) or self.robot.ranges is None:
            return
        message = OccupancyGrid()
        message.header.stamp, message.header.frame_id = stamp, "odom"
        side, resolution = 60, 0.05
        odometry, pose = self.robot.base.odometry, self.robot.base.pose
        message.info.resolution, message.info.width, message.info.height = resolution, side, side
        origin = message.info.origin.position
        origin.x, origin.y = odometry.x - side * resolution / 2, odometry.y - side * resolution / 2
        cells = array.array("b", bytes(side * side))
        turn = odometry.yaw - pose.yaw
        for x, y in self.robot.scan_points(self.robot.ranges):
            dx, dy = x - pose.x, y - pose.y
            column = int((math.cos(turn) * dx - math.sin(turn) * dy) / resolution + side / 2)
            row = int((math.sin(turn) * dx + math.cos(turn) * dy) / resolution + side / 2)
            if 0 <= row < side and 0 <= column < side:
                cells[row * side + column] = 100
        message.data = cells
        self.grids.publish(message)
