"""Bytes to values to JSON and back; pictures."""
