"""The floor of discovery: a fresh process with bare rclpy ends when it knows so many topics of the bench's peers."""

import sys
import time

import rclpy

rclpy.init()
node = rclpy.create_node("bench_discovery")
while sum(name.startswith("/bench/t") for name, _ in node.get_topic_names_and_types()) < int(sys.argv[1]):
    time.sleep(0.005)
print("complete", flush=True)
node.destroy_node()  # a participant that does not say goodbye is waited for by the next one
rclpy.shutdown()
