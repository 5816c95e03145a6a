"""Motion that is closed by feedback beside the robot."""
