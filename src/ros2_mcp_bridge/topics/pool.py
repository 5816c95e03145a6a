"""Entities that are kept for the next request that needs the same entity: their number is bounded, idle entities are
destroyed.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Generator, Hashable
from contextlib import contextmanager
from typing import Generic, TypeVar

from ros2_mcp_common.wire.limits import MAX_POOLED

K = TypeVar("K", bound=Hashable)
T = TypeVar("T")

# How long an unused entity is kept. Discovery of a new one costs every peer work and the next request some
# milliseconds; an agent that publishes or calls again usually does so within a minute.
IDLE_S = 60.0


class _Entry(Generic[T]):
    def __init__(self, entity: T) -> None:
        self.entity = entity
        self.users = 0
        self.last_used = time.monotonic()


class Pool(Generic[K, T]):
    """Entities by key, of which the least recently used are destroyed when there are too many.

    An entity that is in use, or that `keeps` says is needed, is never destroyed.
    """

    def __init__(
        self,
        destroy: Callable[[T], object],
        limit: int = MAX_POOLED,
        idle_s: float = IDLE_S,
        *,
        keeps: Callable[[T], bool] = lambda _: False,
    ) -> None:
        self._destroy = destroy
        self._keeps = keeps
        self._limit = limit
        self._idle_s = idle_s
        self._entries: dict[K, _Entry[T]] = {}

    def __len__(self) -> int:
        return len(self._entries)

    def entities(self) -> dict[K, T]:
        """Return all entities by key."""
        return {key: entry.entity for key, entry in self._entries.items()}

    @contextmanager
    def use(self, key: K, create: Callable[[], T]) -> Generator[tuple[T, bool], None, None]:
        """A context manager that gives the entity of that key, and whether it was just created."""
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

    def expire(self) -> None:
        """Destroy the entities that were not used for `idle_s` seconds."""
        now = time.monotonic()
        for key, entry in list(self._entries.items()):
            if self._is_idle(entry) and now - entry.last_used > self._idle_s:
                self._remove(key)

    def clear(self) -> None:
        """Destroy all entities, used or not."""
        for key in list(self._entries):
            self._remove(key)

    def _make_room(self) -> None:
        idle = [key for key, entry in self._entries.items() if self._is_idle(entry)]
        idle.sort(key=lambda key: self._entries[key].last_used)
        for key in idle[: max(0, len(self._entries) - self._limit + 1)]:
            self._remove(key)

    def _is_idle(self, entry: _Entry[T]) -> bool:
        return not entry.users and not self._keeps(entry.entity)

    def _remove(self, key: K) -> None:
        self._destroy(self._entries.pop(key).entity)
