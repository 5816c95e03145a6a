"""Stop everything that this server has set in motion, and report what was confirmed."""

from __future__ import annotations

import asyncio
import math
from collections.abc import Awaitable, Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from time import monotonic

import anyio

from ros2_mcp.guard.state import RESET_HINT
from ros2_mcp.model.commands import LOCAL
from ros2_mcp.model.errors import BridgeLost, RobotError, TimedOut
from ros2_mcp.model.goals import STATUS, TERMINAL
from ros2_mcp.model.graph import TopicEndpoints
from ros2_mcp.model.names import UNKNOWN_NODE
from ros2_mcp.model.text import counted, listed
from ros2_mcp.ops.acting.flights import StoppedFlight, brake_flights
from ros2_mcp.ops.actions.result import result_of
from ros2_mcp.ops.actions.running import RunningGoal, from_above, running_goals
from ros2_mcp.ops.actions.status import LATCHED_S as LATCHED_STATUS_S
from ros2_mcp.ops.results.results import HIDDEN, IF_ANY, SAID
from ros2_mcp.ops.stop.judge import Observation, Observed, is_confirmed
from ros2_mcp.ops.stop.observe import observe_still
from ros2_mcp.robot import Robot
from ros2_mcp.robot.goals import UNKNOWN_GOAL, Goal
from ros2_mcp.robot.jobs import Job
from ros2_mcp_common.wire.protocol import StoppedTopic as Zero
from ros2_mcp_common.wire.protocol import StopReply

ENDED_S = 3.0
"""Time for a cancelled goal to end. A live action server ends it within its control
period; the stop must answer soon.
"""
_BRIDGE_S = 5.0
"""Time for a bridge that is starting, and again for the successor of a lost bridge: the stop must answer soon,
confirmed or not.
"""
_OTHERS_S = 1.0
"""Time to look up other publishers and running goals: the bridge has them at once,
unless discovery is still under way.
"""
_PATIENT_S, _LATE_S = 3.0, 2.0
"""Time for a second look at running goals, where the first one took too long or found none although the robot moves;
and of that for one status: on a busy computer it comes seconds after the matching."""
_OUT_OF_REACH_S = 2.3
"""After a silence of this length, the link lease of a remote robot (2 s) has lapsed there, and what this server drove
has stopped (required: within 0.3 s of that). More waiting would change nothing for the robot."""
LATCHED_S = 0.5
"""A stop waits at least this long, even for a robot that is out of reach: longer than `_LATCH_S`, so
that its latch is written by then."""
_LOOK_S = 0.05
"""Seconds between two checks of whether a robot is out of reach."""
_LATCH_S = 0.2
"""Time that the bridge gets before the latch is written: a live bridge has ended what moves, and sent its zeros, within
a tenth of that.
"""
_UNANSWERED_S = 0.5
"""Time-out for an action server that did not answer the last stop, so that a dead one does
not cost each stop the full time."""
_UNREAD = (
    f"Which goals of other clients run could not be read within {_PATIENT_S:g} s: ros2_action_status lists them, and "
    "ros2_cancel_action_goal ends them."
)
_MOST_RUNNING = 4
"""Goals of other clients that the note names with the call that ends each; the result has all."""
_MOST_NAMED = 20
"""The most names of each kind, so that the result stays short."""
_MOST_GONE = 3
"""The most nodes in the sentence about nodes that took commands and left the graph: a
base, its multiplexer, a logger.
"""
_going_on: set[asyncio.Task[Stopped]] = set()
"""Stops that continue after their answer. The set keeps a reference to each task, which asyncio does not."""
Look = Callable[..., Awaitable["Sequence[RunningGoal] | None"]]
"""Looks up running goals of others, as `_others_running` does."""
_NOTHING: StopReply = {"repeats": 0, "relays": 0, "dropped": [], "topics": []}


@dataclass(frozen=True, slots=True)
class StoppedTopic:
    """A topic that got a zero command.

    The zero was sent to `subscribers`; `unreached_subscribers` are further subscribers in the graph, to which it was
    not sent. `acknowledged` is null if unknown. `other_publishers` are nodes that also publish on the topic: their
    messages can still move the robot. `lost_subscribers` received commands and have left the graph.
    """

    topic_name: str
    subscribers: int
    acknowledged: bool | None
    other_publishers: Sequence[str] = ()
    error: str = ""
    unreached_subscribers: int = 0
    lost_subscribers: Sequence[str] = ()
    is_deserted: bool = field(default=False, metadata=HIDDEN)


