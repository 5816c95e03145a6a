"""A costmap told as Nav2 does it: whole once and latched, as a grid and raw; then only what changes, to who listens.

Each line of its input is a change as JSON: `{"x": 3, "y": 4, "width": 2, "height": 1, "cost": 254}`, with a raw cost.
It says after each whether somebody listened.
"""

from __future__ import annotations

import json
import sys
from typing import Any

import numpy as np
import rclpy
from map_msgs.msg import OccupancyGridUpdate  # pyright: ignore
from nav2_msgs.msg import Costmap, CostmapUpdate  # pyright: ignore
from nav_msgs.msg import OccupancyGrid
from rclpy.qos import DurabilityPolicy, QoSProfile

TOPIC, CELLS, CELL_M = "/global_costmap/costmap", 30, 0.1
PUBLISHED = {0: 0, 253: 99, 254: 100}

rclpy.init()
node = rclpy.create_node("global_costmap")
latched = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
whole = node.create_publisher(OccupancyGrid, TOPIC, latched)
part = node.create_publisher(OccupancyGridUpdate, f"{TOPIC}_updates", latched)
raw = node.create_publisher(Costmap, f"{TOPIC}_raw", latched)
raw_part = node.create_publisher(CostmapUpdate, f"{TOPIC}_raw_updates", latched)
cells = np.zeros((CELLS, CELLS), np.uint8)


def headed(message: Any) -> Any:
    message.header.frame_id, message.header.stamp = "map", node.get_clock().now().to_msg()
    return message


def published(costs: np.ndarray) -> list[int]:
    return [PUBLISHED[int(cost)] for cost in costs.ravel()]


grid = headed(OccupancyGrid())
grid.info.width = grid.info.height = CELLS
grid.info.resolution = CELL_M
grid.data = published(cells)
whole.publish(grid)
costmap = headed(Costmap())
costmap.metadata.size_x = costmap.metadata.size_y = CELLS
costmap.metadata.resolution = CELL_M
costmap.data = cells.ravel().tolist()
raw.publish(costmap)
print("ready", flush=True)
for line in sys.stdin:
    told = json.loads(line)
    x, y, width, height = told["x"], told["y"], told["width"], told["height"]
    cells[y : y + height, x : x + width] = told["cost"]
    changed = cells[y : y + height, x : x + width]
    heard = [one.get_subscription_count() > 0 for one in (part, raw_part)]
    if heard[0]:
        part.publish(headed(OccupancyGridUpdate(x=x, y=y, width=width, height=height, data=published(changed))))
    if heard[1]:
        update = CostmapUpdate(x=x, y=y, size_x=width, size_y=height, data=changed.ravel().tolist())
        raw_part.publish(headed(update))
    print(json.dumps(heard), flush=True)
rclpy.try_shutdown()
