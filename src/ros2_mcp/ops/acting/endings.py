"""Sentences about jobs that the bridge or a stop ended, messages that the bridge held back, and the stopper."""

from __future__ import annotations

from collections.abc import Mapping

from ros2_mcp.model.errors import LEASE, latch_set_by
from ros2_mcp.model.text import counted
from ros2_mcp.robot import Robot
from ros2_mcp_common.wire.protocol import EndedBy

REASONS: Mapping[EndedBy, str] = {
    "stop": "ros2_stop",
    "lease": LEASE,
    "stopper": "the death of the stopper, the process that stops the robot if the bridge dies",
}
"""What ended something, as the bridge reports it → a job's `stop_reason`. A latch has a cause as well (`reason_of`)."""


def reason_of(robot: Robot, ended_by: EndedBy) -> str:
    """Return a job's `stop_reason` for what the bridge reports; for a latch, with who set it and why, and for a
    keep-out zone, with the place.
    """
    if ended_by == "keep_out":
        return f"the policy, before a keep-out zone: {robot.graph.kept_out or 'the robot was about to enter it'}"
    return latch_set_by(robot.graph.latched_by) if ended_by == "latch" else REASONS.get(ended_by, "")


def ended_by(reason: str) -> str:
    """Return the sentence that says what ended a job early."""
    return f"It was ended by {reason.rstrip('.')}."


def held_back(count: int) -> str:
    """Return the sentence about messages that the bridge has not published."""
    return (
        f"The bridge held back {counted(count, 'message')}: forbidden by the policy, or velocities that are not finite "
        "or cannot be decoded."
    )


def limited(count: int) -> str:
    """Return the sentence about messages that the bridge has published with reduced values."""
    return f"The bridge reduced {counted(count, 'message')} to stay within the limits and ramps of the policy."


def guarded(waited_s: float, problem: str) -> str:
    """Return sentences about the stopper: how long it was waited for, and why there is
    none; empty in the usual case.
    """
    waited = f"It waited {waited_s:.1f} s for the stopper, which sends the zero if the bridge dies."
    without = f"There is no stopper ({problem}): if the bridge dies, the zero comes from its successor."
    return " ".join([*([waited] if waited_s else []), *([without] if problem else [])])
