"""Assign the messages of a topic to their publishers, by the sequence numbers of the messages.

rclpy gives the sequence number of a message but not its publisher. Each publisher numbers its messages consecutively,
so messages with consecutive numbers have the same publisher.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable, Mapping
from dataclasses import dataclass

_MOST_LOST = 200
"""Messages that may be missing between two of one publisher: seconds of a fast topic."""
_MOST = 64
"""Publishers that are distinguished; the publisher with the oldest last message is forgotten."""


@dataclass(slots=True)
class _Track:
    number: int
    last: int
    about: frozenset[str]
    heard: int
    first_ns: int = 0
    last_ns: int = 0


class Writers:
    """The publishers of one topic, numbered from 1.

    With `by_frames` a message about new frames is assigned to a new publisher, whatever its number: each publisher of a
    latched topic sends only one or two messages, so consecutive numbers mean nothing.
    """

    def __init__(self, *, by_frames: bool = False) -> None:
        self._by_frames = by_frames
        self._tracks: list[_Track] = []
        self._lasts: deque[int] = deque(maxlen=_MOST)
        self._made = 0
        self._heard = 0

    @property
    def frames(self) -> Mapping[int, frozenset[str]]:
        """The frames in the messages of each publisher."""
        return {track.number: track.about for track in self._tracks}

    @property
    def heard_ns(self) -> Mapping[int, tuple[int, int]]:
        """Receive times (ns) of the first and the last message of each publisher."""
        return {track.number: (track.first_ns, track.last_ns) for track in self._tracks}

    @property
    def count(self) -> int:
        """The number of publishers.

        A publisher that takes over another's frames may be counted twice, and lost messages break sequences of numbers,
        so the smaller of both counts is returned.
        """
        return len(self._tracks) if self._by_frames else min(len(self._tracks), len(self._lasts))

    def of(self, sequence: int | None, about: Iterable[str], received_ns: int = 0) -> int:
        """Return the publisher of a message by its sequence number and frames; 0 without a sequence number."""
        if sequence is None:
            return 0
        self._heard += 1
        if sequence - 1 in self._lasts:
            self._lasts.remove(sequence - 1)
        self._lasts.append(sequence)
        frames = frozenset(about)
        fitting = [track for track in self._tracks if 0 < sequence - track.last <= _MOST_LOST]
        # A consecutive number and equal frames are stronger evidence than a number that is only near.
        best = max(fitting, key=lambda one: _rank(one, sequence, frames), default=None)
        if best is None or _likeness(best, sequence, frames) < (2 if self._by_frames else 1):
            for track in self._tracks:
                # This number is in use, so the message is from another publisher: its frames were wrongly assigned.
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
    """Rank a publisher: by likeness, then by how near the number is, then by the share of common frames."""
    shared = len(track.about & frames) / len(track.about | frames) if frames else 0.0
    return _likeness(track, sequence, frames), track.last - sequence, shared


def _likeness(track: _Track, sequence: int, frames: frozenset[str]) -> int:
    """Return 3 for the next number and common frames, 2 for common frames, 1 for the next number, 0 for neither."""
    return 2 * bool(track.about & frames) + (sequence == track.last + 1)
