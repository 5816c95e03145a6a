"""Relays from topic to topic."""
