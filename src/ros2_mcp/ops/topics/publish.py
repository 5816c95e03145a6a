"""Publishing: once or repeatedly, and the truth about who received it."""

from __future__ import annotations

import asyncio
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from ros2_mcp.guard.policy import bounded
from ros2_mcp.model import names
from ros2_mcp.model.commands import Publish, Repeat
from ros2_mcp.model.errors import BadInput, LinkError, RobotError
from ros2_mcp.ops.results import Report, silent
from ros2_mcp.ops.topics.list import mismatches
from ros2_mcp.robot import VELOCITY_TYPES, Robot, Sent
from ros2_mcp.robot.jobs import Job
from ros2_mcp_bridge.limits import MAX_DURATION_S, MAX_RATE_HZ, MIN_RATE_HZ

MATCH_S = 1.0
"""Who is there matches within milliseconds; who has just come up gets the message all the same."""


@dataclass(frozen=True, slots=True)
class Publication:
    """What to publish: once, or at `frequency_hz` for `duration_s`."""

    topic_name: str
    topic_type: str
    data: dict[str, Any]
    frequency_hz: float | None = None
    duration_s: float | None = None


@dataclass(frozen=True, slots=True)
class Published:
    """What became of it.

    `status` is `published` if at least one subscriber was matched when it was sent, `nobody_listening` if none was,
    and `failed` with an `error` where several were published and this one could not be. `acknowledged` is null where
    that is not known.
    """

    status: str
    topic_name: str
    topic_type: str = ""
    sent: int = 0
    subscribers: int = 0
    acknowledged: bool | None = None
    stopped_with_zero: bool = False
    elapsed: float = 0.0
    qos: str = ""
    note: str = ""
    error: str = ""

    def summary(self) -> str:
        """One line."""
        if self.error:
            return f"{self.topic_name}: {self.error}"
        reached = f"reached {self.subscribers} subscriber(s)" if self.subscribers else "no subscriber was there"
        return f"{self.topic_name}: {self.sent} message(s) sent, {reached}. {self.note}".rstrip()


@dataclass(frozen=True, slots=True)
class PublishedSeveral:
    """What became of each."""

    topics: Sequence[Published]

    def summary(self) -> str:
        """A line for each topic."""
        return "\n".join(published.summary() for published in self.topics)


async def publish(robot: Robot, publication: Publication, report: Report = silent) -> Published:
    """Publishes, after every value has been checked against its definition; nothing is sent if one does not fit.

    Raises:
        BadValue: naming the path of a value that does not fit, or a limit that is out of range.
        TypeConflict: if the topic has another type.
        Refused: if this server is read-only.
    """
    sent = await _send(robot, publication, report)
    return Published(
        "published" if sent.matched else "nobody_listening",
        sent.topic,
        sent.type,
        sent.sent,
        sent.matched,
        sent.acked,
        sent.stopped_with_zero,
        round(sent.elapsed_s, 6),
        f"{sent.choice.qos.reliability}, {sent.choice.qos.durability}: {sent.choice.reason}",
        await _note(robot, sent),
    )


async def publish_several(
    robot: Robot, publications: Sequence[Publication], report: Report = silent
) -> PublishedSeveral:
    """Publishes on several topics at the same time; an `error` of one leaves the others."""
    if not publications:
        raise BadInput("No topics are given.", 'Give a list of {"topic_name", "message_type", "data"}.')
    return PublishedSeveral(await asyncio.gather(*(_publish_or_error(robot, p, report) for p in publications)))


async def _publish_or_error(robot: Robot, publication: Publication, report: Report) -> Published:
    try:
        return await publish(robot, publication, report)
    except RobotError as error:
        return Published("failed", publication.topic_name, error=str(error))


async def _send(robot: Robot, publication: Publication, report: Report) -> Sent:
    topic, kind = publication.topic_name, publication.topic_type
    rate_hz, duration_s = publication.frequency_hz, publication.duration_s
    if rate_hz is None and duration_s is None:
        to = await robot.types.destination(topic, kind)
        once = Publish(
            principal=robot.principal,
            name=to.topic,
            type=to.type,
            value=publication.data,
            choice=to.choice,
            wait_match_s=MATCH_S,
        )
        return await robot.do(once)
    if rate_hz is None or duration_s is None:
        given, missing = ("duration", "frequency") if rate_hz is None else ("frequency", "duration")
        raise BadInput(f"{given} is given without {missing}.", "To repeat, give both; to publish once, give neither.")
    bounded("frequency", rate_hz, MIN_RATE_HZ, MAX_RATE_HZ, "Hz")
    bounded("duration", duration_s, 0.0, MAX_DURATION_S, "s")
    to = await robot.types.destination(topic, kind)
    command = Repeat(
        principal=robot.principal,
        name=to.topic,
        type=to.type,
        value=publication.data,
        choice=to.choice,
        rate_hz=rate_hz,
        duration_s=duration_s,
        wait_match_s=MATCH_S,
    )
    repetition = Repetition(robot, command)

    async def tell() -> None:
        elapsed_s = min(repetition.elapsed_s, duration_s)
        await report(elapsed_s, duration_s, f"{topic}: publishing for {elapsed_s:.0f} of {duration_s:g} s")

    await robot.jobs.run(repetition, every_second=tell)
    if repetition.sent is None:
        raise LinkError(f"Publishing on {topic} was stopped, and the bridge has not said in time what was sent.")
    return repetition.sent


class Repetition(Job):
    """One message that is published again and again, which its call awaits. `sent` is what became of it."""

    kind = "repeat"
    most_running = 256
    """More topics than anybody publishes on at once; `ros2_topic_publish_several` counts as many as it has topics."""
    patience_s = 1.0
    """The bridge answers at once when it has ended a repetition, as `ros2_stop` tells it to before it asks the jobs."""

    def __init__(self, robot: Robot, command: Repeat) -> None:
        super().__init__(owner=command.principal, moves=[command.name])
        self._robot = robot
        self._command = command
        self.sent: Sent | None = None

    async def run(self) -> None:
        """Publishes in the bridge until its time is over, or the bridge is told to stop."""
        self.begun()
        self.sent = await self._robot.do(self._command)

    async def wind_down(self) -> None:
        """Leaves its call the time to tell what was sent."""


async def _note(robot: Robot, sent: Sent) -> str:
    notes: list[str] = []
    if not sent.matched:
        there = await robot.graph.endpoints(sent.topic)
        ours = [publisher for publisher in there.publishers if publisher.node in robot.graph.own_nodes]
        reasons = mismatches(ours, there.subscribers)
        notes.append("Nobody received it." if not reasons else f"Nobody received it: {' '.join(reasons)}")
        if not there.subscribers:
            notes.append(await _likely_typo(robot, sent.topic))
    if sent.acked is False:
        notes.append("Not every subscriber has acknowledged it in time.")
    if sent.late:
        notes.append(f"{sent.late} period(s) were missed.")
    if sent.ended_early:
        notes.append("It was ended before its time.")
    if sent.stopped_with_zero:
        notes.append("A zero command was sent at the end.")
    elif sent.type in VELOCITY_TYPES and sent.matched:
        notes.append(
            "No zero command follows: unless this was one, the robot moves until its own time-out. For a bounded move "
            "give frequency and duration."
        )
    return " ".join(filter(None, notes))


async def _likely_typo(robot: Robot, topic: str) -> str:
    """The topic with subscribers that was most likely meant; nothing if none is near."""
    listened_to = [row.name for row in await robot.graph.topics() if row.subscribers]
    near = names.nearest(topic, [name for name in listened_to if name != topic])
    return f"Did you mean {near}?" if near else ""
