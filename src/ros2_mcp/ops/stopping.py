"""Stop everything that this server has set in motion, and say what was confirmed."""

from __future__ import annotations

import asyncio
from collections.abc import Sequence
from dataclasses import dataclass

from ros2_mcp.guard.running import SentGoal
from ros2_mcp.model.errors import RobotError
from ros2_mcp.model.goals import TERMINAL
from ros2_mcp.ops import actions
from ros2_mcp.robot import Robot

ENDED_S = 3.0


@dataclass(frozen=True, slots=True)
class StoppedTopic:
    """A topic that got a zero command; `acknowledged` is null where that is not known."""

    topic_name: str
    subscribers: int
    acknowledged: bool | None
    error: str = ""


@dataclass(frozen=True, slots=True)
class StoppedGoal:
    """A goal that was asked to be cancelled, and its status when the waiting ended; `confirmed` once it has ended."""

    action_name: str
    goal_id: str
    status: str
    confirmed: bool
    error: str = ""


@dataclass(frozen=True, slots=True)
class Stopped:
    """What was stopped. `confirmed` is true if every zero command reached a subscriber and every goal ended."""

    repeats_stopped: int
    topics: Sequence[StoppedTopic]
    goals: Sequence[StoppedGoal]
    confirmed: bool
    note: str

    def summary(self) -> str:
        """One line."""
        return (
            f"{'Stopped' if self.confirmed else 'NOT confirmed'}: {self.repeats_stopped} repeated publication(s), zero "
            f"on {len(self.topics)} topic(s), {len(self.goals)} goal(s) cancelled. {self.note}"
        ).rstrip()


async def stop(robot: Robot) -> Stopped:
    """Ends every repeated publication, sends zero on every velocity topic driven, cancels every goal sent.

    Raises:
        LinkError: if the bridge cannot be reached at all.
    """
    repeats = (await robot.graph.ask("stop")).ok["repeats"]
    topics, goals = await asyncio.gather(
        asyncio.gather(*(_zero(robot, topic, kind) for topic, kind in robot.driven.zeros)),
        asyncio.gather(*(_cancel(robot, goal) for goal in robot.goals.open.values())),
    )
    confirmed = all(topic.subscribers and topic.acknowledged is not False for topic in topics)
    note = "" if topics or goals or repeats else "This server had nothing in motion."
    return Stopped(repeats, topics, goals, confirmed and all(goal.confirmed for goal in goals), note)


async def _zero(robot: Robot, topic: str, kind: str) -> StoppedTopic:
    try:
        sent = await robot.publish(topic, kind, {}, wait_match_s=0.2, wait_ack_s=0.5)
    except RobotError as error:
        return StoppedTopic(topic, 0, False, str(error))
    return StoppedTopic(topic, sent.matched, sent.acked)


async def _cancel(robot: Robot, goal: SentGoal) -> StoppedGoal:
    try:
        await actions.cancel(robot, goal.action, goal.goal_id)
        ended = await actions.request_result(robot, goal.action, goal.action_type, goal.goal_id, timeout_s=ENDED_S)
    except RobotError as error:
        return StoppedGoal(goal.action, goal.goal_id, "UNKNOWN", False, str(error))
    return StoppedGoal(goal.action, goal.goal_id, ended.status, ended.status_code in TERMINAL)
