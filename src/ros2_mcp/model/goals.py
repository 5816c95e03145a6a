"""Goals of actions: their ids and states."""

from __future__ import annotations

import uuid
from collections.abc import Mapping, Sequence
from typing import Any

from ros2_mcp.model.errors import BadValue

STATUS: Mapping[int, str] = {
    -1: "NOT_ACCEPTED",
    0: "UNKNOWN",
    1: "ACCEPTED",
    2: "EXECUTING",
    3: "CANCELING",
    4: "SUCCEEDED",
    5: "CANCELED",
    6: "ABORTED",
}
"""Codes of action_msgs/msg/GoalStatus, and -1 for a goal that was never accepted."""

TERMINAL = frozenset({4, 5, 6})

CANCEL_CODES: Mapping[int, str] = {
    0: "ERROR_NONE",
    1: "ERROR_REJECTED",
    2: "ERROR_UNKNOWN_GOAL_ID",
    3: "ERROR_GOAL_TERMINATED",
}
"""Codes of action_msgs/srv/CancelGoal."""

CANCEL_TYPE = "action_msgs/srv/CancelGoal"
STATUS_TYPE = "action_msgs/msg/GoalStatusArray"
"""The type of the latched topic `<action>/_action/status`, on which an action server publishes the states of its
goals."""


def new_goal_id() -> str:
    """Return a new goal id: 32 hexadecimal digits."""
    return uuid.uuid4().hex


def goal_id_bytes(goal_id: str) -> list[int]:
    """Return the 16 bytes of a goal id, as in unique_identifier_msgs/msg/UUID.

    Raises:
        BadValue: if it is not 32 hexadecimal digits, or all zeros, which means every goal.
    """
    try:
        raw = uuid.UUID(hex=goal_id)
    except ValueError as error:
        raise BadValue("goal_id_hex", f"{goal_id!r} is not a goal id.", "Give its 32 hexadecimal digits.") from error
    if not raw.int:
        raise BadValue("goal_id_hex", "an id of zeros stands for every goal.", "Give the id of one goal.")
    return list(raw.bytes)


def cancel_request(goal_id: str = "", stamp: Mapping[str, int] | None = None) -> dict[str, Any]:
    """Return the request that cancels one goal; without a goal id, all goals accepted up to the stamp, or all."""
    raw_id = goal_id_bytes(goal_id) if goal_id else [0] * 16
    return {"goal_info": {"goal_id": {"uuid": raw_id}, "stamp": dict(stamp or {"sec": 0, "nanosec": 0})}}


def goal_id_hex(raw: Sequence[int]) -> str:
    """Return the goal id of 16 bytes."""
    return bytes(raw).hex()


def stamp_seconds(stamp: Mapping[str, Any]) -> float:
    """Convert a builtin_interfaces/msg/Time to seconds."""
    return int(stamp["sec"]) + int(stamp["nanosec"]) / 1e9
