"""`pulse_peer.py TOPIC HERTZ VALUE [udp]`: publishes a Twist at a rate once somebody listens, until it is killed; says
"ready" then. With `udp` its participant has no shared memory, as that of the stopper.
"""

from __future__ import annotations

import contextlib
import sys
import time

import rclpy
from geometry_msgs.msg import Twist

from ros2_mcp_bridge.stopper import udp


def main() -> None:
    topic, hertz, value = sys.argv[1], float(sys.argv[2]), float(sys.argv[3])
    with udp.alone() if "udp" in sys.argv else contextlib.nullcontext():
        rclpy.init()
        node = rclpy.create_node("pulse_peer", enable_rosout=False, start_parameter_services=False)
    publisher, message = node.create_publisher(Twist, topic, 10), Twist()
    message.linear.x = value
    while not publisher.get_subscription_count():
        time.sleep(0.01)
    sys.stdout.write("ready\n")
    sys.stdout.flush()
    while True:
        publisher.publish(message)
        time.sleep(1 / hertz)


if __name__ == "__main__":
    main()
