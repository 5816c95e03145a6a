"""Publish once or repeatedly, and report how many subscribers received it."""

from __future__ import annotations

import asyncio
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from time import monotonic
from typing import Any

from ros2_mcp.guard.policy import bounded
from ros2_mcp.model import names
from ros2_mcp.model.commands import Move, Publish, Repeat
from ros2_mcp.model.errors import BadInput, LinkError, Stopped
from ros2_mcp.model.text import counted
from ros2_mcp.ops.acting.defaults import left_at_default
from ros2_mcp.ops.acting.endings import ended_by, guarded, limited, reason_of
from ros2_mcp.ops.acting.idle import COMMAND_TYPES, why_idle
from ros2_mcp.ops.results.results import HIDDEN, SAID, Report, or_error, silent, unless_all_failed
from ros2_mcp.ops.topics.info import mismatches
from ros2_mcp.robot import HOLD_TYPES, MOTION_TYPES, VELOCITY_TYPES, Robot, Sent
from ros2_mcp.robot.jobs import Job
from ros2_mcp.robot.session import Session
from ros2_mcp_common.wire.limits import MAX_DURATION_S, MAX_RATE_HZ, MIN_RATE_HZ

MATCH_S = 1.0
"""How long the bridge waits for a first subscriber to match. A running node matches within milliseconds, one that has
just started within this time, so that it does not miss the message."""


@dataclass(frozen=True, slots=True, kw_only=True)
class PublishRequest:
    """A message and its topic: to publish once, or at `frequency` in Hz for `duration` in seconds. An empty type means
    that of the topic.
    """

    topic_name: str
    message_type: str
    data: dict[str, Any]
    frequency: float | None = None
    duration: float | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class Published:
    """The result of publishing on one topic.

    `status` is `published` if at least one subscriber was matched when the message was sent, `no_subscriber` if none
    was, and `failed` with an `error` if this topic, one of several, could not be published. `acknowledged` is null if
    unknown.
    """

    status: str
    topic_name: str = field(metadata=SAID)
    topic_type: str = ""
    sent: int = field(default=0, metadata=SAID)
    subscribers: int = field(default=0, metadata=SAID)
    acknowledged: bool | None = None
    stopped_with_zero: bool = False
    elapsed: float = 0.0
    qos: str = ""
    note: str = ""
    error: str = ""
    ours: int = field(default=0, metadata=HIDDEN)

    def summary(self) -> str:
        """Return the result in one line."""
        if self.error:
            return f"{self.topic_name}: {self.error}"
        others = self.subscribers - self.ours
        reached = f"reached {counted(others, 'subscriber')}" if others else "no subscribers"
        if self.ours:
            reached += ", and this server itself" if others else " except this server itself"
        return f"{self.topic_name}: {counted(self.sent, 'message')} sent, {reached}. {self.note}".rstrip()


@dataclass(frozen=True, slots=True)
class PublishedSeveral:
    """The results of publishing on several topics."""

    topics: Sequence[Published]

    def summary(self) -> list[str]:
        """Return a line for each topic."""
        return [published.summary() for published in self.topics]


async def publish(robot: Robot, session: Session, request: PublishRequest, report: Report = silent) -> Published:
    """Publish a message, after checking every value against its definition; nothing is sent if a value does not fit.

    Raises:
        BadValue: if a value does not fit, with its path, or a limit is out of range.
        TypeConflict: if the topic has another type.
        Stopped: if a stop came before anything was sent.
        Refused: if this server is read-only, or already drives as many velocity topics as it can.
    """
    rate_hz, duration_s = request.frequency, request.duration
    if (rate_hz is None) != (duration_s is None):
        given, missing = ("duration", "frequency") if rate_hz is None else ("frequency", "duration")
        raise BadInput(f"{given} needs {missing}.", "Give both to repeat, or neither to publish once.")
    if rate_hz is not None and duration_s is not None:
        bounded("frequency", rate_hz, MIN_RATE_HZ, MAX_RATE_HZ, "Hz")
        bounded("duration", duration_s, 0.0, MAX_DURATION_S, "s")
    to = await robot.types.destination(request.topic_name, request.message_type)
    if rate_hz is None or duration_s is None:
        make_command = Publish
    else:
        make_command = partial(Repeat, rate_hz=rate_hz, duration_s=duration_s)
    command = make_command(
        principal=session.principal,
        name=to.topic,
        type=to.type,
        value=request.data,
        choice=to.choice,
        wait_match_s=MATCH_S,
    )
    reason = ""
    if isinstance(command, Repeat):
        sent, reason = await _repeat(robot, session, command, report)
    else:
        sent = await robot.do(command, session)
        robot.types.note_sent(to, request.message_type, sent.endpoints)
    definitions = robot.values.definitions
    subscribers = counted(sent.matched, "subscriber")
    own = f"{sent.ours} of {subscribers} belong to this server (it records, reads or relays the topic)."
    may_be_idle = sent.matched and to.type in COMMAND_TYPES and not reason  # many may be stopped at once
    notes = (
        await _note(robot, sent, reason),
        await why_idle(robot, sent.topic) if may_be_idle else "",
        own if sent.ours else "",
        left_at_default(definitions, to.type, request.data),
    )
    return Published(
        status="published" if sent.matched else "no_subscriber",
        topic_name=sent.topic,
        topic_type=sent.type,
        sent=sent.sent,
        subscribers=sent.matched,
        acknowledged=sent.acked,
        stopped_with_zero=sent.stopped_with_zero,
        elapsed=round(sent.elapsed_s, 6),
        qos=f"{sent.choice.qos.reliability}, {sent.choice.qos.durability}: {sent.choice.reason}",
        note=" ".join(filter(None, notes)),
        ours=sent.ours,
    )


