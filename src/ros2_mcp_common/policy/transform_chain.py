"""A robot's pose from the transforms on `/tf`: the transforms from one frame down to the base, in the plane. Needs no
ROS.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

from ros2_mcp_common.geometry import yaw_rad
from ros2_mcp_common.policy.field_values import Unfit, get, is_list
from ros2_mcp_common.policy.keep_out import Pose

# The most transforms from the map to the base: robots have two or three.
MOST_EDGES = 16
# The most frames that are kept: those of a robot with many joints. Further names are not kept.
MOST_FRAMES = 1000
TF = "tf2_msgs/msg/TFMessage"


@dataclass(frozen=True)
class _Edge:
    parent: str
    pose: Pose
    stamp: tuple[int, int]
    heard_at: float


class TransformChain:
    """The newest transforms by child frame. A transform is as old as the message that first had its stamp.

    So a node that repeats an old transform does not make it new. Roll and pitch are left out, which holds on a floor.
    """

    def __init__(self, frame_id: str, base: str) -> None:
        self._frame_id, self._base = frame_id, base
        self._edges: dict[str, _Edge] = {}

    def take(self, message: Any, now: float) -> None:
        """Record a message of `TF`, received at `now` (monotonic, s). Frames beyond `MOST_FRAMES` are ignored."""
        try:
            transforms = get(message, "transforms")
        except Unfit:
            return
        for each in transforms if is_list(transforms) else ():
            child = str(get(each, "child_frame_id"))
            header, transform = get(each, "header"), get(each, "transform")
            stamp = get(header, "stamp")
            at = int(get(stamp, "sec")), int(get(stamp, "nanosec"))
            before = self._edges.get(child)
            if before is None and len(self._edges) >= MOST_FRAMES:
                continue
            heard_at = before.heard_at if before and before.stamp == at else now
            moved, turned = get(transform, "translation"), get(transform, "rotation")
            pose = Pose(float(get(moved, "x")), float(get(moved, "y")), yaw_rad(*(get(turned, one) for one in "xyzw")))
            self._edges[child] = _Edge(str(get(header, "frame_id")), pose, at, heard_at)

    def place(self, now: float, max_age_s: float) -> tuple[Pose, float]:
        """Return the pose of the base in the frame, and the age of the oldest transform of the chain in s.

        Raises:
            Unfit: if a transform is missing, older than `max_age_s` or not finite.
        """
        frame, pose, age_s = self._base, Pose(0.0, 0.0, 0.0), 0.0
        for _ in range(MOST_EDGES):
            if frame == self._frame_id:
                if not all(map(math.isfinite, pose)):
                    raise Unfit("its transforms are not finite")
                return pose, age_s
            edge = self._edges.get(frame)
            if edge is None:
                raise Unfit(f"it has no transform to {frame[:40]!a}")
            age_s = max(age_s, now - edge.heard_at)
            if age_s > max_age_s:
                raise Unfit(f"the transform from {edge.parent[:40]!a} to {frame[:40]!a} is {age_s:.1f} s old")
            pose, frame = _after(edge.pose, pose), edge.parent
        raise Unfit(f"no chain of {MOST_EDGES} transforms leads from {self._frame_id!a} to {self._base!a}")


def _after(first: Pose, then: Pose) -> Pose:
    """Return a pose that is given in a body's frame, in the frame of the body's pose."""
    cos, sin = math.cos(first.yaw), math.sin(first.yaw)
    x, y = first.x + cos * then.x - sin * then.y, first.y + sin * then.x + cos * then.y
    return Pose(x, y, math.remainder(first.yaw + then.yaw, 2 * math.pi))
