"""When the messages of a topic came, and how old they were then by their header's stamp.

Import it inside functions only: it needs NumPy.
"""

from __future__ import annotations

from collections.abc import Sequence

from ros2_mcp.model.samples import Sample, header_stamp_ns
from ros2_mcp.ops.measure.columns import Arrivals, Room
from ros2_mcp.ops.sources.source import Stream

_STAMP_END = 12
"""Bytes up to the end of a header's stamp: 4 of the CDR encapsulation, 4 of seconds, 4 of nanoseconds."""


class AgedArrivals(Arrivals):
    """Of messages that begin with a header also their ages: how many, and of these the sum and the largest.

    A latched message from before the stream's time is none of it.
    """

    def __init__(self, stream: Stream, room: Room) -> None:
        super().__init__(room)
        self.publishers = stream.publishers
        self.aged = 0
        self.age_max_s = -float("inf")
        self._age_sum_s = 0.0
        self._start_ns = stream.start_ns
        self._has_header = stream.codec.definitions.starts_with_header(stream.type)

    @property
    def age_mean_s(self) -> float:
        """The mean age."""
        return self._age_sum_s / self.aged if self.aged else 0.0

    def add(self, samples: Sequence[Sample]) -> None:
        """Takes in messages, in the order of time."""
        samples = [sample for sample in samples if sample.received_ns >= self._start_ns]
        super().add(samples)
        for sample in samples if self._has_header else ():
            if len(sample.data) >= _STAMP_END:
                age_s = (sample.received_ns - header_stamp_ns(sample.data)) / 1e9
                self.aged += 1
                self._age_sum_s += age_s
                self.age_max_s = max(self.age_max_s, age_s)
