"""The arrival times of a topic's messages, and their ages by the header's stamp.

Import it inside functions only: it needs NumPy.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from ros2_mcp.bags.stored import LEAST_BACK_NS
from ros2_mcp.model.samples import STAMP_END, Sample, header_stamp_ns
from ros2_mcp.model.text import counted
from ros2_mcp.ops.measure.columns import Arrivals, Room
from ros2_mcp.ops.sources.source import Stream

OLD_S = 1.0
"""Stamps further than this from the time of receipt are of no use to tf2 and Nav2, which wait for tenths of a second.
All messages of a span must be so, so that one moment in which a machine hung is not reported as a fault of the sensor.
"""
_OTHER_CLOCK_S = 1e6
"""A stamp further than this (eleven days) from the time of receipt is from another clock:
simulated time begins at zero."""


@dataclass(frozen=True, slots=True)
class Ages:
    """The ages of messages when they were received, by the header's stamp; negative if the stamp is in the future."""

    min_s: float
    mean_s: float
    max_s: float

    @property
    def trouble(self) -> str:
        """A sentence on a fault that all ages show; empty if there is none."""
        if self.min_s > OLD_S:
            return f"Its stamps are {self.mean_s:.3g} s old on average: messages are late, or its clock is behind."
        if self.max_s < -OLD_S:
            return f"Its stamps are {-self.mean_s:.3g} s in the future on average: its clock is ahead."
        return ""


class AgedArrivals(Arrivals):
    """Arrival times and, for messages that begin with a header, ages: their number, mean, least and largest.

    Stamps of 0 are counted in `unstamped`, stamps of another clock in `of_other_clock`; neither has an age.
    """

    def __init__(self, stream: Stream, room: Room) -> None:
        super().__init__(room, stream.is_replayed)
        self.publishers = stream.publishers
        self.aged = self.unstamped = self.of_other_clock = 0
        self.stamp_backs = 0
        self._first_back = ""
        self._stamp_ns = 0
        self.age_min_s = float("inf")
        self.age_max_s = -float("inf")
        self._age_sum_s = 0.0
        self._has_header = stream.codec.definitions.starts_with_header(stream.type)

    @property
    def age_mean_s(self) -> float:
        """The mean age in s."""
        return self._age_sum_s / self.aged if self.aged else 0.0

    @property
    def ages(self) -> Ages | None:
        """The ages; None if there are none."""
        if not self.aged:
            return None
        return Ages(self.age_min_s, self.age_mean_s, self.age_max_s)

    def add(self, samples: Sequence[Sample]) -> None:
        """Add messages, in the order of time."""
        number = self.count
        super().add(samples)
        for sample in samples if self._has_header else ():
            if self._is_replayed(sample):
                continue
            number += 1
            if len(sample.data) >= STAMP_END:
                stamp_ns = header_stamp_ns(sample.data)
                self._add_age(sample.received_ns, stamp_ns)
                self._add_stamp(number, stamp_ns)

    @property
    def goes_back(self) -> str:
        """A sentence on where the stamps of the only publisher go back; empty if they do not,
        or there are several publishers.
        """
        if not self.stamp_backs or len(self.publishers) > 1:
            return ""
        more = f", and {counted(self.stamp_backs - 1, 'time')} more" if self.stamp_backs > 1 else ""
        return f"Its stamps go back at {self._first_back}{more}."

    def _add_stamp(self, number: int, stamp_ns: int) -> None:
        by_ns = self._stamp_ns - stamp_ns
        if stamp_ns and by_ns >= LEAST_BACK_NS:
            self.stamp_backs += 1
            self._first_back = self._first_back or f"message {number} by {by_ns / 1e9:.4g} s"
        self._stamp_ns = stamp_ns or self._stamp_ns

    def _add_age(self, received_ns: int, stamp_ns: int) -> None:
        age_s = (received_ns - stamp_ns) / 1e9
        if not stamp_ns:
            self.unstamped += 1
        elif abs(age_s) >= _OTHER_CLOCK_S:
            self.of_other_clock += 1
        else:
            self.aged += 1
            self._age_sum_s += age_s
            self.age_min_s, self.age_max_s = min(self.age_min_s, age_s), max(self.age_max_s, age_s)
