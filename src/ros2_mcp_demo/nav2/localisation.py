"""Localisation as in Nav2: map_server, AMCL, and the nodes of the costmaps."""

# pyright: basic
from __future__ import annotations

import array
import math
import random

import numpy as np
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
from . import map_files
from .servers import Managed, declare

RATE = 5.0
TOLERANCE_S = 1.0
"""Time by which AMCL stamps its transform in the future."""
DEVIATION_M = (0.30, 0.45)
"""Standard deviations that a healthy AMCL reports."""
CORRECTS_M, CORRECTS_RAD = 0.5, math.radians(25)
"""Errors of an initial pose that AMCL's particles still cover."""
UNKNOWN_FROM_M = 4.9
"""The x in m from which the map is unknown, if that fault is planted."""
LATCHED = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)


class MapServer(Managed, LifecyclePart):
    """Publishes the map when it is activated: latched or, with a planted fault, volatile."""

    def __init__(self, robot, namespace, loading):
        super().__init__("map_server", robot, namespace)
        declare(self, {"yaml_filename": "room.yaml", "frame_id": "map"})
        self._publisher = self.create_publisher(OccupancyGrid, "map", LATCHED)
        self._loaded = None
        self.create_service(loading, "map_server/load_map", self._load)

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
        self._publisher.publish(self._message())

    def _message(self):
        cells, resolution, origin = self._loaded or (self.robot.map[0], MAP_RESOLUTION, self.robot.map[1])
        stamp = self.get_clock().now().to_msg()
        message = self.headed(OccupancyGrid(), stamp, "map")
        message.info.map_load_time, message.info.resolution = stamp, resolution
        message.info.height, message.info.width = len(cells), len(cells[0])
        message.info.origin.position.x, message.info.origin.position.y = origin
        message.data = array.array("b", cells.tobytes())
        return message

    def _load(self, request, response):
        """Load a map from a file. Costmaps, planner and localisation of this robot keep the room's own."""
        if not self.is_active:
            response.result = response.RESULT_UNDEFINED_FAILURE
            return response
        try:
            self._loaded = map_files.read(request.map_url.removeprefix("file://"))
        except FileNotFoundError:
            response.result = response.RESULT_MAP_DOES_NOT_EXIST
        except (KeyError, ValueError):
            response.result = response.RESULT_INVALID_MAP_METADATA
        except OSError:
            response.result = response.RESULT_INVALID_MAP_DATA
        else:
            response.map = self._message()
            response.result = response.RESULT_SUCCESS
            self._publisher.publish(response.map)
        return response


class MapSaver(RobotPart):
    """Serves map_saver/save_map: writes the newest map of a topic to files."""

    def __init__(self, robot, namespace, saving):
        super().__init__("map_saver", robot, namespace)
        self._map = None
        self.create_subscription(OccupancyGrid, "map", self._hear, LATCHED)
        self.create_service(saving, "map_saver/save_map", self._save)

    def _hear(self, message):
        self._map = message

    def _save(self, request, response):
        response.result = False
        if self._map is not None and request.map_topic in ("", "map", "/map"):
            info = self._map.info
            cells = np.array(self._map.data, np.int8).reshape(info.height, info.width)
            corner = info.origin.position
            try:
                map_files.write(request.map_url, cells, info.resolution, (corner.x, corner.y))
                response.result = True
            except OSError as error:
                self.get_logger().error(f"Failed to write the map: {error}")
        return response


class Amcl(Managed, LifecyclePart):
    """Localises with each scan only; its transform is stamped in the future. `off` is the planted error (m, m, rad)."""

    def __init__(self, robot, namespace, **parameters):
        super().__init__("amcl", robot, namespace)
        declare(self, parameters)
        self.is_told = self.setting("set_initial_pose")
        self.off = (0.0, 0.0, 0.0)
        self.deviation_m = 0.0
        self._random = random.Random(3)
        self._pose = self.create_publisher(PoseWithCovarianceStamped, "amcl_pose", LATCHED)
        self._tf = self.create_publisher(optional.tf2_msgs.TFMessage, "/tf", 100)
        self.create_subscription(OccupancyGrid, "map", lambda _: None, LATCHED)
        self.create_subscription(LaserScan, "scan", self._see, qos_profile_sensor_data)
        self.create_subscription(PoseWithCovarianceStamped, "initialpose", self._hear, 10)

    def _hear(self, told):
        """Take an initial pose. A small error is corrected with the scans, a large one stays."""
        self.is_told = True
        at, turn, true = told.pose.pose.position, told.pose.pose.orientation, self.robot.base.pose
        yaw = wrapped(2 * math.atan2(turn.z, turn.w) - true.yaw)
        off = (at.x - true.x, at.y - true.y, yaw)
        corrects = math.hypot(off[0], off[1]) < CORRECTS_M and abs(yaw) < CORRECTS_RAD
        self.off = (0.0, 0.0, 0.0) if corrects else off

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
