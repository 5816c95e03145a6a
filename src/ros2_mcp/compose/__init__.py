"""Puts a robot and a server together, once, from settings."""
