"""Where the simulated arm is sent by tests."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

ARM = ("shoulder_pan_joint", "shoulder_lift_joint", "elbow_joint", "wrist_1_joint", "wrist_2_joint", "wrist_3_joint")
HOME: Mapping[str, Any] = {
    **dict.fromkeys(ARM, 0.0),
    "shoulder_lift_joint": -0.6,
    "elbow_joint": 1.2,
    "wrist_1_joint": 0.6,
}


def far() -> dict[str, Any]:
    """With the shoulder turned by 1.6 rad."""
    return {**HOME, "shoulder_pan_joint": 1.6}


def trajectory(joints: Mapping[str, Any], seconds: float) -> dict[str, Any]:
    """A trajectory_msgs/msg/JointTrajectory of one point."""
    whole = int(seconds)
    at = {"sec": whole, "nanosec": int((seconds - whole) * 1e9)}
    point = {"positions": list(joints.values()), "velocities": [0.0] * len(joints), "time_from_start": at}
    return {"joint_names": list(joints), "points": [point]}