@dataclass(frozen=True, slots=True)
class StoppedGoal:
    """A goal that this server requested to cancel, and its status when the wait ended; `confirmed` once the goal has
    ended.

    `cancelled` is false if the goal had already ended.
    """

    action_name: str
    goal_id: str
    status: str
    confirmed: bool
    cancelled: bool = False
    error: str = ""


@dataclass(frozen=True, slots=True, kw_only=True)
class Stopped:
    """The result of a stop.

    `dropped` lists commands that had been accepted before the stop but not sent; they will not be sent.
    `unknown_services` and `unknown_topics` list services called and topics published on since this server started, the
    last ones first, whose effects it does not know how to stop (parameters and lifecycle transitions are configuration,
    and not listed). `running` lists goals of other clients that have not ended, each with the call that ends it.
    `observed` says whether odometry and joint states published after the stop report that the robot is stationary, or
    hovers; `latched` whether an operator has to reset the latch before any command is accepted again.

    `confirmed` is true if all of this holds: the robot was observed to be stationary or hovering; every zero command
    reached its subscribers, and the nodes that had received commands are still in the graph; no other node publishes on
    those topics; every goal has ended, and no goal of another client that may move the robot is running; every vehicle
    reports a mode in which it holds its position; and none of the unknown services was called, or unknown topics
    published on, since the robot was last observed to be stationary.
    """

    repeats_stopped: int = field(metadata=SAID)
    relays_stopped: int = field(metadata=SAID)
    topics: Sequence[StoppedTopic]
    goals: Sequence[StoppedGoal]
    running: Sequence[RunningGoal] = field(default=(), metadata=SAID)
    flights: Sequence[StoppedFlight] = ()
    dropped: Sequence[str] = ()
    unknown_services: Sequence[str] = ()
    unknown_topics: Sequence[str] = ()
    confirmed: bool
    observed: Observed = "not observed"
    latched: bool = False
    note: str = field(metadata=IF_ANY)
    is_doubted: bool = field(default=False, metadata=HIDDEN)

    def summary(self) -> str:
        """Return one line: first what is confirmed of the things this server knows how to
        stop, then what it cannot judge.
        """
        verdict = "NOT confirmed" if self.is_doubted else "Stopped" if self.confirmed else "Stopped, partly confirmed"
        ended = (self.repeats_stopped, self.relays_stopped, self.topics, self.goals, self.flights, self.dropped)
        if not any(ended):
            return f"{'NOT confirmed:' if self.is_doubted else 'Nothing was stopped.'} {self.note}"
        cancelled = sum(goal.cancelled for goal in self.goals)
        over = sum(goal.confirmed and not goal.cancelled for goal in self.goals)
        unheard = sum(not (topic.subscribers or topic.unreached_subscribers or topic.error) for topic in self.topics)
        parts = (
            (self.repeats_stopped, f"{counted(self.repeats_stopped, 'repeated publication')} ended"),
            (self.relays_stopped, f"{counted(self.relays_stopped, 'relay')} ended"),
            (len(self.topics) - unheard, f"zero on {counted(len(self.topics) - unheard, 'topic')}"),
            (unheard, f"no receiver for the zero on {counted(unheard, 'topic')}"),
            (cancelled, f"{counted(cancelled, 'goal')} cancelled"),
            (over, f"{counted(over, 'goal')} had ended already"),
            (len(self.flights), f"{counted(len(self.flights), 'vehicle')} commanded to hold position"),
        )
        told = ", ".join(words for count, words in parts if count)
        if self.confirmed and unheard and not any((*ended[:2], len(self.topics) - unheard, *ended[3:])):
            return f"Nothing to stop: {told}. {self.note}".rstrip()  # as when the base has left the graph
        if self.is_doubted:  # the reason comes first, in case the reader stops there
            return f"{verdict}: {self.note} Done: {told}." if told else f"{verdict}: {self.note}"
        return f"{verdict}: {f'{told}. ' if told else ''}{self.note}".rstrip()


async def stop(robot: Robot, by: str = "", *, client: str = LOCAL.name) -> Stopped:
    """Stop everything that this server has set in motion, and return what of it was
    confirmed. Never raises a `RobotError`.

    From the beginning of this call, nothing that was accepted before it is sent. Repeats, relays and playbacks end,
    every driven velocity topic gets its zero, and every goal is cancelled.

    A stop by a person, named by `by`, sets the latch; a stop by an agent sets it only under a policy. The audit names
    the person, or else the `client`.
    """
    _begin(robot, by)
    return await _carry_out(robot, by or client)


