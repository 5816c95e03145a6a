"""A node with markers of all types on /markers (an array) and /marker (one), hostile ones too, and a description.

The description is on /a/robot_description: one link, base_link, with a mesh whose file is the argument, and another one
that is nowhere.
"""

from __future__ import annotations

import contextlib
import math
import sys

import rclpy
from builtin_interfaces.msg import Duration
from geometry_msgs.msg import Point, Pose, Quaternion, Vector3
from rclpy.executors import ExternalShutdownException
from rclpy.qos import DurabilityPolicy, QoSProfile
from std_msgs.msg import ColorRGBA, Header, String
from visualization_msgs.msg import Marker, MarkerArray

VISUAL = '<visual><origin xyz="{x} 0 0.35"/><geometry><mesh filename="{file}"/></geometry>{look}</visual>'
GREEN = '<material name="green"><color rgba="0.1 0.7 0.3 1"/></material>'
SMALL = Vector3(x=0.1, y=0.1, z=0.1)


def marker(number: int, kind: int, scale: Vector3 = SMALL, ns: str = "row", **fields: object) -> Marker:
    """One in a row beside the robot, in a colour of its own."""
    hue = number / 13 * 2 * math.pi
    red, green, blue = (0.5 + 0.5 * math.cos(hue - turn) for turn in (0.0, 2.1, 4.2))
    place = Point(x=1.2 - 0.22 * number, y=-0.9, z=0.3)
    return Marker(
        header=Header(frame_id="odom"),
        ns=ns,
        id=number,
        type=kind,
        pose=Pose(position=place, orientation=Quaternion(w=1.0)),
        scale=scale,
        color=ColorRGBA(r=red, g=green, b=blue, a=1.0 if number % 4 else 0.5),
        **fields,
    )


def markers(mesh: str) -> list[Marker]:
    """All types, then what is hostile."""
    points = [Point(x=0.0, y=0.05 * at, z=0.1 * (at % 2)) for at in range(6)]
    tints = [ColorRGBA(r=at / 6, g=1.0 - at / 6, b=0.4, a=1.0) for at in range(6)]
    thin = Vector3(x=0.02, y=0.05, z=0.0)
    found = [
        marker(kind, kind, points=points, colors=tints if kind in (4, 6, 8) else []) for kind in (4, 5, 6, 7, 8, 11)
    ]
    found += [marker(kind, kind) for kind in (1, 2, 3)]
    found += [marker(0, 0, Vector3(x=0.3, y=0.03, z=0.03)), marker(12, 12, thin, points=points)]
    found += [marker(9, 9, text="<b>a pallet</b>"), marker(10, 10, mesh_resource=mesh)]
    found[2].scale = found[3].scale = found[4].scale = Vector3(x=0.04, y=0.04, z=0.04)
    hostile = [marker(at, 1, ns="hostile") for at in range(20, 24)]
    hostile[0].pose.position.x = math.nan
    hostile[1].type = 99
    hostile[2].ns = "x" * 1_000_000
    hostile[2].scale = Vector3(x=math.inf)
    hostile[3].header.frame_id = "nowhere"
    brief = marker(30, 2, lifetime=Duration(nanosec=1))
    return [*found, *hostile, brief]


def main() -> None:
    rclpy.init()
    node = rclpy.create_node("marking")
    kept = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
    description = node.create_publisher(String, "/a/robot_description", kept)
    looks = VISUAL.format(x=0, file=sys.argv[1], look=GREEN) + VISUAL.format(
        x=1, file="package://nowhere/a.dae", look=""
    )
    description.publish(String(data=f'<robot name="a"><link name="base_link">{looks}</link></robot>'))
    arrays = node.create_publisher(MarkerArray, "/markers", kept)
    single = node.create_publisher(Marker, "/marker", 10)
    arrays.publish(MarkerArray(markers=markers(sys.argv[1])))
    node.create_timer(0.2, lambda: single.publish(marker(13, 1)))
    print("ready", flush=True)
    with contextlib.suppress(ExternalShutdownException, KeyboardInterrupt):
        rclpy.spin(node)
    rclpy.try_shutdown()


main()
