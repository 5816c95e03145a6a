"""Playing a bag: its bytes are published again in the rhythm in which they came."""

from __future__ import annotations

import asyncio
import itertools
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from time import monotonic
from typing import TYPE_CHECKING, Any

from ros2_mcp.guard.policy import bounded
from ros2_mcp.model import names
from ros2_mcp.model.commands import Feed, Play
from ros2_mcp.model.errors import BadInput, NotFound, Refused, RobotError, TypeConflict
from ros2_mcp.model.qos import QoS
from ros2_mcp.model.samples import Sample
from ros2_mcp.ops.memory import Memory
from ros2_mcp.ops.recorded import find_topic, span_in
from ros2_mcp.ops.results import Report, silent
from ros2_mcp.robot import VELOCITY_TYPES, Robot

if TYPE_CHECKING:
    from ros2_mcp.bags.bag import Bag
    from ros2_mcp.bags.stored import Span, StoredTopic

MAX_PLAYBACKS = 4
_SHORTEST_LOOP_S = 0.1
_MATCH_S = 1.0
_READY_S = 5.0
_KNOWN_S = 0.3
"""Subscribers get to know our publishers a moment later than these them; what comes before arrives late."""
_NAMED = 8
_BATCH = 64
_BATCH_BYTES = 4_000_000
_AHEAD_S = 0.002
_ids = itertools.count(1)


@dataclass(frozen=True, slots=True)
class Wanted:
    """What to play; `remaps` gives topics other names. With `force` also onto topics that have a publisher."""

    bag: str
    rate: float = 1.0
    start: str = ""
    end: str = ""
    topics: Sequence[str] = ()
    remaps: Mapping[str, str] = field(default_factory=dict[str, str])
    loop: bool = False
    force: bool = False


@dataclass(frozen=True, slots=True)
class PlaybackState:
    """A playback. `state` is `playing`, `ended`, `stopped` or `failed`; `late_s` how far it lags behind its rhythm."""

    playback_id: str
    bag: str
    state: str
    published: Mapping[str, int]
    progress: float
    loops: int
    elapsed_s: float
    late_s: float
    note: str

    def summary(self) -> str:
        """One line."""
        what = f"{sum(self.published.values())} messages, {self.progress:.0%} of {self.bag}"
        return f"{self.playback_id} {self.state}: {what}. {self.note}".rstrip()


@dataclass(frozen=True, slots=True)
class PlaybackStates:
    """All playbacks since the server started."""

    playbacks: Sequence[PlaybackState]

    def summary(self) -> str:
        """A line for each."""
        return "\n".join(each.summary() for each in self.playbacks) or "Nothing has been played."


