"""A simulated robot made of ordinary ROS 2 nodes."""
