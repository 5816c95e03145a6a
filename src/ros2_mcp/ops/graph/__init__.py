"""The robot as a whole: status, interfaces, and names for completions."""
