"""Nodes: which there are, their parameters, their lifecycle."""
