"""How it is said that the bridge, or a stop, has ended or held back what was begun, and what it waited for."""

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
"""What the bridge says has ended something → a job's `stop_reason`; the latch has a cause besides (`reason_of`)."""


def reason_of(robot: Robot, ended_by: EndedBy) -> str:
    """What the bridge says has ended something, as a job's `stop_reason`: the latch with who has set it, and why."""
    return latch_set_by(robot.graph.latched_by) if ended_by == "latch" else REASONS.get(ended_by, "")


def ended_by(reason: str) -> str:
    """The sentence that says what ended a job before its time."""
    return f"It was ended by {reason.rstrip('.')}."


def held_back(count: int) -> str:
    """The sentence about messages that the bridge has not published."""
    return (
        f"The bridge held back {counted(count, 'message')}: forbidden by the policy, or velocities that are not finite "
        "or cannot be decoded."
    )


def limited(count: int) -> str:
    """The sentence about messages of which the bridge has published less."""
    return f"The bridge reduced {counted(count, 'message')} to stay within the limits and ramps of the policy."


def guarded(waited_s: float, problem: str) -> str:
    """The sentences about the stopper: how long it was waited for, and why there is none; empty if all is as ever."""
    waited = f"It waited {waited_s:.1f} s for the stopper, which sends the zero if the bridge dies."
    without = f"There is no stopper ({problem}): if the bridge dies, the zero comes from its successor."
    return " ".join([*([waited] if waited_s else []), *([without] if problem else [])])
