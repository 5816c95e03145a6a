"""Watching a robot, so that a client is told when something changes."""
