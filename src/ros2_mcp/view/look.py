"""The input of a view (robot, source, selection), and the interface of its panels."""

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
"""Seconds to wait for the next message, before checking whether there is still a publisher."""

MOST_NAMED = 5
"""Names in one line for the model."""

Content = Mapping[str, Any]
"""The content of a panel, as JSON. `why` is the reason for an empty panel; `bulk` is base64 and contains no text to
escape."""


@dataclass(frozen=True, slots=True)
class Look:
    """The robot, the source, and the human's selection: a topic, or empty.

    The source is `NewestOfRobot`, or the part of a recording up to the time that is shown.
    """

    robot: Robot
    source: Source
    chosen: str = ""

    @property
    def now_ns(self) -> int:
        """The time that is shown, in ns of Unix time."""
        return self.source.covers_ns[1] if self.source.covers_ns else self.robot.now_ns()


def when(sample: Sample, is_from_before: bool) -> Mapping[str, Any]:
    """Return when a message was received, as `at_s`; if it was sent before the subscription, when it was sent, and
    `from_before`. The page tells its age by both (`ageText` in `viewer/src/dom.ts`).
    """
    at_ns = sample.source_ns if is_from_before and sample.source_ns else sample.received_ns
    return {"at_s": at_ns / 1e9, "from_before": is_from_before}


@dataclass
class Chunks:
    """Large parts of the content that rarely change, such as maps, by the hash of their bytes: each is sent once."""

    most: int = 4
    _kept: dict[str, tuple[str, bytes]] = field(default_factory=dict[str, tuple[str, bytes]])

    def keep(self, key: str, data: bytes, kind: str = "", *, most: int = 0) -> None:
        """Keep a part.

        The oldest of its kind are dropped if there are more than `most` (0: the default of all kinds).
        """
        self._kept.pop(key, None)
        self._kept[key] = kind, data
        same = [other for other, (of, _) in self._kept.items() if of == kind]
        for old in same[: -(most or self.most)]:
            del self._kept[old]

    def find(self, key: str) -> bytes | None:
        """Return a part that was shown recently, or None."""
        return self._kept[key][1] if key in self._kept else None


@dataclass(frozen=True, slots=True)
class PageContext:
    """The context shared by the panels of one page.

    `source` is the live robot, or the whole recording; packages with meshes are searched below `prefixes`, besides the
    ones that this process finds anyway.
    """

    title: str
    source: Source
    acting: Acting
    chunks: Chunks
    prefixes: Sequence[Path] = ()


class Panel(ABC):
    """One panel of one view; `period_s` is the least time between two updates of a live view.

    A module of `panels/` has its class, and a file of the same name in `viewer/src/panels` draws it. Topics of the
    types in `shows_types`, and topics that a client asks for as kind `shows_kind`, open in this panel.
    """

    name: ClassVar[str]
    period_s: ClassVar[float]
    shows_types: ClassVar[Sequence[str]] = ()
    shows_kind: ClassVar[str] = ""

    def __init__(self, page: PageContext) -> None:
        """Prepare the panel of a page that has just been opened."""
        self._page = page

    @abstractmethod
    async def show(self, look: Look) -> Content | None:
        """Return the content; None if it is unchanged.

        Raises `RobotError` with the reason if there is nothing to show.
        """

    def words(self, content: Content) -> str:
        """Return the content in one line for the model; empty if there is nothing."""
        if not content.get("topic"):
            return ""
        size = f", {content['width']} × {content['height']}" if content.get("width") else ""
        rate = f", {content['rate_hz']:.3g} Hz" if content.get("rate_hz") else ""
        return f"{named(str(content['topic']))}{size}{rate}"

    async def beside(self, robot: Robot) -> None:  # noqa: B027 - most panels have nothing to do
        """Run in the background while the view is open; cancelled when it closes."""


@dataclass
class Shown:
    """The last message of a live topic that a panel has shown."""

    topic: str = ""
    sample: Sample | None = None

    async def newer(self, robot: Robot, topic: str) -> tuple[Sample, Newest, Listening] | None:
        """Return the newest message of a topic once it differs from the last message; None if no message arrives in
        `WAIT_S`.

        Raises:
            RobotError: if the topic cannot be subscribed to.
        """
        if topic != self.topic:
            self.topic, self.sample = topic, None
        newest = newest_of(robot, topic)
        sample = await newest.newer(self.sample, WAIT_S)
        if sample is None and newest.error:
            raise newest.error.again()
        if sample is None or newest.listening is None:  # so for a moment while the subscription is renewed
            return None
        self.sample = sample
        return sample, newest, newest.listening
