"""The ROS 2 nodes of the simulated robot, one module each."""
