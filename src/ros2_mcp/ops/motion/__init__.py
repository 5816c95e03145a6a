"""Motion with closed-loop control; the bridge carries it out on the robot's side."""
