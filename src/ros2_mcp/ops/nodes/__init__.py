"""Nodes: list, info, parameters, lifecycle."""
