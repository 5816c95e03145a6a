"""A robot that said all of it before anybody listened: topics that keep ten messages, or one, and are quiet since.

`/steady` is latched as well, and goes on ten times a second. The topics of `TURNS` wait with that: what they keep is
True, and only when a subscriber has acknowledged all of it they go on with False. So no new message replaces a kept one
before it was received.
"""

from __future__ import annotations

import contextlib
import time

import rclpy
from geometry_msgs.msg import PoseStamped
from nav_msgs.msg import OccupancyGrid, Odometry
from rclpy.duration import Duration
from rclpy.executors import ExternalShutdownException
from rclpy.qos import DurabilityPolicy, QoSProfile
from sensor_msgs.msg import BatteryState, Image, JointState
from std_msgs.msg import Bool, Int32
from visualization_msgs.msg import Marker

from support.leaving import leave_on_sigterm

KEPT = 10
TURNS = ("/turn_read", "/turn_judged")
"""One for each test: after the first subscriber, what they keep is False."""
_AT_ONCE = Duration(seconds=0)


def main() -> None:
    rclpy.init()
    leave_on_sigterm()
    node = rclpy.create_node("latched")

    def publisher(kind: type, topic: str, depth: int = 1):
        return node.create_publisher(kind, topic, QoSProfile(depth=depth, durability=DurabilityPolicy.TRANSIENT_LOCAL))

    counts, armed, steady = (
        publisher(Int32, "/count", KEPT),
        publisher(Bool, "/armed"),
        publisher(Bool, "/steady", KEPT),
    )
    battery, odometry = publisher(BatteryState, "/battery"), publisher(Odometry, "/odom")
    goal, grid = publisher(PoseStamped, "/goal_pose"), publisher(OccupancyGrid, "/map")
    for number in range(KEPT):
        counts.publish(Int32(data=number))
        steady.publish(Bool(data=True))
    turns = [publisher(Bool, topic, KEPT) for topic in TURNS]
    for turn in turns:
        for _ in range(KEPT):
            turn.publish(Bool(data=True))
    last = publisher(Int32, "/last_count")
    last.publish(Int32(data=KEPT - 1))
    armed.publish(Bool(data=True))
    battery.publish(BatteryState(percentage=0.15))
    placed = Odometry()
    placed.header.frame_id, placed.pose.pose.orientation.w, placed.pose.pose.position.x = "odom", 1.0, 2.0
    odometry.publish(placed)
    target = PoseStamped()
    target.header.frame_id, target.pose.orientation.w = "map", 1.0
    goal.publish(target)
    room = OccupancyGrid()
    room.header.frame_id, room.info.resolution, room.info.width, room.info.height = "map", 0.1, 4, 4
    room.data = [0] * 16
    grid.publish(room)
    joints = publisher(JointState, "/joint_states")
    joints.publish(JointState(name=["lift"], position=[0.25]))
    picture = publisher(Image, "/still")
    picture.publish(Image(width=2, height=2, encoding="mono8", step=2, data=[0, 80, 160, 240]))
    marker = Marker(type=Marker.CUBE)
    marker.header.frame_id, marker.pose.orientation.w, marker.color.a = "map", 1.0, 1.0
    marker.scale.x = marker.scale.y = marker.scale.z = 0.5
    signs = publisher(Marker, "/signs")
    signs.publish(marker)
    time.sleep(2.0)  # they are old before anybody is told that they are there

    def go_on() -> None:
        steady.publish(Bool(data=False))
        for turn in turns:
            if turn.get_subscription_count() and turn.wait_for_all_acked(_AT_ONCE):
                turn.publish(Bool(data=False))

    node.create_timer(0.1, go_on)
    print("ready", flush=True)
    with contextlib.suppress(KeyboardInterrupt, ExternalShutdownException):
        rclpy.spin(node)


main()
