"""The results of operations, and their text."""
