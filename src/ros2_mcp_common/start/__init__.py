"""How a bridge starts: stage 1, which is sent to the robot, and finding an installation of ROS 2."""
