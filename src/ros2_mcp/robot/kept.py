"""What rooms keep of a robot from one call to the next, such as its places or the plans that were published last."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import TypeVar, cast


class Kept:
    """What one room keeps of one robot. The subclass stands in that room, and a function beside it asks the robot for
    it (`robot.kept.get`).
    """

    async def close(self) -> None:
        """Ends what it does by itself, at the end of the robot's work. Most do nothing."""


K = TypeVar("K", bound=Kept)


class KeptByRooms:
    """One object of each kind. What needs settings is given where the robot is built; the rest is made when a room
    first asks for it.
    """

    def __init__(self, given: Iterable[Kept] = ()) -> None:
        self._kept: dict[type[Kept], Kept] = {type(one): one for one in given}

    def get(self, kind: type[K], make: Callable[[], K]) -> K:
        """The one of that kind, which is made if there is none."""
        if kind not in self._kept:
            self._kept[kind] = make()
        return self.of(kind)

    def of(self, kind: type[K]) -> K:
        """The one of that kind; raises `KeyError` if there is none."""
        return cast("K", self._kept[kind])

    async def close(self) -> None:
        """Ends what they do."""
        for one in self._kept.values():
            await one.close()