async def stop_in_reach(robot: Robot, client: str = LOCAL.name) -> Stopped:
    """Stop as `stop` does, but do not wait for a remote robot once it is out of reach: the result says so, and the stop
    continues in the background.
    """
    _begin(robot, "")
    task, begun_at = asyncio.ensure_future(_carry_out(robot, client)), monotonic()
    _going_on.add(task)
    task.add_done_callback(_going_on.discard)
    while not task.done() and (monotonic() - begun_at < LATCHED_S or not is_out_of_reach(robot)):
        await asyncio.wait({task}, timeout=_LOOK_S)
    return task.result() if task.done() else not_stopped(unreached(robot), is_latched=robot.guard.latch.look().is_set)


def is_out_of_reach(robot: Robot) -> bool:
    """Return whether a remote robot was reached once, and has been silent for so long that it has stopped by itself."""
    return robot.graph.is_remote and robot.graph.was_reached and robot.graph.unheard_s > _OUT_OF_REACH_S


def unreached(robot: Robot) -> str:
    """Return the note for a robot whose stop continues in the background."""
    silent_s = robot.graph.unheard_s
    since = f"no data from it for {silent_s:.1f} s" if math.isfinite(silent_s) else "its link is lost"
    return (
        f"The robot is out of reach ({since}). What this server drives there stops when the link lease lapses. The "
        "stop continues in the background: call ros2_stop again to see what is confirmed."
    )


async def _carry_out(robot: Robot, by: str) -> Stopped:
    with anyio.CancelScope(shield=True):  # the stop is completed even if its call is cancelled
        stopped = await _stop(robot)
        if robot.guard.audit:
            robot.guard.audit.note(
                "stopped",
                by=by,
                topics=[topic.topic_name for topic in stopped.topics],
                flights=[flight.vehicle for flight in stopped.flights],
                confirmed=stopped.confirmed,
                observed=stopped.observed,
            )
        return stopped
    raise AssertionError("a shield is not cancelled")


async def stop_unreached(robot: Robot, note: str) -> Stopped:
    """Stop a robot that this server has never reached: raise the stop epoch, and under a policy set the latch. The
    robot is not asked for anything.
    """
    _begin(robot, "")
    unwritten = await asyncio.to_thread(robot.guard.latch.write)
    notes = [f"The latch could not be saved ({unwritten}): it is lost when this server ends."] if unwritten else []
    is_latched = robot.guard.latch.look().is_set
    notes += [note, *([f"The latch is set: commands are refused. {RESET_HINT}"] if is_latched else [])]
    return Stopped(
        repeats_stopped=0,
        relays_stopped=0,
        topics=(),
        goals=(),
        confirmed=False,  # whether the robot is stationary is unknown
        latched=is_latched,
        note=" ".join(notes),
        is_doubted=bool(unwritten),
    )


def not_stopped(note: str, *, is_latched: bool = False) -> Stopped:
    """Return the result of a stop that was not completed."""
    return Stopped(
        repeats_stopped=0,
        relays_stopped=0,
        topics=(),
        goals=(),
        confirmed=False,
        latched=is_latched,
        note=note,
        is_doubted=True,
    )


def _begin(robot: Robot, by: str) -> None:
    """Raise the stop epoch, so that nothing accepted before is sent, and hold the latch for a
    person's stop or under a policy.

    Must be called before anything is awaited.
    """
    robot.raise_stop_epoch()
    if by or robot.policy.in_force:
        robot.guard.latch.hold(
            by=by or "ros2_stop", reason="a person stopped the robot" if by else "an agent stopped it"
        )