class Playback:
    """One playback: a publisher in the bridge for each topic, fed in the recorded rhythm."""

    def __init__(self, robot: Robot, bag: Bag, wanted: Wanted, span: Span, topics: Mapping[str, StoredTopic]) -> None:
        self.id = f"play_{next(_ids)}"
        self._robot = robot
        self._bag = bag
        self._wanted = wanted
        self._span = span
        first_ns, last_ns = bag.times or (0, 1)
        self._first_ns = max(first_ns, span.start_ns)
        self._length_ns = max(min(last_ns, span.end_ns) - self._first_ns, 1)
        self._topics = topics
        self._published = dict.fromkeys(topics, 0)
        self._relays: list[asyncio.Task[Any]] = []
        self._work: asyncio.Task[None] | None = None
        self._state = "playing"
        self._note = ""
        self._progress, self._late_s, self._loops = 0.0, 0.0, 0
        self._started = monotonic()
        self._ended = 0.0

    @property
    def is_running(self) -> bool:
        """Whether it still plays."""
        return self._state == "playing"

    @property
    def destinations(self) -> list[str]:
        """The topics that it publishes on."""
        return [self._destination(name) for name in self._topics]

    async def begin(self) -> None:
        """Opens the publishers and starts to play; raises what keeps a publisher from being made, with all closed."""
        try:
            for name, topic in self._topics.items():
                self._relays.append(asyncio.create_task(self._open(name, topic)))
            for name in self._topics:
                await self._until_ready(name)
            await asyncio.sleep(_KNOWN_S)
            await self._note_who_listens()
            if self.is_running:
                self._work = asyncio.create_task(self._play())
        finally:
            if self._work is None:
                self._note = "It did not begin."
                await asyncio.shield(self._close("failed"))

    async def end(self) -> None:
        """Stops it, also while it is still beginning."""
        if self._work:
            if self.is_running:
                self._work.cancel()
            await asyncio.wait({self._work})
        if self.is_running:
            await self._close("stopped")

    async def wait(self, wait_s: float, report: Report) -> None:
        """Waits until it ends, at most that long, and reports."""
        deadline = monotonic() + wait_s
        while self._work and self.is_running and monotonic() < deadline:
            await asyncio.wait({self._work}, timeout=min(1.0, deadline - monotonic()))
            state = self.state()
            await report(state.progress, 1.0, state.summary())

    def state(self) -> PlaybackState:
        """How it stands."""
        elapsed = (self._ended or monotonic()) - self._started
        return PlaybackState(
            self.id,
            self._wanted.bag,
            self._state,
            {self._destination(name): count for name, count in self._published.items()},
            round(self._progress, 4),
            self._loops,
            round(elapsed, 3),
            round(self._late_s, 3),
            self._note,
        )

    def _destination(self, topic: str) -> str:
        return self._wanted.remaps.get(topic, topic)

    def _relay(self, topic: str) -> str:
        return f"{self.id}{topic}"

    async def _open(self, name: str, topic: StoredTopic) -> None:
        play = Play(
            principal=self._robot.principal,
            name=self._destination(name),
            type=topic.type,
            relay_id=self._relay(name),
            qos=_qos(topic),
            bag=self._wanted.bag,
            topic=name,
            wait_match_s=_MATCH_S,
        )
        await self._robot.do(play)

    async def _until_ready(self, name: str) -> None:
        deadline = monotonic() + _READY_S
        while self.is_running:
            for relay in self._relays:
                if relay.done():
                    relay.result()
            try:
                await self._pass_on(name, ())
                return
            except NotFound:
                if monotonic() > deadline:
                    raise
                await asyncio.sleep(0.02)

    async def _note_who_listens(self) -> None:
        relays = await self._robot.graph.relays()
        relay_of = {self._destination(name): relays.get(self._relay(name)) for name in self._topics}
        unheard = [topic for topic, relay in relay_of.items() if relay and not relay.matched]
        if unheard:
            more = f" and {len(unheard) - _NAMED} more" if len(unheard) > _NAMED else ""
            self._note = f"Nobody listened to {', '.join(unheard[:_NAMED])}{more} when it began."

    async def _play(self) -> None:
        state = "stopped"
        try:
            while True:
                begun = monotonic()
                await self._play_once(begun)
                self._loops += 1
                if not any(self._published.values()):
                    self._note = "Nothing was published: no message of these topics is in that part of the bag."
                    break
                if not self._wanted.loop:
                    break
                await asyncio.sleep(begun + self._loop_s - monotonic())
            state = "ended"
        except NotFound:
            lost = [each.exception() for each in self._relays if each.done() and each.exception()]
            state = "failed" if lost else "stopped"
            self._note = str(lost[0]) if lost else "Its publishers have been ended, as ros2_stop does."
        except RobotError as error:
            state, self._note = "failed", str(error)
        finally:
            await self._close(state)

    async def _close(self, state: str) -> None:
        if self.is_running:
            self._state, self._ended = state, monotonic()
        for relay in self._relays:
            relay.cancel()
        await asyncio.gather(*self._relays, return_exceptions=True)
        self._note = " ".join(filter(None, (self._note, *self._bag.problems)))
        self._bag.close()

    @property
    def _loop_s(self) -> float:
        return max(self._length_ns / 1e9 / self._wanted.rate, _SHORTEST_LOOP_S)

    async def _play_once(self, begun: float) -> None:
        messages = self._bag.messages(self._span)
        while batch := await asyncio.to_thread(_next_batch, messages):
            for due_ns, group in _together(batch, self._wanted.rate):
                away_ns = due_ns - self._first_ns
                due = begun + away_ns / 1e9 / self._wanted.rate
                if (pause := due - monotonic()) > 0:
                    await asyncio.sleep(pause)
                self._late_s = max(0.0, monotonic() - due)
                await self._feed(group)
                self._progress = min(max(away_ns / self._length_ns, 0.0), 1.0)
        self._progress = 1.0

    async def _feed(self, group: Sequence[tuple[str, Sample]]) -> None:
        """Publishes messages in their order, those of the same topic that follow each other at once."""
        for topic, members in itertools.groupby(group, key=lambda each: each[0]):
            bodies = [sample.data for _, sample in members]
            await self._pass_on(topic, bodies)
            self._published[topic] += len(bodies)

    async def _pass_on(self, topic: str, messages: Sequence[bytes]) -> None:
        to, kind, relay_id = self._destination(topic), self._topics[topic].type, self._relay(topic)
        feed = Feed(principal=self._robot.principal, name=to, type=kind, relay_id=relay_id, messages=messages)
        await self._robot.do(feed)


async def play(
    robot: Robot, memory: Memory, wanted: Wanted, wait_s: float = 40.0, report: Report = silent
) -> PlaybackState:
    """Plays a bag, or a part of it; after `wait_s` it goes on by itself. A waiting that is cancelled stops it.

    Raises:
        Refused: if this server is read-only; without `force`, if a topic has a live publisher, or somebody listens to a
            velocity command.
        NotFound: if there is no such bag, or it has no such topic.
        TypeConflict: if a topic is there with another type.
        UnknownInterface: if the robot does not know a type.
    """
    bounded("rate", wanted.rate, 0.01, 100.0, "times")
    if sum(each.is_running for each in playbacks(memory).values()) >= MAX_PLAYBACKS:
        raise Refused(f"{MAX_PLAYBACKS} playbacks run already.", "Stop one with ros2_bag_play_stop.")
    wanted = replace(wanted, remaps={names.absolute(a): names.absolute(b) for a, b in wanted.remaps.items()})
    bag, span, topics = await asyncio.to_thread(_prepare, memory, wanted)
    try:
        await _check(robot, memory, wanted, topics)
        playback = Playback(robot, bag, wanted, span, topics)
    except (RobotError, asyncio.CancelledError):
        bag.close()
        raise
    memory.running[playback.id] = playback
    try:
        await playback.begin()
        await playback.wait(wait_s, report)
    except BaseException:
        await asyncio.shield(playback.end())
        raise
    return playback.state()


