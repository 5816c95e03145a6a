"""Motion with closed-loop control, which the bridge carries out on the robot's side."""
