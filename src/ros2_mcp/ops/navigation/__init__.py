"""Navigation: goals for Nav2, ways that it plans, places by name, and why a goal failed."""
