"""Objects that the rooms of the server keep for each robot between calls, such as its places or last published
plans.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import TypeVar, cast


class Kept:
    """An object that one room keeps for a robot. The subclass is defined in that room, next to a function that gets it
    from the robot (`robot.kept.get`).
    """

    async def close(self) -> None:
        """End the object's own work, at the end of the robot's work. Most objects have none."""


K = TypeVar("K", bound=Kept)


class KeptByRooms:
    """One object of each kind for a robot. Objects that need settings are passed in; others are created on
    first use.
    """

    def __init__(self, given: Iterable[Kept] = ()) -> None:
        self._kept: dict[type[Kept], Kept] = {type(one): one for one in given}

    def get(self, kind: type[K], make: Callable[[], K]) -> K:
        """Return the object of this kind; create it on first use."""
        if kind not in self._kept:
            self._kept[kind] = make()
        return self.of(kind)

    def of(self, kind: type[K]) -> K:
        """Return the object of this kind; raises `KeyError` if there is none."""
        return cast("K", self._kept[kind])

    async def close(self) -> None:
        """Close all objects."""
        for one in self._kept.values():
            await one.close()
