"""Programs that an agent writes, run in a sandbox that offers the robot as a module."""
