"""Composition: builds robots and servers from settings."""