async def _stop(robot: Robot) -> Stopped:
    has_asked = anyio.Event()
    (ended, problem), jobs, goals, flights, unwritten = await asyncio.gather(
        _stop_bridge(robot, has_asked),  # its request is written first
        robot.jobs.stop_moving("ros2_stop"),
        cancel_goals(robot),
        brake_flights(robot),
        _write_latch(robot, has_asked),
    )
    zeros = {(zero["topic"], zero["type"]): zero for zero in ended["topics"]}
    missing = problem or "the bridge has sent no zero on it"
    judging = [_judged(robot, topic, zeros.get((topic, kind)), missing) for topic, kind in _topics(robot, zeros)]
    hovers = any(flight.armed for flight in flights)
    commands, unsettled = robot.failsafes.commands(), robot.stops.unknown.unsettled()
    observation, topics, running = await asyncio.gather(
        observe_still(robot, hovers=hovers), asyncio.gather(*judging), _others_running(robot)
    )
    services, others = robot.stops.unknown.names("service"), robot.stops.unknown.names("topic")
    notes = [f"{problem}."] if problem else []
    notes += [f"The latch could not be saved ({unwritten}): it is lost when this server ends."] if unwritten else []
    notes += [f"{job.kind} {job.id} did not end cleanly: {error}" for job, error in jobs.items() if error]
    running = await looked_again(partial(_others_running, robot), running, is_moving=observation.is_moving)
    notes += [_UNREAD] if running is None else []
    running = from_above(running or ())
    doubts = [*notes, *_doubts(topics, goals, observation), *(job.doubt for job in jobs if job.doubt)]
    doubts += [goal.sentence for goal in running[:_MOST_RUNNING]]
    unknown = _unknown(unsettled)
    doubts += [flight.sentence for flight in flights if not flight.confirmed]
    is_doubtful = observation.is_moving or observation.is_open
    if is_doubtful:
        doubts.append(observation.sentence)
    if confirmed := is_confirmed(doubts, observation, unsettled):
        robot.failsafes.stands(commands)
    if observation.stands:
        robot.stops.unknown.settle(unsettled)
    facts = [flight.sentence for flight in flights if flight.confirmed]
    facts += _facts(ended, topics, [*goals, *flights], jobs)
    facts += [] if is_doubtful else [observation.sentence]
    is_latched = robot.guard.latch.look().is_set
    facts += [f"The latch is set: commands are refused. {RESET_HINT}"] if is_latched else []
    dropped = _dropped(ended)
    return Stopped(
        repeats_stopped=ended["repeats"],
        relays_stopped=ended["relays"],
        topics=topics,
        goals=goals,
        running=running,
        flights=flights,
        dropped=_first(dropped),
        unknown_services=_first(services),
        unknown_topics=_first(others),
        confirmed=confirmed,
        observed=observation.verdict,
        latched=is_latched,
        note=" ".join([*doubts, *facts, *unknown]),
        is_doubted=bool(doubts),
    )


async def _write_latch(robot: Robot, has_asked: anyio.Event) -> str:
    """Write a latch that is held, once the bridge has had time to send the zeros. Return why it
    could not be written, or nothing.

    The bridge watches the latch's file, too. If it saw the latch first, it would report the latch, instead of the stop,
    as the cause of all that it ends.
    """
    with anyio.move_on_after(_LATCH_S):
        await has_asked.wait()
    return await asyncio.to_thread(robot.guard.latch.write)


async def _stop_bridge(robot: Robot, has_asked: anyio.Event) -> tuple[StopReply, str]:
    """Ask the bridge to stop. Return what it says it has ended, and a problem: that it could not be asked, or that the
    bridge which moved the robot was lost; empty if there is none.

    The successor of a lost bridge sends the zeros by itself. It is asked as well, because it knows nothing of what was
    under way.
    """
    try:
        with anyio.fail_after(_BRIDGE_S):
            return await robot.stop_bridge(), ""
    except BridgeLost:
        problem = "The bridge was lost meanwhile, and its successor may not have found every subscriber yet: stop again"
    except (RobotError, TimeoutError) as error:
        reason = str(error) or f"it has not answered within {_BRIDGE_S:g} s"
        return _NOTHING, f"The bridge could not be asked to stop ({reason.rstrip('.')}): its publications may continue"
    finally:
        has_asked.set()
    try:
        with anyio.fail_after(_BRIDGE_S):
            return await robot.stop_bridge(), problem
    except (RobotError, TimeoutError):
        return _NOTHING, problem


def _topics(robot: Robot, zeros: Mapping[tuple[str, str], Zero]) -> Sequence[tuple[str, str]]:
    """Return topic and type of everything that this server drives or has just stopped."""
    return list(dict.fromkeys([*((driven.topic, driven.type) for driven in robot.failsafes.driven), *zeros]))


