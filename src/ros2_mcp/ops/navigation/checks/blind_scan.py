"""A scan that comes, and in which no beam ends at anything: a covered lidar, or a lidar without power for its laser."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from ros2_mcp.model.text import named
from ros2_mcp.ops.navigation.checks.check import SENSORS, NavCheck
from ros2_mcp.ops.navigation.evidence import SCAN, NavEvidence, NavFinding

_LEAST_SCANS = 3


def _find(evidence: NavEvidence) -> Iterator[NavFinding]:
    for one in evidence.of(SCAN):
        scans = [message for _, message, _ in one.messages]
        if len(scans) < _LEAST_SCANS or not len(scans[-1].ranges) or any(map(_sees, scans)):
            continue
        yield NavFinding(
            rank="makes it worse",
            subject=one.topic,
            cause=f"The scan sees nothing at all: 0 of {len(scans[-1].ranges)} beams of {named(one.topic)} end at "
            "something.",
            proof=f"No range of {len(scans)} scans is a number of metres: all are infinite or NaN.",
            remedy="See whether the lidar is covered, or set to another range; in a hall larger than its range, "
            "localisation needs another sensor.",
        )


def _sees(scan: Any) -> bool:
    import numpy as np

    return bool(np.isfinite(np.asarray(scan.ranges, dtype=float)).any())


CHECK = NavCheck(("heard",), _find, SENSORS)
