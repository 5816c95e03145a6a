"""ros2-mcp: a Model Context Protocol server for ROS 2 robots."""
