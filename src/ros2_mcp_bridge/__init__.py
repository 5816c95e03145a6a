"""The bridge. It runs under the Python of the robot's ROS 2: standard library and rclpy only."""
