"""Frozen data, names and errors; imports nothing of ours."""
