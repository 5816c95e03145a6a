# pyright: basic
"""Entities that are kept for the next request that needs the same one: bounded, and destroyed when idle."""

from __future__ import annotations

import time
from contextlib import contextmanager

from .limits import MAX_POOLED


class _Entry:
    def __init__(self, entity):
        self.entity = entity
        self.users = 0
        self.last_used = time.monotonic()


class Pool:
    """Entities by key. Those in use are never destroyed; of the others the least recently used go first."""

    def __init__(self, destroy, limit=MAX_POOLED, idle_s=60.0):
        self._destroy = destroy
        self._limit = limit
        self._idle_s = idle_s
        self._entries = {}

    def __len__(self):
        return len(self._entries)

    def entities(self):
        """All entities by their keys."""
        return {key: entry.entity for key, entry in self._entries.items()}

    @contextmanager
    def use(self, key, create):
        """The entity of that key and whether it was just created."""
        created = key not in self._entries
        if created:
            self._make_room()
            self._entries[key] = _Entry(create())
        entry = self._entries[key]
        entry.users += 1
        try:
            yield entry.entity, created
        finally:
            entry.users -= 1
            entry.last_used = time.monotonic()

    def expire(self):
        """Destroy what nobody has used for `idle_s` seconds."""
        now = time.monotonic()
        for key, entry in list(self._entries.items()):
            if not entry.users and now - entry.last_used > self._idle_s:
                self._remove(key)

    def clear(self):
        """Destroy everything, used or not."""
        for key in list(self._entries):
            self._remove(key)

    def _make_room(self):
        idle = [key for key, entry in self._entries.items() if not entry.users]
        idle.sort(key=lambda key: self._entries[key].last_used)
        for key in idle[: max(0, len(self._entries) - self._limit + 1)]:
            self._remove(key)

    def _remove(self, key):
        self._destroy(self._entries.pop(key).entity)
