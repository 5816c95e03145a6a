"""The state of one caller of a robot; the robot itself is shared by all callers."""

from __future__ import annotations

from dataclasses import dataclass, field

from ros2_mcp.model.commands import Principal
from ros2_mcp.robot.stops import Accepted


@dataclass(eq=False, slots=True, kw_only=True)
class Session:
    """One call of a caller, or one job that it has begun. Everything that acts has a session (`Robot.session`).

    `principal` is the caller. `accepted` is when the call was accepted: a later stop holds back everything that the
    call has not sent. `notes` are sentences for the result. With a list `rehearsed` nothing is carried out: the list
    gets each command with the policy's decision.
    """

    principal: Principal
    accepted: Accepted
    notes: list[str] = field(default_factory=list[str])
    rehearsed: list[str] | None = None