def playbacks(memory: Memory) -> dict[str, Playback]:
    """The playbacks of this server, by their ids."""
    return {name: each for name, each in memory.running.items() if isinstance(each, Playback)}


async def status(memory: Memory, playback_id: str = "") -> PlaybackStates:
    """How playbacks stand; all of this server, or one."""
    chosen = [_find(memory, playback_id)] if playback_id else list(playbacks(memory).values())
    return PlaybackStates([each.state() for each in chosen])


async def stop(memory: Memory, playback_id: str) -> PlaybackState:
    """Stops a playback."""
    playback = _find(memory, playback_id)
    await playback.end()
    return playback.state()


def _prepare(memory: Memory, wanted: Wanted) -> tuple[Bag, Span, dict[str, StoredTopic]]:
    from ros2_mcp.bags.bag import Bag

    bag = Bag(memory.find_bag(wanted.bag))
    try:
        chosen = [find_topic(bag, name) for name in wanted.topics] or list(bag.topics.values())
        topics = {topic.name: topic for topic in chosen}
        unknown = set(wanted.remaps) - set(topics)
        if unknown:
            raise BadInput(f"{sorted(unknown)[0]} is remapped, but not played.", f"Played: {', '.join(topics)}.")
        _check_types({(wanted.remaps.get(name, name), topic.type) for name, topic in topics.items()})
        return bag, replace(span_in(memory, bag, wanted.start, wanted.end), topics=frozenset(topics)), topics
    except RobotError:
        bag.close()
        raise


def _check_types(destinations: Collection[tuple[str, str]]) -> None:
    for destination, type_name in destinations:
        for other in (kind for name, kind in destinations if name == destination and kind != type_name):
            raise TypeConflict(f"{destination} would be both a {type_name} and a {other}.", "Give other remaps.")


async def _check(robot: Robot, memory: Memory, wanted: Wanted, topics: Mapping[str, StoredTopic]) -> None:
    own = robot.graph.own_nodes  # it keeps publishers ready that say nothing
    ours = {to: each.id for each in playbacks(memory).values() if each.is_running for to in each.destinations}
    ours |= {relay.destination: relay.relay_id for relay in robot.relays.open}
    busy: list[str] = []
    driven: list[str] = []
    for name, topic in topics.items():
        destination = wanted.remaps.get(name, name)
        present = await robot.graph.endpoints(destination)
        if present.types and topic.type not in present.types:
            raise TypeConflict(f"{destination} has the type {present.types[0]}, the bag's {name} is a {topic.type}.")
        others = [each.node for each in present.publishers if each.node not in own]
        others += [ours[destination]] if destination in ours else []
        busy += [f"{destination} ({others[0]})"] if others else []
        moved = [each.node for each in present.subscribers if each.node not in own and topic.type in VELOCITY_TYPES]
        driven += [f"{moved[0]} listens to {destination}"] if moved else []
    if busy and not wanted.force:
        raise Refused(
            f"These topics have a live publisher: {', '.join(busy)}.", "Use remaps, choose topics, or give force."
        )
    if driven and not wanted.force:
        raise Refused(f"It would move the robot: {', '.join(driven)}.", "Use remaps, choose topics, or give force.")
    await robot.values.learn(*(topic.type for topic in topics.values()))


def _qos(topic: StoredTopic) -> QoS:
    from ros2_mcp.bags.qos import is_latched

    return QoS("reliable", "transient_local" if is_latched(topic.qos) else "volatile", depth=100)


def _next_batch(messages: Iterator[tuple[str, Sample]]) -> list[tuple[str, Sample]]:
    batch: list[tuple[str, Sample]] = []
    size = 0
    for message in messages:
        batch.append(message)
        size += len(message[1].data)
        if len(batch) >= _BATCH or size >= _BATCH_BYTES:
            break
    return batch


def _together(batch: Sequence[tuple[str, Sample]], rate: float) -> Iterator[tuple[int, list[tuple[str, Sample]]]]:
    """Groups of messages that are due within two milliseconds, with the time of the first."""
    group: list[tuple[str, Sample]] = []
    for message in batch:
        if group and message[1].received_ns - group[0][1].received_ns > _AHEAD_S * 1e9 * rate:
            yield group[0][1].received_ns, group
            group = []
        group.append(message)
    if group:
        yield group[0][1].received_ns, group


def _find(memory: Memory, playback_id: str) -> Playback:
    known = playbacks(memory)
    if playback_id not in known:
        raise NotFound(f"There is no playback {playback_id!r}.", f"Known are: {', '.join(known) or 'none'}.")
    return known[playback_id]
