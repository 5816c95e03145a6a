"""Immutable data, names and errors; imports no other package of this server."""
