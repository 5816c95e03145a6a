"""Actions: list them, send, follow and cancel goals, and get their results."""
