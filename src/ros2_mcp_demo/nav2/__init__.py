"""The rover with all of Nav2: one node per server, a chain of commands, lifecycle managers, and faults by name."""
