"""How it is said that the bridge, or a stop, has ended or held back what was begun."""

from __future__ import annotations

from collections.abc import Mapping

from ros2_mcp_bridge.protocol import EndedBy

REASONS: Mapping[EndedBy, str] = {
    "stop": "ros2_stop",
    "lease": "the bridge, which had not heard from this server for longer than the link lease",
}
"""What the bridge says has ended something → a job's `stop_reason`."""


def ended_by(reason: str) -> str:
    """The sentence that says what ended a job before its time."""
    return f"It was ended by {reason}."


def held_back(count: int) -> str:
    """The sentence about velocities that the bridge has not published."""
    return f"{count} message(s) were held back by the bridge: a velocity that is not finite, or cannot be decoded."
