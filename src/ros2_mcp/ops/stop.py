"""Stop everything that this server has set in motion, and say what was confirmed."""

from __future__ import annotations

import asyncio
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import anyio

from ros2_mcp.model.errors import BridgeLost, RobotError, TimedOut
from ros2_mcp.model.goals import STATUS, TERMINAL
from ros2_mcp.ops.actions.result import result_of
from ros2_mcp.robot import Robot
from ros2_mcp.robot.goals import UNKNOWN_GOAL, Goal
from ros2_mcp.robot.jobs import Job
from ros2_mcp_bridge.protocol import StoppedTopic as Zero
from ros2_mcp_bridge.protocol import StopReply

ENDED_S = 3.0
"""An action server that is alive ends a cancelled goal within its control period; the answer must come soon."""
_BRIDGE_S = 5.0
"""For a bridge that is starting, once more after one that is lost: the answer must come soon, confirmed or not."""
_OTHERS_S = 1.0
"""For looking up who else publishes: the bridge knows it at once, unless discovery is still under way."""
_MOST_NAMED = 20
"""Of each kind: enough to see what it was. All else is counted."""
_NOTHING: StopReply = {"repeats": 0, "relays": 0, "dropped": [], "topics": []}


@dataclass(frozen=True, slots=True)
class StoppedTopic:
    """A topic that got a zero command.

    `subscribers` were sent it, `unreached` are in the graph besides and were not. `acknowledged` is null where it is
    not known. `others` are nodes that publish on it too: their messages still move the robot.
    """

    topic_name: str
    subscribers: int
    acknowledged: bool | None
    others: Sequence[str] = ()
    error: str = ""
    unreached: int = 0


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


@dataclass(frozen=True, slots=True, kw_only=True)
class Stopped:
    """What was stopped.

    `dropped` was accepted before the stop, had not been sent yet, and is not sent any more. `unknown_services` were
    called and `unknown_topics` published on by this server since it was started, the last ones first; it does not know
    how what they set in motion is stopped. `confirmed` is true if every zero command was acknowledged, or nobody
    listens; nobody else publishes on those topics; every goal has ended; and there are no such services and topics.
    """

    repeats_stopped: int
    relays_stopped: int
    topics: Sequence[StoppedTopic]
    goals: Sequence[StoppedGoal]
    dropped: Sequence[str] = ()
    unknown_services: Sequence[str] = ()
    unknown_topics: Sequence[str] = ()
    confirmed: bool
    note: str

    def summary(self) -> str:
        """One line."""
        verdict = "Stopped" if self.confirmed else "NOT confirmed"
        if not (self.repeats_stopped or self.relays_stopped or self.topics or self.goals or self.dropped):
            return f"{'Nothing was stopped.' if self.confirmed else 'NOT confirmed:'} {self.note}"
        cancelled = sum(goal.cancelled for goal in self.goals)
        ended = sum(goal.confirmed and not goal.cancelled for goal in self.goals)
        return (
            f"{verdict}: {self.repeats_stopped} repeated publication(s) and "
            f"{self.relays_stopped} relay(s) ended, zero on {len(self.topics)} topic(s), {cancelled} goal(s) "
            f"cancelled, {ended} had ended already. {self.note}"
        ).rstrip()


async def stop(robot: Robot) -> Stopped:
    """Ends what this server has set in motion: from the beginning of this call on, nothing leaves that was accepted
    before it; repeated publishing, relays and playbacks end, every velocity topic that was driven gets its zero, every
    goal is cancelled. Says what of it was confirmed, and never raises a `RobotError`.
    """
    robot.raise_stop_epoch()  # before anything is awaited
    with anyio.CancelScope(shield=True):  # it is finished also where its own call is cancelled
        return await _stop(robot)
    raise AssertionError("a shield is not cancelled")


