"""Which messages of a topic are of one publisher: told by the numbers that each publisher gives its messages.

rclpy tells the number of a message and not its publisher. Each publisher counts its own messages by ones, so those
whose numbers follow each other are of one.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable, Mapping
from dataclasses import dataclass

_MOST_LOST = 200
"""Messages that may be missing between two of one publisher: seconds of a fast topic."""
_MOST = 64
"""Publishers that are told apart; the one that was heard of longest ago is forgotten."""


@dataclass(slots=True)
class _Track:
    number: int
    last: int
    about: frozenset[str]
    heard: int
    first_ns: int = 0
    last_ns: int = 0


class Writers:
    """The publishers of one topic, by numbers from 1 on.

    With `by_frames` a message about frames of which nobody has told is of a further publisher, whatever its number: of
    what is latched each publisher sends one or two, so that a number that follows another tells nothing.
    """

    def __init__(self, *, by_frames: bool = False) -> None:
        self._by_frames = by_frames
        self._tracks: list[_Track] = []
        self._lasts: deque[int] = deque(maxlen=_MOST)
        self._made = 0
        self._heard = 0

    @property
    def frames(self) -> Mapping[int, frozenset[str]]:
        """The frames that each publisher has told."""
        return {track.number: track.about for track in self._tracks}

    @property
    def heard_ns(self) -> Mapping[int, tuple[int, int]]:
        """When the first and the last message of each publisher came."""
        return {track.number: (track.first_ns, track.last_ns) for track in self._tracks}

    @property
    def count(self) -> int:
        """How many there are: one that takes frames of another over may be told apart as two, and where messages are
        lost more numbers follow none, so that the lesser of both counts.
        """
        return len(self._tracks) if self._by_frames else min(len(self._tracks), len(self._lasts))

    def of(self, sequence: int | None, about: Iterable[str], received_ns: int = 0) -> int:
        """The publisher of the message with that number, which is about these frames; 0 where there is no number."""
        if sequence is None:
            return 0
        self._heard += 1
        if sequence - 1 in self._lasts:
            self._lasts.remove(sequence - 1)
        self._lasts.append(sequence)
        frames = frozenset(about)
        fitting = [track for track in self._tracks if 0 < sequence - track.last <= _MOST_LOST]
        # The next number, and the same frames, tell more than a number that is only near.
        best = max(fitting, key=lambda one: _rank(one, sequence, frames), default=None)
        if best is None or _likeness(best, sequence, frames) < (2 if self._by_frames else 1):
            for track in self._tracks:
                # Its number is in use: what this message is about was only taken for that publisher's.
                if 0 <= track.last - sequence <= _MOST_LOST and track.about - frames:
                    track.about -= frames
            self._made += 1
            best = _Track(self._made, sequence, frames, self._heard, received_ns)
            self._tracks.append(best)
            if len(self._tracks) > _MOST:
                self._tracks.remove(min(self._tracks, key=lambda track: track.heard))
        best.last, best.heard, best.about = sequence, self._heard, best.about | frames
        best.last_ns = max(best.last_ns, received_ns)
        return best.number


def _rank(track: _Track, sequence: int, frames: frozenset[str]) -> tuple[int, int, float]:
    """How much speaks for a publisher: the likeness, then how near the number is, then how many frames both have."""
    shared = len(track.about & frames) / len(track.about | frames) if frames else 0.0
    return _likeness(track, sequence, frames), track.last - sequence, shared


def _likeness(track: _Track, sequence: int, frames: frozenset[str]) -> int:
    """3: the next number and about the same frames; 2: the same frames; 1: the next number; 0: neither."""
    return 2 * bool(track.about & frames) + (sequence == track.last + 1)