async def _judged(robot: Robot, topic: str, zero: Zero | None, missing: str) -> StoppedTopic:
    """Return the delivery of the zero on a topic, and the other publishers on it."""
    if zero is None:
        return StoppedTopic(topic, 0, False, error=f"{topic} got no zero: {missing[0].lower()}{missing[1:]}.")
    if problem := zero.get("problem"):
        return StoppedTopic(topic, zero["matched"], False, error=problem)
    try:
        present = await robot.graph.endpoints(topic, _OTHERS_S)
    except RobotError as error:
        unseen = f"Other publishers on {topic} could not be looked up: {error}"
        return StoppedTopic(topic, zero["matched"], zero["acked"], error=unseen)
    others = sorted({publisher.node for publisher in present.publishers} - {*robot.graph.own_nodes})
    unseen = "" if present.settled else f"Discovery is under way: {topic} may have more subscribers or publishers."
    unreached = max(0, present.subscribers_of(zero["type"]) - zero["matched"])
    gone, is_deserted = _gone(robot, topic, zero, present)
    return StoppedTopic(topic, zero["matched"], zero["acked"], others, unseen, unreached, gone, is_deserted)


def _gone(robot: Robot, topic: str, zero: Zero, present: TopicEndpoints) -> tuple[Sequence[str], bool]:
    """Return the nodes that took commands on a topic and have left the graph, and whether no such node is left.

    A base that has lost its power or radio may still move. A subscriber without a name may be one that took commands.
    """
    driven = next((one for one in robot.failsafes.driven if (one.topic, one.type) == (topic, zero["type"])), None)
    if driven is None:
        return (), False
    if not driven.takers:
        return (), driven.was_taken and not (zero["matched"] or present.subscribers_of(zero["type"]))
    nodes = {subscriber.node for subscriber in present.subscribers}
    gone = driven.takers - nodes
    return sorted(gone), gone == driven.takers and UNKNOWN_NODE not in nodes


async def cancel_goals(robot: Robot) -> list[StoppedGoal]:
    """Cancel all goals that this server sent, and wait a little for their end. Return the outcome of each."""
    found = await asyncio.gather(*(_cancel(robot, goal) for goal in robot.jobs.running(Goal)))
    return [goal for goal in found if goal]


async def looked_again(
    look: Look, running: Sequence[RunningGoal] | None, *, is_moving: bool
) -> Sequence[RunningGoal] | None:
    """Return the goals of others that still run after a first look found `running`; None if they cannot be determined.

    Where the first look took too long, or found none although the robot moves, the second one takes more time.
    """
    if running:
        still = await look(running)  # some end meanwhile
        return running if still is None else still
    if running is None or is_moving:
        return await look(within_s=_PATIENT_S, status_s=_LATE_S)
    return running


async def _others_running(
    robot: Robot, of: Sequence[RunningGoal] = (), *, within_s: float = _OTHERS_S, status_s: float = LATCHED_STATUS_S
) -> Sequence[RunningGoal] | None:
    """Return the running goals that this server did not send; with `of`, only those of the same actions. Return None if
    they cannot be determined in time.
    """
    actions = {goal.action_name: [goal.action_type] for goal in of} or None
    sent = {goal.id for goal in robot.jobs.running(Goal)}
    try:
        with anyio.fail_after(within_s):
            return await running_goals(robot, actions, beside=sent, within_s=status_s)
    except (RobotError, TimeoutError):
        return None


async def _cancel(robot: Robot, goal: Goal) -> StoppedGoal | None:
    """Cancel a goal and wait for its end. A goal that its server does not know, or no longer knows, is not running.
    Return None for a goal that had not been sent yet.
    """
    within_s = _UNANSWERED_S if goal.is_unanswered else ENDED_S
    try:
        with anyio.fail_after(within_s):
            response = await goal.request_cancel(within_s)
        goal.is_unanswered = False
        is_unknown, cancelled = response["return_code"] == UNKNOWN_GOAL, bool(response["goals_canceling"])
        if not goal.was_sent:
            return None
        if is_unknown and goal.is_running and not goal.is_accepted:
            raise TimedOut(
                f"The server of {goal.action} has not answered whether it accepts goal {goal.id}: stop again."
            )
        result = await result_of(robot, goal.action, goal.action_type, goal.id, ENDED_S)
    except (RobotError, TimeoutError) as error:
        if not goal.was_sent:
            return None
        goal.is_unanswered = True
        told = str(error) or f"The server of {goal.action} did not answer within {within_s:g} s"
        return StoppedGoal(
            goal.action, goal.id, "UNKNOWN", False, error=f"{told.rstrip('.')}: goal {goal.id} may continue."
        )
    cancelled = cancelled or result.status == "CANCELED"  # cancelled by the bridge, which saw the latch first
    confirmed = (is_unknown and result.status == STATUS[0]) or result.status_code in TERMINAL
    return StoppedGoal(goal.action, goal.id, result.status, confirmed, cancelled)


