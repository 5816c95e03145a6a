"""`ros2_action_subscribe_feedback`: the feedback that action servers publish about the progress of goals."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from time import monotonic
from typing import Any

from ros2_mcp.guard.policy import bounded
from ros2_mcp.model import names
from ros2_mcp.model.goals import goal_id_bytes, goal_id_hex
from ros2_mcp.model.text import counted
from ros2_mcp.ops.actions.status import MAX_MESSAGES, SERVER_S
from ros2_mcp.ops.results.results import IF_ANY, SAID, Report, iso_time, reporting, silent
from ros2_mcp.robot import Robot
from ros2_mcp_common.wire.limits import MAX_DURATION_S


@dataclass(frozen=True, slots=True)
class FeedbackMessage:
    """One feedback message of one goal; `recv_stamp` is ISO 8601."""

    goal_id: str
    feedback: dict[str, Any]
    recv_stamp: str


@dataclass(frozen=True, slots=True)
class FeedbackMessages:
    """The feedback that an action published during the call, for one goal or for all. `omitted` counts messages that
    did not fit.
    """

    topic: str
    action_type: str
    goal_id_filter: str | None
    duration_sec: float = field(metadata=SAID)
    messages: Sequence[FeedbackMessage]
    omitted: int
    note: str = field(metadata=IF_ANY)

    def summary(self) -> str:
        """Return the result in one line."""
        return f"{counted(len(self.messages), 'feedback message')} in {self.duration_sec:.2f} s. {self.note}".rstrip()


async def follow_feedback(
    robot: Robot,
    action: str,
    action_type: str = "",
    *,
    goal_id: str | None = None,
    duration_s: float = 5.0,
    max_messages: int = 100,
    max_bytes: int,
    report: Report = silent,
) -> FeedbackMessages:
    """Return the feedback of an action's goals over some seconds, as JSON of at most
    `max_bytes` (but at least one message).

    Raises:
        NotFound: if there is no such action.
        BadValue: if the goal id is malformed.
    """
    only_goal = goal_id_hex(goal_id_bytes(goal_id)) if goal_id else None
    bounded("duration_sec", duration_s, 0.0, MAX_DURATION_S, "s")
    bounded("max_messages", max_messages, 1, MAX_MESSAGES, "messages")
    action = names.absolute(action, "action")
    action_type = await robot.types.action(action, action_type)
    topic, started = f"{action}/_action/feedback", monotonic()
    messages: list[FeedbackMessage] = []
    omitted, size = 0, 0
    async with (
        reporting(report, duration_s, f"{topic}: listening"),
        robot.listen(topic, f"{action_type}_FeedbackMessage", wait_s=SERVER_S) as listening,
    ):
        async for sample in listening.samples(duration_s):
            rendered = await robot.values.render(listening.type, sample.data)
            sender = goal_id_hex(rendered.value["goal_id"]["uuid"])
            if only_goal not in (None, sender):
                continue
            size += rendered.bytes
            if size > max_bytes and messages:
                omitted += 1
                continue
            messages.append(FeedbackMessage(sender, rendered.value["feedback"], iso_time(sample.received_ns)))
            if len(messages) >= max_messages:
                break
    note = "" if messages else "No feedback: no goal is running, or the server publishes none."
    if omitted:
        note = f"Not shown, to keep the answer short: the last {counted(omitted, 'message')}."
    return FeedbackMessages(topic, action_type, only_goal, monotonic() - started, messages, omitted, note)
