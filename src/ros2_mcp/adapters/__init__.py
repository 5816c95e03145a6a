"""Adapters for vendors: one file for each of their formats or systems that can be used directly."""
