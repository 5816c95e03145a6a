"""The link to the robot: find ROS 2, start a bridge, and exchange packets with it."""
