"""Watching a robot, so that clients are notified when something changes."""
