"""A node that publishes /cloud at 5 Hz: the floor of a room of 8 m × 4 m, its walls, a red ball, and two NaN.

Its frame is the argument, else `room`, which no transform names. A second argument is how many points it has instead,
on a wavy ground.
"""

from __future__ import annotations

import contextlib
import math
import struct
import sys

import rclpy
from rclpy.executors import ExternalShutdownException
from rclpy.qos import qos_profile_sensor_data
from sensor_msgs.msg import PointCloud2, PointField
from std_msgs.msg import Header

GREY, WHITE, RED = 0x606060, 0xE0E0E0, 0xFF2020


def points() -> list[tuple[float, float, float, float, int]]:
    """x, y, z, intensity and packed colour."""
    if len(sys.argv) > 2:
        side = math.isqrt(int(sys.argv[2]))
        places = ((row / side * 20 - 10, column / side * 20 - 10) for row in range(side) for column in range(side))
        return [(x, y, math.sin(x) * math.cos(y), 50.0, GREY) for x, y in places]
    found = [(x * 0.1 + 0.05, y * 0.1 + 0.05, 0.0, 10.0, GREY) for x in range(-40, 40) for y in range(-20, 20)]
    for z in (0.5, 1.0, 1.5, 2.0):
        found += [(x * 0.1 + 0.05, y, z, 90.0, WHITE) for x in range(-40, 40) for y in (-1.95, 1.95)]
        found += [(x, y * 0.1 + 0.05, z, 90.0, WHITE) for x in (-3.95, 3.95) for y in range(-20, 20)]
    for step in range(0, 360, 5):
        angle = math.radians(step)
        found += [(2.0 + r * math.cos(angle), 0.5 + r * math.sin(angle), 1.0, 50.0, RED) for r in (0.05, 0.15, 0.25)]
    return [*found, (math.nan, 0.0, 0.0, 1.0, WHITE), (0.0, 0.0, math.nan, 1.0, WHITE)]


def cloud() -> PointCloud2:
    message = PointCloud2(
        header=Header(frame_id=sys.argv[1] if len(sys.argv) > 1 else "room"),
        height=1,
        width=len(points()),
        point_step=20,
    )
    for index, name in enumerate(("x", "y", "z", "intensity", "rgb")):
        kind = PointField.UINT32 if name == "rgb" else PointField.FLOAT32
        message.fields.append(PointField(name=name, offset=4 * index, datatype=kind, count=1))
    message.data = b"".join(struct.pack("<4fI", *point) for point in points())
    message.row_step = len(message.data)
    return message


def main() -> None:
    rclpy.init()
    node = rclpy.create_node("cloud")
    # A large one is reliable: of 1.2 MB the sockets of most systems lose a part.
    qos = 5 if len(sys.argv) > 2 else qos_profile_sensor_data
    publisher = node.create_publisher(PointCloud2, "cloud", qos)
    message = cloud()

    def publish() -> None:
        message.header.stamp = node.get_clock().now().to_msg()
        message.data[2] ^= 0x40  # another one each time: its first point moves by a quarter
        publisher.publish(message)

    node.create_timer(0.2, publish)
    print("ready", flush=True)
    with contextlib.suppress(ExternalShutdownException, KeyboardInterrupt):
        rclpy.spin(node)
    rclpy.try_shutdown()


main()
