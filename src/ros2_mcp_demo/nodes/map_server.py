"""/map_server: publishes the robot's map."""

# pyright: basic
from __future__ import annotations

import array

from nav_msgs.msg import OccupancyGrid

from ..simulation import MAP_RESOLUTION
from .part import RobotPart


class MapServer(RobotPart):
    """Publishes the map once, latched."""

    def __init__(self, robot, namespace):
        super().__init__("map_server", robot, namespace)
        self._publisher = self.create_latched_publisher(OccupancyGrid, "map")
        self._published = False

    def tick(self, stamp):
        """Publish the map on the first call."""
        if self._published:
            return
        self._published = True
        cells, origin = self.robot.map
        message = self.headed(OccupancyGrid(), stamp, "map")
        message.info.map_load_time, message.info.resolution = stamp, MAP_RESOLUTION
        message.info.height, message.info.width = cells.shape
        message.info.origin.position.x, message.info.origin.position.y = origin
        message.data = array.array("b", cells.tobytes())
        self._publisher.publish(message)
