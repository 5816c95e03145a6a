"""What one view looks at, and what a panel of it shows."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from ros2_mcp.ops.sources.source import Source
from ros2_mcp.robot import Robot

Content = Mapping[str, Any]
"""What a panel shows, as JSON. `why` says in words why there is nothing; `bulk` is base64, which hides no text."""


@dataclass(frozen=True, slots=True)
class Look:
    """The robot, the source, and what the human has chosen of it: a topic, or nothing.

    The source is `NewestOfRobot`, or the part of a recording up to the time that is shown.
    """

    robot: Robot
    source: Source
    chosen: str = ""

    @property
    def now_ns(self) -> int:
        """The time that is shown, in ns of Unix time."""
        return self.source.covers_ns[1] if self.source.covers_ns else self.robot.now_ns()


class Panel(ABC):
    """One panel of one view. `period_s` is the least time between two looks, live."""

    name: str
    period_s: float

    @abstractmethod
    async def show(self, look: Look) -> Content | None:
        """What there is to be shown; None if that is what was shown before. Raises `RobotError` with the reason why
        there is nothing.
        """


@dataclass
class Chunks:
    """Large parts of what is shown that hardly change, such as maps, by the hash of their bytes: sent once each."""

    most: int = 4
    _kept: dict[str, bytes] = field(default_factory=dict[str, bytes])

    def keep(self, key: str, data: bytes) -> None:
        """Keeps one; the oldest give way."""
        self._kept[key] = data
        while len(self._kept) > self.most:
            del self._kept[next(iter(self._kept))]

    def find(self, key: str) -> bytes | None:
        """One of those that were shown of late."""
        return self._kept.get(key)
