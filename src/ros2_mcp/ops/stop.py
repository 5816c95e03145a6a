"""Stop everything that this server has set in motion, and say what was confirmed."""

from __future__ import annotations

import asyncio
from collections.abc import Sequence
from dataclasses import dataclass

from ros2_mcp.model.commands import Publish
from ros2_mcp.model.errors import NotFound, RobotError, TimedOut
from ros2_mcp.model.goals import STATUS, TERMINAL
from ros2_mcp.ops.actions.cancel import UNKNOWN_GOAL, cancel_sent
from ros2_mcp.ops.actions.result import request_result
from ros2_mcp.robot import Robot
from ros2_mcp.robot.goals import Goal

ENDED_S = 3.0
"""An action server that is alive ends a cancelled goal within its control period; the answer must come soon."""
_MATCH_S = 0.2
"""The publisher is there already, as it drove: only one whose endpoint had expired needs a moment."""
_ACKNOWLEDGED_S = 0.5
"""A reliable subscriber acknowledges within milliseconds; what comes later is not confirmed."""


@dataclass(frozen=True, slots=True)
class StoppedTopic:
    """A topic that got a zero command.

    `acknowledged` is null where it is not known. `others` are nodes that publish on it too: their messages still move
    the robot.
    """

    topic_name: str
    subscribers: int
    acknowledged: bool | None
    others: Sequence[str] = ()
    error: str = ""


@dataclass(frozen=True, slots=True)
class StoppedGoal:
    """A goal that was asked to be cancelled, and its status when the waiting ended; `confirmed` once it has ended.

    `cancelled` is false for one that had ended already.
    """

    action_name: str
    goal_id: str
    status: str
    confirmed: bool
    cancelled: bool = False
    error: str = ""


@dataclass(frozen=True, slots=True)
class Stopped:
    """What was stopped.

    `confirmed` is true if every zero command reached the subscribers, nobody else publishes on those topics, and
    every goal has ended.
    """

    repeats_stopped: int
    relays_stopped: int
    topics: Sequence[StoppedTopic]
    goals: Sequence[StoppedGoal]
    confirmed: bool
    note: str

    def summary(self) -> str:
        """One line."""
        if not (self.repeats_stopped or self.relays_stopped or self.topics or self.goals):
            return f"Nothing was stopped. {self.note}"
        cancelled = sum(goal.cancelled for goal in self.goals)
        return (
            f"{'Stopped' if self.confirmed else 'NOT confirmed'}: {self.repeats_stopped} repeated publication(s) and "
            f"{self.relays_stopped} relay(s) ended, zero on {len(self.topics)} topic(s), {cancelled} goal(s) "
            f"cancelled, {len(self.goals) - cancelled} had ended already. {self.note}"
        ).rstrip()


async def stop(robot: Robot) -> Stopped:
    """Ends all repeated publishing and all relays, sends zero on every velocity topic driven, cancels every goal sent.

    Raises:
        LinkError: if the bridge cannot be reached at all.
    """
    ended = await robot.end_streams()  # first, and by the bridge itself: nothing it publishes comes after the zeros
    _, topics, goals = await asyncio.gather(
        robot.jobs.stop_moving("ros2_stop"),
        asyncio.gather(*(_zero(robot, topic, kind) for topic, kind in robot.failsafes.zeros)),
        asyncio.gather(*(_cancel(robot, goal) for goal in robot.jobs.running(Goal))),
    )
    confirmed = all(_is_still(topic) for topic in topics) and all(goal.confirmed for goal in goals)
    repeats, relays = ended["repeats"], ended["relays"]
    return Stopped(repeats, relays, topics, goals, confirmed, _note(repeats + relays, topics, goals))


def _is_still(topic: StoppedTopic) -> bool:
    """Whether nothing can come on it any more; where there is no subscriber, nothing had to arrive."""
    arrived = not topic.subscribers or topic.acknowledged is not False
    return arrived and not topic.others and not topic.error


def _note(streams: int, topics: Sequence[StoppedTopic], goals: Sequence[StoppedGoal]) -> str:
    if not (streams or topics or goals):
        return "This server had nothing in motion; what others have set in motion goes on."
    notes = [
        f"{', '.join(topic.others)} also publishes on {topic.topic_name}: the robot may still move."
        for topic in topics
        if topic.others
    ]
    for topic in topics:
        if not topic.subscribers and not topic.error:
            notes.append(f"Nobody subscribes to {topic.topic_name} now.")
    notes += [entry.error for entry in (*topics, *goals) if entry.error]
    notes += [f"Goal {goal.goal_id} has not ended yet." for goal in goals if not goal.confirmed and not goal.error]
    return " ".join(notes)


async def _zero(robot: Robot, topic: str, kind: str) -> StoppedTopic:
    try:
        to = await robot.types.destination(topic, kind)
        zero = Publish(
            principal=robot.principal,
            name=to.topic,
            type=to.type,
            value={},
            choice=to.choice,
            wait_match_s=_MATCH_S,
            wait_ack_s=_ACKNOWLEDGED_S,
        )
        sent = await robot.do(zero)
        publishers = (await robot.graph.endpoints(topic)).publishers
    except RobotError as error:
        return StoppedTopic(topic, 0, False, error=str(error))
    others = sorted({publisher.node for publisher in publishers} - {*robot.graph.own_nodes})
    return StoppedTopic(topic, sent.matched, sent.acked, others)


async def _cancel(robot: Robot, goal: Goal) -> StoppedGoal:
    """Cancels a goal and sees it end; one that its server does not know, or no longer, is not running."""
    try:
        answer = await cancel_sent(robot, goal.action, goal.id, ENDED_S)
        if answer.return_code == UNKNOWN_GOAL and goal.is_running and not goal.is_accepted:
            raise TimedOut(f"The server of {goal.action} has not said whether it accepts goal {goal.id}: stop again.")
        result = await request_result(robot, goal.action, goal.action_type, goal.id, timeout_s=ENDED_S)
    except RobotError as error:
        if isinstance(error, NotFound):
            robot.goal_ended(goal.id)
        return StoppedGoal(goal.action, goal.id, "UNKNOWN", False, error=str(error))
    is_unknown = answer.return_code == UNKNOWN_GOAL and result.status == STATUS[0]
    confirmed = is_unknown or result.status_code in TERMINAL
    return StoppedGoal(goal.action, goal.id, result.status, confirmed, bool(answer.goals_canceling))
