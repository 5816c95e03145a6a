"""Programs that an agent writes, run in a sandbox in which the robot is a module."""
