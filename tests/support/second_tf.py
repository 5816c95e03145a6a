"""tf2's look-up a second time, from the formulas and by other ways: 4 × 4 matrices and exact fractions of time.

Rotations are matrices here, interpolated by the angle about their common axis (Rodrigues), where `world/transforms.py`
has quaternions and slerp.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from fractions import Fraction

import numpy as np
from numpy.typing import NDArray

Matrix = NDArray[np.float64]


def matrix(at: Sequence[float], q: Sequence[float]) -> Matrix:
    """The homogeneous matrix of a translation and a unit quaternion (x, y, z, w)."""
    x, y, z, w = q
    turn = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    result = np.eye(4)
    result[:3, :3] = np.eye(3) + 2 * w * turn + 2 * turn @ turn
    result[:3, 3] = at
    return result


def half_way(first: Matrix, second: Matrix, share: float) -> Matrix:
    """The place goes straight; the rotation turns by that share of the angle about the axis between the two."""
    step = first[:3, :3].T @ second[:3, :3]
    axis = np.array([step[2, 1] - step[1, 2], step[0, 2] - step[2, 0], step[1, 0] - step[0, 1]])
    sine, cosine = float(np.linalg.norm(axis)) / 2, (float(np.trace(step)) - 1) / 2
    angle = math.atan2(sine, cosine) * share
    result = np.eye(4)
    result[:3, :3] = first[:3, :3]
    if sine > 0:
        x, y, z = axis / np.linalg.norm(axis)
        turn = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
        result[:3, :3] = first[:3, :3] @ (np.eye(3) + math.sin(angle) * turn + (1 - math.cos(angle)) * turn @ turn)
    result[:3, 3] = first[:3, 3] + share * (second[:3, 3] - first[:3, 3])
    return result


class SecondTree:
    """`told`: child → (parent, stamp in ns → matrix); a static one has the only key None."""

    def __init__(self, told: Mapping[str, tuple[str, Mapping[int | None, Matrix]]]) -> None:
        self._told = told

    def step(self, child: str, at_ns: int) -> Matrix | None:
        stamps = self._told[child][1]
        if None in stamps:
            return stamps[None]
        before = [stamp for stamp in stamps if stamp is not None and stamp <= at_ns]
        after = [stamp for stamp in stamps if stamp is not None and stamp >= at_ns]
        if not before or not after:
            return None
        first, second = max(before), min(after)
        share = Fraction(at_ns - first, second - first) if second > first else Fraction(0)
        return half_way(stamps[first], stamps[second], float(share))

    def line(self, frame: str) -> list[str]:
        names = [frame]
        while names[-1] in self._told:
            names.append(self._told[names[-1]][0])
        return names

    def lookup(self, target: str, frame: str, at_ns: int) -> Matrix | None:
        ours, theirs = self.line(frame), self.line(target)
        common = next((name for name in ours if name in theirs), None)
        if common is None:
            return None
        both: list[Matrix] = []
        for names in (theirs, ours):
            whole = np.eye(4)
            for child in names[: names.index(common)]:
                step = self.step(child, at_ns)
                if step is None:
                    return None
                whole = step @ whole
            both.append(whole)
        return np.linalg.inv(both[0]) @ both[1]

    def latest(self, target: str, frame: str) -> int | None:
        """The newest time that all have: the smallest of the newest stamps of the moving edges between the two."""
        ours, theirs = self.line(frame), self.line(target)
        between = set(ours) ^ set(theirs)
        newest = [
            max(stamp for stamp in self._told[child][1] if stamp is not None)
            for child in between
            if child in self._told and None not in self._told[child][1]
        ]
        return min(newest, default=None)
