"""The subjects that can be watched: topics, the graph, goals, diagnostics, parameters, the log."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncGenerator, Callable, Sequence
from contextlib import aclosing, suppress
from dataclasses import dataclass
from time import monotonic
from typing import Any, TypeAlias

from ros2_mcp.model.errors import NotFound
from ros2_mcp.model.goals import STATUS_TYPE, TERMINAL, goal_id_hex
from ros2_mcp.model.names import is_hidden
from ros2_mcp.model.samples import Sample
from ros2_mcp.ops.log import read as log
from ros2_mcp.ops.measure.diagnostics import DIAGNOSTICS, DiagnosticTable
from ros2_mcp.robot import Robot
from ros2_mcp_common.wire.protocol import Keep

# Seconds between two looks at the graph: people perceive that delay as none, and the bridge answers from memory.
POLL_S = 0.25
# Seconds between comparisons of the publishers' QoS with ours: other QoS are rare, and cost only a delay.
_ENDPOINTS_S = 2.0
# One wait of the bridge; it is repeated as long as a client watches.
_APPEARS_S = 60.0
# Messages within that time were published before, and are no change: matching takes up to 200 ms on a host. An action's
# status gets more time, because a goal that had ended before would else count as one that ends now.
_LATCHED_S = 0.5
_MATCHING_S = 0.2
# Samples queued while a client is notified, which takes 0.2 s: those of a topic at 5 kHz.
_MAX_SAMPLES = 1000


_Arrived: TypeAlias = "tuple[str, list[Sample], Callable[[Sample], bool]]"


@dataclass(frozen=True, slots=True)
class Seen:
    """The newest sample of a topic, with its type; `is_old`: it was sent before this server subscribed."""

    type: str
    sample: Sample
    is_old: bool = False


@dataclass(frozen=True, slots=True)
class Unchanging:
    """A subject that never changes, such as a definition."""

    async def changes(self, robot: Robot) -> AsyncGenerator[Any, None]:  # noqa: ARG002
        """Yield once, and never again."""
        yield None
        await asyncio.Event().wait()


@dataclass(frozen=True, slots=True)
class TopicSamples:
    """The samples of a topic, which need not exist yet."""

    topic: str

    async def changes(self, robot: Robot) -> AsyncGenerator[Seen | None, None]:
        """Yield the newest sample (None at first, if there is no sample), then each newer sample."""
        async with aclosing(_samples(robot, self.topic, "latest")) as arrivals:
            type_name, samples, is_old = await anext(arrivals)
            yield Seen(type_name, samples[-1], is_old(samples[-1])) if samples else None
            async for type_name, samples, is_old in arrivals:
                if samples:
                    yield Seen(type_name, samples[-1], is_old(samples[-1]))


@dataclass(frozen=True, slots=True)
class GraphParts:
    """Parts of the graph: `nodes`, `topics`, `services`. The subscribers of a topic do
    not count, as this server is one.
    """

    parts: Sequence[str]

    async def changes(self, robot: Robot) -> AsyncGenerator[None, None]:
        """Yield at the beginning, and whenever something appeared or disappeared."""
        before: list[Any] | None = None
        while True:
            now = [await _outline(robot, part) for part in self.parts]
            if now != before:
                before = now
                yield None
            await asyncio.sleep(POLL_S)


@dataclass(frozen=True, slots=True)
class GoalsEnded:
    """The goals of every action, and the list of actions."""

    async def changes(self, robot: Robot) -> AsyncGenerator[None, None]:
        """Yield at the beginning, and whenever a goal has ended, or an action appeared or disappeared."""
        ended, followers = asyncio.Event(), dict[str, asyncio.Task[None]]()
        before: set[str] | None = None
        try:
            while True:
                actions = set(await robot.types.actions())
                await asyncio.gather(*(_follow_goals(robot, action, ended, followers) for action in actions))
                if ended.is_set() or actions != before:
                    before = actions
                    ended.clear()
                    yield None
                with suppress(asyncio.TimeoutError):
                    await asyncio.wait_for(ended.wait(), POLL_S)
        finally:
            for follower in followers.values():
                follower.cancel()
            await asyncio.gather(*followers.values(), return_exceptions=True)


@dataclass(frozen=True, slots=True)
class WorseDiagnostics:
    """The components that report on /diagnostics."""

    async def changes(self, robot: Robot) -> AsyncGenerator[DiagnosticTable, None]:
        """Yield the table of all components, which stays up to date, at the beginning and
        whenever a component's level worsens.
        """
        table = DiagnosticTable()
        async with aclosing(_samples(robot, DIAGNOSTICS, "all")) as arrivals:
            type_name, samples, _ = await anext(arrivals)
            await asyncio.to_thread(table.add_all, robot, type_name, samples)
            yield table
            async for type_name, samples, _ in arrivals:
                if await asyncio.to_thread(table.add_all, robot, type_name, samples):
                    yield table


@dataclass(frozen=True, slots=True)
class ParametersOf:
    """The parameters of one node."""

    node: str

    async def changes(self, robot: Robot) -> AsyncGenerator[None, None]:
        """Yield at the beginning, and whenever the node reports that a parameter has changed."""
        async with aclosing(_samples(robot, "/parameter_events", "all")) as arrivals:
            await anext(arrivals)
            yield None
            async for type_name, samples, _ in arrivals:
                messages: list[Any] = await robot.values.decode_all(type_name, samples)
                if any(message.node == self.node for message in messages):
                    yield None


@dataclass(frozen=True, slots=True)
class LogLines:
    """The lines of /rosout from a level on, of one node or of all; with the fields of `ops.log.LogRequest`."""

    level: str = ""
    node: str = ""

    async def changes(self, robot: Robot) -> AsyncGenerator[None, None]:
        """Yield at the beginning, and whenever such a line arrives."""
        least, arrived = log.level_number(self.level), asyncio.Event()

        def check(level: int, sample: Sample) -> None:
            if level >= least and (not self.node or log.is_node(log.line_of(robot, sample).node, self.node)):
                arrived.set()

        await log.read(robot, log.LogRequest(limit=1))
        stop = robot.log.on_line(check)
        try:
            yield None
            while True:
                await arrived.wait()
                arrived.clear()
                yield None
        finally:
            stop()


async def _samples(robot: Robot, topic: str, keep: Keep) -> AsyncGenerator[_Arrived, None]:
    """Yield the type of a topic, its new samples, and a function that says whether a sample is from before the
    subscription. The subscription follows the publishers' QoS.

    Whenever a subscription begins, yield the samples that arrived until every publisher had matched, or none. While the
    topic does not exist, yield no samples.
    """
    present = await robot.graph.endpoints(topic)
    while True:
        while not present.publishers:
            yield "", [], lambda _: False
            present = await robot.graph.wait_for(topic, publishers=1, timeout_s=_APPEARS_S)
        type_name = present.publishers[0].type
        async with robot.listen(topic, type_name, keep=keep, max_samples=_MAX_SAMPLES) as listening:
            yield type_name, await listening.take(_MATCHING_S), listening.is_from_before
            fits = True
            while fits:
                compare_at = monotonic() + _ENDPOINTS_S
                while (left := compare_at - monotonic()) > 0:
                    if samples := await listening.take(left):
                        yield type_name, samples, listening.is_from_before
                present = await robot.graph.endpoints(topic)
                is_published = any(publisher.type == type_name for publisher in present.publishers)
                fits = is_published and listening.still_fits(present)


async def _follow_goals(
    robot: Robot, action: str, ended: asyncio.Event, followers: dict[str, asyncio.Task[None]]
) -> None:
    """Start following the goals of an action, unless that is under way already. Return when it has begun or failed."""
    if action not in followers or followers[action].done():
        begun = asyncio.Event()
        followers[action] = asyncio.create_task(_goals(robot, action, ended, begun))
        await begun.wait()


async def _goals(robot: Robot, action: str, ended: asyncio.Event, begun: asyncio.Event) -> None:
    """Set `ended` whenever the action's status reports further goals as ended."""
    try:
        with suppress(NotFound):
            async with robot.listen(f"{action}/_action/status", STATUS_TYPE, keep="latest") as listening:
                before = await _ended_goals(robot, await listening.take(_LATCHED_S))
                begun.set()
                while True:
                    if samples := await listening.take(_APPEARS_S):
                        now = await _ended_goals(robot, samples)
                        if now - before:
                            ended.set()
                        before = now
    finally:
        begun.set()


async def _ended_goals(robot: Robot, samples: Sequence[Sample]) -> set[str]:
    """Return the goals that the newest status reports as ended."""
    if not samples:
        return set()
    message: Any = (await robot.values.decode_all(STATUS_TYPE, samples[-1:]))[0]
    return {
        goal_id_hex([int(byte) for byte in status.goal_info.goal_id.uuid])
        for status in message.status_list
        if int(status.status) in TERMINAL
    }


async def _outline(robot: Robot, part: str) -> list[Any]:
    """Return the facts about a part of the graph whose change is reported."""
    if part == "topics":
        topics = [row for row in await robot.graph.topics() if not is_hidden(row.name)]
        return sorted((row.name, row.types, row.publishers) for row in topics)
    if part == "services":
        return sorted(row for row in await robot.graph.services() if not is_hidden(row.name))
    return sorted(await robot.graph.nodes())
