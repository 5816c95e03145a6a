"""What one view looks at, and what a panel of it shows."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, ClassVar

from ros2_mcp.model.samples import Sample
from ros2_mcp.model.text import named
from ros2_mcp.ops.sources.newest_samples import Newest, newest_of
from ros2_mcp.ops.sources.source import Source
from ros2_mcp.robot import Robot
from ros2_mcp.robot.listening import Listening
from ros2_mcp.view.acting import Acting

WAIT_S = 0.5
"""For the next message, before it is looked whether there is still a publisher."""

MOST_NAMED = 5
"""Names in one line for the model."""

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


@dataclass
class Chunks:
    """Large parts of what is shown that hardly change, such as maps, by the hash of their bytes: sent once each."""

    most: int = 4
    _kept: dict[str, tuple[str, bytes]] = field(default_factory=dict[str, tuple[str, bytes]])

    def keep(self, key: str, data: bytes, kind: str = "", *, most: int = 0) -> None:
        """Keeps one; the oldest of its kind give way, where there are more than so many (0: as of all kinds)."""
        self._kept.pop(key, None)
        self._kept[key] = kind, data
        same = [other for other, (of, _) in self._kept.items() if of == kind]
        for old in same[: -(most or self.most)]:
            del self._kept[old]

    def find(self, key: str) -> bytes | None:
        """One of those that were shown of late."""
        return self._kept[key][1] if key in self._kept else None


@dataclass(frozen=True, slots=True)
class PageContext:
    """What the panels of one page share. `source` is the robot now, or the whole recording; below `prefixes` are
    packages with meshes, besides those that this process sees anyway.
    """

    title: str
    source: Source
    acting: Acting
    chunks: Chunks
    prefixes: Sequence[Path] = ()


class Panel(ABC):
    """One panel of one view: a module of `panels/` has its class, and `viewer/src/panels` a file of the same name that
    draws it. `period_s` is the least time between two looks, live.

    Topics of the types in `shows_types`, or of any type where a client asks for the kind `shows_kind`, open in it.
    """

    name: ClassVar[str]
    period_s: ClassVar[float]
    shows_types: ClassVar[Sequence[str]] = ()
    shows_kind: ClassVar[str] = ""

    def __init__(self, page: PageContext) -> None:
        """For a page that has just been opened."""
        self._page = page

    @abstractmethod
    async def show(self, look: Look) -> Content | None:
        """What there is to be shown; None if that is what was shown before. Raises `RobotError` with the reason why
        there is nothing.
        """

    def words(self, content: Content) -> str:
        """What it shows, in one line for the model; empty where that is nothing."""
        if not content.get("topic"):
            return ""
        size = f", {content['width']} × {content['height']}" if content.get("width") else ""
        rate = f", {content['rate_hz']:.3g} Hz" if content.get("rate_hz") else ""
        return f"{named(str(content['topic']))}{size}{rate}"

    async def beside(self, robot: Robot) -> None:  # noqa: B027 - most panels have nothing to do
        """What it does as long as its view is open, beside being looked at; it is cancelled then."""


@dataclass
class Shown:
    """The message of a live topic that a panel has shown last."""

    topic: str = ""
    sample: Sample | None = None

    async def newer(self, robot: Robot, topic: str) -> tuple[Sample, Newest, Listening] | None:
        """The newest message of a topic, as soon as it is another one; None if none comes for a moment.

        Raises:
            RobotError: why it is not listened to.
        """
        if topic != self.topic:
            self.topic, self.sample = topic, None
        newest = newest_of(robot, topic)
        sample = await newest.newer(self.sample, WAIT_S)
        if sample is None and newest.error:
            raise newest.error.again()
        if sample is None or newest.listening is None:  # which is so for a moment, while it is listened to anew
            return None
        self.sample = sample
        return sample, newest, newest.listening
