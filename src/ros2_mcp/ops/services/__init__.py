"""Services: list and call."""
