"""The tree of coordinate frames that tf2_msgs/msg/TFMessage tells: where one frame is in another, seen from above."""

from __future__ import annotations

import math
from collections.abc import Iterable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ros2_mcp.model.pictures import Place

BASES = ("base_link", "base_footprint")
"""What the frame of a robot's body is called, by REP 105; with a prefix where there are several robots."""
_DEEPEST = 100
"""Frames from a leaf to the root; deeper trees go in circles."""

Matrix = NDArray[np.float64]


class Frames:
    """Each frame with its parent and where it is in it; a later message replaces an earlier one."""

    def __init__(self, messages: Iterable[Any]) -> None:
        self._parents: dict[str, tuple[str, Matrix]] = {}
        for message in messages:
            for one in message.transforms:
                child, parent = one.child_frame_id.lstrip("/"), one.header.frame_id.lstrip("/")
                self._parents[child] = parent, _matrix(one.transform.translation, one.transform.rotation)

    def robot_in(self, frame: str) -> Place | None:
        """Where the robot's body is in a frame; None if that is not told, or of which robot is not clear."""
        known = {*self._parents, *(parent for parent, _ in self._parents.values())}
        for base in BASES:
            found = [base] if base in known else [name for name in known if name.rpartition("/")[2] == base]
            if len(found) == 1:
                return self._place(found[0], frame.lstrip("/"))
        return None

    def _place(self, frame: str, within: str) -> Place | None:
        root, to_root = self._to_root(frame)
        other_root, other_to_root = self._to_root(within)
        if root != other_root:
            return None
        matrix = np.linalg.inv(other_to_root) @ to_root
        return Place(float(matrix[0, 3]), float(matrix[1, 3]), math.atan2(matrix[1, 0], matrix[0, 0]))

    def _to_root(self, frame: str) -> tuple[str, Matrix]:
        matrix = np.eye(4)
        for _ in range(_DEEPEST):
            if frame not in self._parents:
                break
            frame, step = self._parents[frame]
            matrix = step @ matrix
        return frame, matrix


def place_of(pose: Any) -> Place:
    """A geometry_msgs/msg/Pose seen from above."""
    matrix = _matrix(pose.position, pose.orientation)
    return Place(pose.position.x, pose.position.y, math.atan2(matrix[1, 0], matrix[0, 0]))


def _matrix(at: Any, q: Any) -> Matrix:
    matrix = np.eye(4)
    matrix[:3, 3] = at.x, at.y, at.z
    matrix[:3, :3] = (
        (1 - 2 * (q.y**2 + q.z**2), 2 * (q.x * q.y - q.z * q.w), 2 * (q.x * q.z + q.y * q.w)),
        (2 * (q.x * q.y + q.z * q.w), 1 - 2 * (q.x**2 + q.z**2), 2 * (q.y * q.z - q.x * q.w)),
        (2 * (q.x * q.z - q.y * q.w), 2 * (q.y * q.z + q.x * q.w), 1 - 2 * (q.x**2 + q.y**2)),
    )
    return matrix