async def publish_several(
    robot: Robot, session: Session, requests: Sequence[PublishRequest], report: Report = silent
) -> PublishedSeveral:
    """Publish on several topics at the same time; the `error` of one topic does not stop the others.

    Raises:
        BadInput: if there are no topics.
        AllFailed: if nothing could be published on any.
    """
    if not requests:
        raise BadInput("No topics are given.", 'Give a list of {"topic_name", "message_type", "data"}.')
    publications = [
        or_error(
            publish(robot, session, request, report),
            partial(Published, status="failed", topic_name=request.topic_name),
        )
        for request in requests
    ]
    return PublishedSeveral(unless_all_failed(await asyncio.gather(*publications)))


class Repetition(Job):
    """One message that is published repeatedly; its call waits for the end. `sent` is the result."""

    kind = "repeat"
    most_running = 256
    """More topics than a client publishes on at once; `ros2_publish_multiple_topics` counts once for each of its
    topics.
    """
    patience_s = 1.0
    """`ros2_stop` ends repeats in the bridge first and the jobs afterwards; the
    bridge's answer is on its way by then."""

    def __init__(self, robot: Robot, session: Session, command: Repeat | Move) -> None:
        super().__init__(owner=command.principal, moves=[command.name])
        self._robot, self._session = robot, session
        self._command = replace(command, repeat_id=self.id) if isinstance(command, Repeat) else None
        self.is_motion = command.type in MOTION_TYPES
        self.sent: Sent | None = None

    async def run(self) -> None:
        """Publish in the bridge until the time is over or the bridge ends it (`ros2_stop`)."""
        assert self._command
        await self._robot.values.learn(self._command.type)  # as long as it is starting, a stop ends it at once
        self.begun()
        self.sent = await self._robot.do(self._command, self._session)

    async def stop_for(self, reason: str) -> None:
        """Make the bridge end the repeat with its zero; the result gives the reason. Raises the same
        errors as `Graph.ask` and `stop`.
        """
        self.stop_reason, self.is_stopping = reason, True
        try:
            await self._robot.end_repeat(self.id)
        finally:
            await self.stop()

    async def wind_down(self) -> None:
        """Do nothing: the bridge ends the repeat, and its answer with the counts is still awaited."""


async def _repeat(robot: Robot, session: Session, command: Repeat, report: Report) -> tuple[Sent, str]:
    """Publish repeatedly. Return the counts, and the reason if it ended early."""
    repetition = Repetition(robot, session, command)
    topic, duration_s = command.name, command.duration_s

    awaited = "a subscriber and for the stopper, which sends zero if the bridge dies"
    waits = f"{topic}: nothing published yet; waiting for {awaited if repetition.is_motion else 'a subscriber'}"
    said = ""

    async def progress() -> None:
        nonlocal said
        begun_at = robot.graph.repeat_begun_at(repetition.id)
        if begun_at is None and not repetition.is_running:
            return  # the result reports how it ended
        elapsed_s = 0.0 if begun_at is None else min(monotonic() - begun_at, duration_s)
        line = waits if begun_at is None else f"{topic}: publishing for {elapsed_s:.0f} of {duration_s:g} s"
        if line != said:
            said = line
            await report(elapsed_s, duration_s, line)

    await robot.jobs.run(repetition, every_second=progress)
    if repetition.sent is None:
        if not repetition.has_begun:
            raise Stopped(f"{ended_by(repetition.stop_reason or 'a stop')} Nothing was published on {topic}.")
        raise LinkError(f"Publishing on {topic} was stopped; the bridge did not report in time what it had sent.")
    sent = repetition.sent
    reason = ""
    if sent.ended_by:
        reason = repetition.stop_reason or reason_of(robot, sent.ended_by) or "a request to cancel it"
    return sent, reason


async def _note(robot: Robot, sent: Sent, reason: str) -> str:
    notes = [ended_by(reason)] if reason else []
    if not sent.matched and reason:
        notes.append("No subscriber received it.")  # many may be stopped at once: no more requests for each
    elif not sent.matched:
        found = await robot.graph.endpoints(sent.topic)
        ours = [publisher for publisher in found.publishers if publisher.node in robot.graph.own_nodes]
        reasons = mismatches(ours, found.subscribers)
        notes.append(f"No subscriber received it: {' '.join(reasons)}" if reasons else "No subscriber received it.")
        if not found.subscribers:  # most likely a typing error in the name of a topic with subscribers
            subscribed = [row.name for row in await robot.graph.topics() if row.subscribers and row.name != sent.topic]
            near = names.nearest(sent.topic, subscribed)
            notes.append(f"Did you mean {near}?" if near else "")
    if sent.acked is False:
        notes.append("Not every subscriber acknowledged it in time.")
    if sent.late:
        notes.append(f"Missed {counted(sent.late, 'period')}.")
    if sent.limited:
        notes.append(f"{limited(sent.limited)} To reach the full speed, give frequency and duration.")
    notes.append(guarded(sent.stopper_s, sent.unguarded))
    if sent.stopped_with_zero:
        is_held = sent.type in HOLD_TYPES
        notes.append(f"A {'hold at the measured positions' if is_held else 'zero command'} was sent at the end.")
    elif sent.hold_s and sent.matched:
        notes.append(
            f"The robot keeps this velocity for {sent.hold_s:g} s; then the bridge sends zero unless another "
            f"command has arrived."
        )
    elif sent.type in HOLD_TYPES and sent.matched:
        notes.append("ros2_stop, or the end of this client, holds the joints at their measured positions.")
    elif sent.type in VELOCITY_TYPES and sent.matched:
        notes.append(
            "The robot keeps this velocity until its own time-out or ros2_stop. For a bounded move, give frequency "
            "and duration."
        )
    return " ".join(filter(None, notes))