async def _stop(robot: Robot) -> Stopped:
    (ended, problem), jobs, found = await asyncio.gather(
        _stop_bridge(robot),  # it writes first
        robot.jobs.stop_moving("ros2_stop"),
        asyncio.gather(*(_cancel(robot, goal) for goal in robot.jobs.running(Goal))),
    )
    zeros = {(zero["topic"], zero["type"]): zero for zero in ended["topics"]}
    missing = problem or "the bridge has sent no zero on it"
    topics = await asyncio.gather(
        *(_judged(robot, topic, zeros.get((topic, kind)), missing) for topic, kind in _topics(robot, zeros))
    )
    goals = [goal for goal in found if goal]
    services, others = robot.no_known_stop.names("service"), robot.no_known_stop.names("topic")
    notes = [f"{problem}."] if problem else []
    notes += [f"{job.kind} {job.id} did not end in good order: {error}" for job, error in jobs.items() if error]
    doubts = [*notes, *_doubts(topics, goals), *_unknown(services, others)]
    dropped = _dropped(ended)
    return Stopped(
        repeats_stopped=ended["repeats"],
        relays_stopped=ended["relays"],
        topics=topics,
        goals=goals,
        dropped=_first(dropped),
        unknown_services=_first(services),
        unknown_topics=_first(others),
        confirmed=not doubts,
        note=" ".join([*doubts, *_facts(ended, topics, goals, jobs)]),
    )


async def _stop_bridge(robot: Robot) -> tuple[StopReply, str]:
    """What the bridge says it has ended; and what is to be said if it has not been asked, or not the one that moved it.

    A bridge that is lost meanwhile has a successor that sends the zeros by itself; it is asked once more, for its
    successor knows nothing of what was under way.
    """
    try:
        with anyio.fail_after(_BRIDGE_S):
            return await robot.stop_bridge(), ""
    except BridgeLost:
        problem = "The bridge was lost meanwhile, and its successor may not have found every subscriber yet: stop again"
    except (RobotError, TimeoutError) as error:
        reason = str(error) or f"it has not answered within {_BRIDGE_S:g} s"
        return _NOTHING, f"The bridge could not be asked to stop ({reason.rstrip('.')}): what it publishes may go on"
    try:
        with anyio.fail_after(_BRIDGE_S):
            return await robot.stop_bridge(), problem
    except (RobotError, TimeoutError):
        return _NOTHING, problem


def _topics(robot: Robot, zeros: Mapping[tuple[str, str], Zero]) -> Sequence[tuple[str, str]]:
    """Topic and type of all that this server drives or has just stopped."""
    return list(dict.fromkeys([*((driven.topic, driven.type) for driven in robot.failsafes.driven), *zeros]))


async def _judged(robot: Robot, topic: str, zero: Zero | None, missing: str) -> StoppedTopic:
    """What became of the zero on a topic, and who else publishes there."""
    if zero is None:
        return StoppedTopic(topic, 0, False, error=f"{topic} got no zero: {missing[0].lower()}{missing[1:]}.")
    try:
        present = await robot.graph.endpoints(topic, _OTHERS_S)
    except RobotError as error:
        unseen = f"Who else publishes on {topic} could not be looked up: {error}"
        return StoppedTopic(topic, zero["matched"], zero["acked"], error=unseen)
    others = sorted({publisher.node for publisher in present.publishers} - {*robot.graph.own_nodes})
    unseen = "" if present.settled else f"Discovery is under way: more may listen to {topic}, or publish on it."
    unreached = max(0, present.subscribers_of(zero["type"]) - zero["matched"])
    return StoppedTopic(topic, zero["matched"], zero["acked"], others, unseen, unreached)


