"""What belongs to one caller of a robot, beside the robot that all callers share."""

from __future__ import annotations

from dataclasses import dataclass, field

from ros2_mcp.model.commands import Principal
from ros2_mcp.robot.stops import Accepted


@dataclass(eq=False, slots=True, kw_only=True)
class Session:
    """One call of one caller, or one job that it has begun. Whatever acts is given one (`Robot.session`).

    `principal` is who asks. `accepted` is when the call was accepted: a stop that comes after it holds back all that
    the call has not sent. `notes` are sentences for its result. With a list `rehearsed` nothing is done: what would be
    done is written there, with what the policy says of it.
    """

    principal: Principal
    accepted: Accepted
    notes: list[str] = field(default_factory=list[str])
    rehearsed: list[str] | None = None
