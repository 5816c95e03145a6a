"""The rover with all of Nav2: each server a node of its own, a chain of command, managers, and faults by name."""
