"""Shared by the operations that act: default values, orders to vehicles, and how an act ended."""
