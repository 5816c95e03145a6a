"""Conversion between bytes of messages, their values, and JSON."""