# ── in words ───────────────────────────────────────────────────────────────────────────────────────────────────────


def _doubts(topics: Sequence[StoppedTopic], goals: Sequence[StoppedGoal], seen: Observation) -> list[str]:
    """Return why the stop of the topics and goals is not confirmed, as sentences; empty if it is.

    If the robot was observed to be stationary, a subscriber that never acknowledges needs no acknowledgement. If
    odometry showed it, a subscriber that left the graph while others stayed was a logger or the like.
    """
    doubts: list[str] = []
    for topic in topics:
        if topic.other_publishers:
            doubts.append(
                f"{', '.join(topic.other_publishers)} also publishes on {topic.topic_name}: the robot may still move."
            )
        if topic.unreached_subscribers:
            unreached = counted(topic.unreached_subscribers, "subscriber")
            doubts.append(f"{unreached} of {topic.topic_name} did not get the zero: stop again.")
        if topic.error:
            doubts.append(topic.error)
        elif topic.subscribers and topic.acknowledged is None:
            unknown = f"Arrival of the zero on {topic.topic_name} is unknown"
            doubts += [] if seen.stands else [f"{unknown}: not every subscriber acknowledges."]
        elif topic.subscribers and not topic.acknowledged:
            doubts.append(f"Not every subscriber of {topic.topic_name} has acknowledged the zero.")
        if topic.is_deserted or (topic.lost_subscribers and not (seen.stands and seen.has_base)):
            who = listed(topic.lost_subscribers, _MOST_GONE) or "A subscriber"
            doubts.append(f"{who} received commands on {topic.topic_name} and has left the graph: it may still move.")
    doubts += [goal.error for goal in goals if goal.error]
    doubts += [f"Goal {goal.goal_id} has not ended yet." for goal in goals if not goal.confirmed and not goal.error]
    return doubts


def _unknown(unsettled: Sequence[tuple[str, str]]) -> list[str]:
    """Return a sentence on the services called and topics published on whose effects this server does not know how to
    stop; empty if there are none. `unsettled` has kind and name of each.
    """
    services, topics = ([name for of, name in unsettled if of == kind] for kind in ("service", "topic"))
    sent = [f"called {counted(len(services), 'service')}"] if services else []
    sent += [f"published on {counted(len(topics), 'topic')} without velocities"] if topics else []
    if not sent:
        return []
    named = _first([*services[: _MOST_NAMED // 2], *topics[: _MOST_NAMED // 2]])
    return [
        f"NOT judged: this server has {' and '.join(sent)} ({', '.join(named)}). It does not know how to stop what "
        "these started, which may continue."
    ]


def _facts(
    ended: StopReply,
    topics: Sequence[StoppedTopic],
    others: Sequence[StoppedGoal | StoppedFlight],
    jobs: Mapping[Job, str],
) -> list[str]:
    """Return the other facts of a stop, as sentences."""
    facts: list[str] = []
    if dropped := _dropped(ended):
        facts.append(f"{counted(len(dropped), 'request')} had not been sent yet and will not be sent.")
    if ended_jobs := [job for job in jobs if job.kind not in ("repeat", "relay") and not job.doubt]:
        facts.append(f"Ended: {', '.join(f'{job.kind} {job.id}' for job in ended_jobs)}.")
    facts += [
        f"{topic.topic_name} has no subscriber now."
        for topic in topics
        if not (topic.subscribers or topic.unreached_subscribers or topic.error)
    ]
    if not (ended["repeats"] or ended["relays"] or ended["dropped"] or topics or others or jobs):
        facts.append(
            "This server had nothing in motion that it knows how to stop; motions that others started continue."
        )
    return facts


def _dropped(ended: StopReply) -> list[str]:
    """Return the publications and calls that had not been sent. Messages that had not been fed to a
    relay are counted by the relay.
    """
    words = {"publish": "publishing on", "call": "calling"}
    return [f"{words[op]} {name}" for op, name in ended["dropped"] if op in words]


def _first(names: Sequence[str]) -> list[str]:
    """Return the first names, and a text with the number of the others."""
    more = len(names) - _MOST_NAMED
    return [*names[:_MOST_NAMED], *([f"and {more} more"] if more > 0 else [])]
