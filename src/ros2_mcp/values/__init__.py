"""Bytes of messages, their values, and JSON."""