async def _cancel(robot: Robot, goal: Goal) -> StoppedGoal | None:
    """Cancels a goal and sees it end; one that its server does not know, or no longer, is not running. None for one
    that had not been sent yet.
    """
    try:
        response = await goal.request_cancel(ENDED_S)
        is_unknown, cancelled = response["return_code"] == UNKNOWN_GOAL, bool(response["goals_canceling"])
        if not goal.was_sent:
            return None
        if is_unknown and goal.is_running and not goal.is_accepted:
            raise TimedOut(f"The server of {goal.action} has not said whether it accepts goal {goal.id}: stop again.")
        result = await result_of(robot, goal.action, goal.action_type, goal.id, ENDED_S)
    except RobotError as error:
        if not goal.was_sent:
            return None
        return StoppedGoal(goal.action, goal.id, "UNKNOWN", False, error=str(error))
    confirmed = (is_unknown and result.status == STATUS[0]) or result.status_code in TERMINAL
    return StoppedGoal(goal.action, goal.id, result.status, confirmed, cancelled)


# ── in words ───────────────────────────────────────────────────────────────────────────────────────────────────────


def _doubts(topics: Sequence[StoppedTopic], goals: Sequence[StoppedGoal]) -> list[str]:
    """Why it is not confirmed that the topics are still and the goals have ended; nothing if it is."""
    doubts: list[str] = []
    for topic in topics:
        if topic.others:
            doubts.append(f"{', '.join(topic.others)} also publishes on {topic.topic_name}: the robot may still move.")
        if topic.unreached:
            doubts.append(f"{topic.unreached} subscriber(s) of {topic.topic_name} did not get the zero: stop again.")
        if topic.error:
            doubts.append(topic.error)
        elif topic.subscribers and topic.acknowledged is None:
            unknown = f"Whether the zero on {topic.topic_name} arrived is not known"
            doubts.append(f"{unknown}: not every subscriber acknowledges.")
        elif topic.subscribers and not topic.acknowledged:
            doubts.append(f"Not every subscriber of {topic.topic_name} has acknowledged the zero.")
    doubts += [goal.error for goal in goals if goal.error]
    doubts += [f"Goal {goal.goal_id} has not ended yet." for goal in goals if not goal.confirmed and not goal.error]
    return doubts


def _unknown(services: Sequence[str], topics: Sequence[str]) -> list[str]:
    """That there is something of which it is not known how it is stopped; nothing if there is none."""
    sent = [f"called {len(services)} service(s)"] if services else []
    sent += [f"published on {len(topics)} topic(s) that are no velocities"] if topics else []
    if not sent:
        return []
    named = _first([*services[: _MOST_NAMED // 2], *topics[: _MOST_NAMED // 2]])
    return [
        f"Since its start this server has {' and '.join(sent)}, of which it does not know how they are stopped "
        f"({', '.join(named)}): if one of them has set something in motion, it may go on."
    ]


def _facts(
    ended: StopReply, topics: Sequence[StoppedTopic], goals: Sequence[StoppedGoal], jobs: Mapping[Job, str]
) -> list[str]:
    """What else is to be said."""
    facts: list[str] = []
    if dropped := _dropped(ended):
        facts.append(f"{len(dropped)} request(s) that had not been sent yet will not be sent.")
    if others := [job for job in jobs if job.kind not in ("repeat", "relay")]:
        facts.append(f"Ended: {', '.join(f'{job.kind} {job.id}' for job in others)}.")
    facts += [
        f"Nobody subscribes to {topic.topic_name} now."
        for topic in topics
        if not (topic.subscribers or topic.unreached or topic.error)
    ]
    if not (ended["repeats"] or ended["relays"] or ended["dropped"] or topics or goals or jobs):
        facts.append(
            "This server had nothing in motion that it knows how to stop; what others have set in motion goes on."
        )
    return facts


def _dropped(ended: StopReply) -> list[str]:
    """Publications and calls that had not been sent; what had not been fed to a relay is counted with that."""
    words = {"publish": "publishing on", "call": "calling"}
    return [f"{words[op]} {name}" for op, name in ended["dropped"] if op in words]


def _first(names: Sequence[str]) -> list[str]:
    """The first names, and how many more there are."""
    more = len(names) - _MOST_NAMED
    return [*names[:_MOST_NAMED], *([f"and {more} more"] if more > 0 else [])]
