"""Read the log of the robot's nodes."""
