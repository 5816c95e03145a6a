"""/map_server: the map the robot was given."""

# pyright: basic
from __future__ import annotations

import array

from nav_msgs.msg import OccupancyGrid
from rclpy.qos import DurabilityPolicy, QoSProfile

from .part import RobotPart

RESOLUTION = 0.05


class MapServer(RobotPart):
    """Publishes the map once; it is latched. `cells` (int8) and `origin` are the map itself."""

    def __init__(self, robot, namespace):
        super().__init__("map_server", robot, namespace)
        self.cells, self.origin = robot.world.occupancy(RESOLUTION)
        latched = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
        self._publisher = self.create_publisher(OccupancyGrid, "map", latched)
        self._published = False

    def tick(self, stamp):
        """Publish the map, the first time."""
        if self._published:
            return
        self._published = True
        message = OccupancyGrid()
        message.header.stamp, message.header.frame_id = stamp, self.frame("map")
        message.info.map_load_time, message.info.resolution = stamp, RESOLUTION
        message.info.height, message.info.width = self.cells.shape
        message.info.origin.position.x, message.info.origin.position.y = self.origin
        message.data = array.array("b", self.cells.tobytes())
        self._publisher.publish(message)
