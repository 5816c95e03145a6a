"""What a late subscriber of a latched topic still needs, for files that stand by themselves."""

from __future__ import annotations

from collections.abc import Collection

from ros2_mcp.bags.writer import MESSAGE_BYTES
from ros2_mcp.model.samples import Sample

MOST_MESSAGES = 32
"""Of one topic. /tf_static has a publisher for each driver and one message of each; more than 32 are rare."""


class LatchedTopic:
    """The last messages of a latched topic: several, for they may be of several publishers; equal ones once.

    There are at most `MOST_MESSAGES`, with at most `most_bytes` in a file; the last one is always among them.
    """

    def __init__(self, most_bytes: int) -> None:
        self._most_bytes = most_bytes
        self._samples: dict[bytes, Sample] = {}
        self.bytes = 0

    @property
    def samples(self) -> Collection[Sample]:
        """The messages, the oldest first."""
        return self._samples.values()

    def add(self, sample: Sample) -> None:
        """Takes a message; the oldest ones give way to it."""
        if self._samples.pop(sample.data, None) is None:
            self.bytes += _size(sample.data)
        self._samples[sample.data] = sample
        while len(self._samples) > 1 and (self.bytes > self._most_bytes or len(self._samples) > MOST_MESSAGES):
            oldest = next(iter(self._samples))
            del self._samples[oldest]
            self.bytes -= _size(oldest)


def _size(data: bytes) -> int:
    return len(data) + MESSAGE_BYTES
