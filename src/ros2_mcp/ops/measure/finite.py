"""Detection of NaN and infinities in messages of motion: a NaN in odometry or IMU data spreads to all values computed
from it.

Messages are not decoded: in these types all numbers except those of the header are float64 at the end of the message.
Import it inside functions only: it needs NumPy.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from ros2_mcp.model.samples import Sample
from ros2_mcp.ops.sources.source import Stream

_IMU = "sensor_msgs/msg/Imu"
_FIELDS: Mapping[str, Sequence[tuple[str, int]]] = {
    "nav_msgs/msg/Odometry": (
        ("pose.pose", 7),
        ("pose.covariance", 36),
        ("twist.twist", 6),
        ("twist.covariance", 36),
    ),
    _IMU: (
        ("orientation", 4),
        ("orientation_covariance", 9),
        ("angular_velocity", 3),
        ("angular_velocity_covariance", 9),
        ("linear_acceleration", 3),
        ("linear_acceleration_covariance", 9),
    ),
    "geometry_msgs/msg/PoseStamped": (("pose", 7),),
    "geometry_msgs/msg/PoseWithCovarianceStamped": (("pose.pose", 7), ("pose.covariance", 36)),
}
"""The fields at the end of a message in order, with the count of numbers in each."""
MOTION_TYPES = frozenset(_FIELDS)
"""Types that hold the pose or the motion of a robot."""

_NUMBER_BYTES = 8
_HEADER_BYTES = 4
"""Size of the CDR header; its second byte gives the byte order."""


class Finite:
    """Count of messages with values that are not finite, among all that were checked, and the `fields` concerned.

    Values that an IMU marks as unknown (its covariance begins with -1) are ignored. Times are Unix times in ns.
    """

    def __init__(self, stream: Stream) -> None:
        fields = _FIELDS[stream.type]
        self.looked_at = self.found = 0
        self.first_ns = 0
        self._has_unknowns = stream.type == _IMU
        self._names = [name for name, _ in fields]
        self._numbers = sum(count for _, count in fields)
        self._begins = np.cumsum([0, *(count for _, count in fields[:-1])])
        self._counts: dict[str, int] = {}

    @property
    def fields(self) -> Sequence[str]:
        """Fields that were not finite at least once, in the order of the message."""
        return [name for name in self._names if name in self._counts]

    def add(self, samples: Sequence[Sample]) -> None:
        """Add messages, in the order of time."""
        for sample in samples:
            self._look_at(sample)

    def _look_at(self, sample: Sample) -> None:
        size = self._numbers * _NUMBER_BYTES
        if len(sample.data) < _HEADER_BYTES + size:
            return  # shorter than its type requires, which is reported elsewhere
        self.looked_at += 1
        order = "<" if sample.data[1] & 1 else ">"
        numbers = np.frombuffer(sample.data[-size:], f"{order}f8")
        if np.isfinite(numbers).all():
            return
        bad = np.add.reduceat(~np.isfinite(numbers), self._begins) > 0
        if self._has_unknowns:  # each odd field is the covariance of the one before it
            bad[::2] &= numbers[self._begins[1::2]] != -1.0
        if not bad.any():
            return
        self.first_ns = self.first_ns or sample.received_ns
        self.found += 1
        for at in np.flatnonzero(bad):
            self._counts[self._names[at]] = self._counts.get(self._names[at], 0) + 1
