"""The stream to the robot: finding ROS, starting a bridge, talking to it."""
