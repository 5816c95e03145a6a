"""The floor of discovery: a fresh process with bare rclpy that ends once it has discovered a number of the bench's
topics."""

import sys
import time

import rclpy

rclpy.init()
node = rclpy.create_node("bench_discovery")
while sum(name.startswith("/bench/t") for name, _ in node.get_topic_names_and_types()) < int(sys.argv[1]):
    time.sleep(0.005)
print("complete", flush=True)
node.destroy_node()  # the next participant would wait for one that does not announce its end
rclpy.shutdown()
