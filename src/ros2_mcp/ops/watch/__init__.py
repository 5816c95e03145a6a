"""Watch a robot, and notify clients when something changes."""
