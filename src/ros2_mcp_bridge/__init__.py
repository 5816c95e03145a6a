"""The part that runs under the robot's own Python: standard library and rclpy only."""
