"""Play a bag: publish its bytes again in the recorded rhythm."""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from time import monotonic
from typing import TYPE_CHECKING

import anyio
from anyio import to_thread

from ros2_mcp.bags.stored import Span, StoredTopic
from ros2_mcp.guard.policy import bounded
from ros2_mcp.model import names
from ros2_mcp.model.commands import Feed, Play
from ros2_mcp.model.errors import BadInput, NotFound, Refused, RobotError, Stopped, TypeConflict, UnknownInterface
from ros2_mcp.model.graph import RelayCounts
from ros2_mcp.model.qos import QoS
from ros2_mcp.model.samples import Sample
from ros2_mcp.model.text import listed, named
from ros2_mcp.model.times import seconds_from_start
from ros2_mcp.ops.acting.endings import ended_by, guarded, held_back, limited, reason_of
from ros2_mcp.ops.memory.bag_store import BagStore
from ros2_mcp.ops.results.results import IF_ANY, Report, iso_time, silent
from ros2_mcp.ops.sources.bag import find_topic, latched_before, span_in
from ros2_mcp.robot import MOTION_TYPES, Robot
from ros2_mcp.robot.jobs import Job
from ros2_mcp.robot.session import Session

if TYPE_CHECKING:
    from ros2_mcp.bags.bag import Bag

_SHORTEST_LOOP_S = 0.1
"""The least duration of a loop: a bag of a single message would otherwise be published as fast as the processor can."""
_MATCH_S = 1.0
"""How long the bridge waits for subscribers that discovery may still be matching with our new publishers."""
_READY_S = 5.0
"""Time for the bridge to create a publisher: it creates a hundred within a second; a publisher that is not there by
then will not come.
"""
_DEPTH = 100
"""Messages queued for a slow subscriber: a second of a topic at 100 Hz."""
_ANSWERED_S = 0.5
"""Time for the answer about an ended publisher: the bridge sends it before it rejects a
feed, so it has only to be read."""
_POLL_S = 0.02
"""Seconds between two checks of whether a publisher is ready; a publisher takes milliseconds."""
_DISCOVERED_S = 0.3
"""Time for subscribers to discover our publishers, a little after these discover them;
messages sent earlier arrive late."""
_MOST_NAMED = 8
"""The most topics that a note names; a bag may have a hundred without subscribers."""
_BATCH = 64
_BATCH_BYTES = 4_000_000
"""How much is read ahead of its time, in messages and bytes: enough that no message waits for the disk,
and little memory with pictures."""
_TOGETHER_S = 0.002
"""Messages that are due within this time are sent in one request: no subscriber can
notice, and it saves round trips."""


@dataclass(frozen=True, kw_only=True, slots=True)
class PlayRequest:
    """The settings of a playback; `remaps` gives topics other names. With `force` it also publishes
    on topics that have a publisher.

    `rate` is the speed, relative to the recording. `start` and `end` bound the part of the bag.
    """

    bag: str
    rate: float = 1.0
    start: str = ""
    end: str = ""
    topics: Sequence[str] = ()
    remaps: Mapping[str, str] = field(default_factory=dict[str, str])
    loop: bool = False
    force: bool = False


@dataclass(frozen=True, kw_only=True, slots=True)
class PlaybackState:
    """A playback. `state` is `playing`, `ended`, `stopped` or `failed`; `late_s` is how far it lags behind the recorded
    timing.

    `at` is the playback position as a recorded time, `seconds_from_start` the same as an offset from the start of the
    bag.
    """

    playback_id: str
    bag: str
    state: str
    published: Mapping[str, int]
    progress: float
    at: str
    seconds_from_start: float | None
    loops: int
    elapsed_s: float
    late_s: float
    note: str = field(metadata=IF_ANY)

    def summary(self) -> str:
        """Return the result in one line."""
        what = f"{sum(self.published.values())} messages, {self.progress:.0%} of {named(self.bag)}, at {self.at}"
        what += f" ({self.seconds_from_start:g} s in)" if self.seconds_from_start is not None else ""
        return f"{self.playback_id} {self.state}: {what}. {self.note}".rstrip()


@dataclass(frozen=True, slots=True)
class PlaybackStates:
    """All running playbacks, and the playbacks that ended last."""

    playbacks: Sequence[PlaybackState]

    def summary(self) -> list[str]:
        """Return a line for each."""
        return [playback.summary() for playback in self.playbacks] or ["Nothing has been played."]


class Playback(Job):
    """One playback: a publisher in the bridge for each topic, fed in the recorded rhythm."""

    kind = "playback"
    listed_by = "ros2_bag_play_status"
    stopped_by = "ros2_bag_play_stop"

    def __init__(
        self,
        robot: Robot,
        session: Session,
        request: PlayRequest,
        *,
        store: BagStore,
        bag: Bag,
        span: Span,
        topics: Mapping[str, StoredTopic],
        unknown: Mapping[str, str],
    ) -> None:
        self._destinations = {name: request.remaps.get(name, name) for name in topics}
        super().__init__(owner=session.principal, moves=list(self._destinations.values()))
        self._robot, self._session = robot, session
        self._store = store
        self._bag = bag
        self._request = request
        self._span = span
        first_ns, last_ns = bag.times or (0, 1)
        self._began_ns = first_ns
        self._start_ns = max(first_ns, span.start_ns)
        self._length_ns = max(min(last_ns, span.end_ns) - self._start_ns, 1)
        self._topics = topics
        left_out = [] if request.topics else [topic for topic in bag.topics.values() if topic.name not in topics]
        self._left_out: dict[str, list[str]] = {}
        for topic in sorted(left_out, key=lambda topic: topic.name):
            why = unknown.get(topic.name) or _why_not(topic, request.remaps)
            self._left_out.setdefault(why, []).append(topic.name)
        self._fed = dict.fromkeys(topics, 0)
        self._published = dict.fromkeys(topics, 0)
        """The number of published messages of each topic, as far as the bridge has reported it."""
        self._ended: dict[str, RelayCounts] = {}
        """The bridge's last counts of the publishers that it has ended; a feed in progress does not return these
        counts.
        """
        self._note = ""
        self._guarded = ""
        self._progress = 0.0
        self._loops = 0
        self._late_s = 0.0

    @property
    def about(self) -> str:
        """The name of the bag."""
        return self._request.bag

    async def run(self) -> None:
        """Open the publishers and play. The publishers are requests to the bridge that stay
        open: if one is lost, all end.
        """
        try:
            async with anyio.create_task_group() as publishers:
                for name, topic in self._topics.items():
                    publishers.start_soon(self._open, name, topic)
                for name in self._topics:
                    await self._until_ready(name)
                await anyio.sleep(_DISCOVERED_S)
                relays = await self._robot.graph.relays()
                feeds = {self._destinations[name]: relays.get(self._relay_id(name)) for name in self._topics}
                waited_s = max((relay.stopper_s for relay in feeds.values() if relay), default=0.0)
                unguarded = next((relay.unguarded for relay in feeds.values() if relay and relay.unguarded), "")
                self._guarded = guarded(waited_s, unguarded)
                unheard = [topic for topic, relay in feeds.items() if relay and not relay.matched]
                if unheard:
                    more = f" and {len(unheard) - _MOST_NAMED} more" if len(unheard) > _MOST_NAMED else ""
                    self._note = f"No subscriber when it began: {', '.join(unheard[:_MOST_NAMED])}{more}."
                self.begun()
                await self._play()
                publishers.cancel_scope.cancel()
        finally:
            self._bag.close()

    async def wind_down(self) -> None:
        """Make the bridge end the publishers and answer with its last counts: messages that
        were just fed may have been sent.
        """
        async with anyio.create_task_group() as group:
            for name in self._topics:
                group.start_soon(self._robot.end_relay, self._relay_id(name))
        while self.is_running and len(self._ended) < len(self._topics):
            await anyio.sleep(_POLL_S)
        self.cancel()

    def report(self) -> PlaybackState:
        """Return the current state of the playback."""
        note = self._note
        if not self.has_begun and not self.is_running:
            note = "It did not begin."
        elif self.failure:
            note = str(self.failure)
        elif self.stop_reason and not self.is_running:
            note = ended_by(self.stop_reason)
        at_ns = self._start_ns + round(self._progress * self._length_ns)
        ended = {name: self._counts_at_end(name) for name in self._topics}
        published = {name: counts.passed if counts else self._published[name] for name, counts in ended.items()}
        refused = sum(c.refused if c else self._fed[name] - published[name] for name, c in ended.items())
        slower = sum(counts.limited for counts in ended.values() if counts)
        left_out = "; ".join(f"{listed(found, _MOST_NAMED)} ({why})" for why, found in self._left_out.items())
        told = (
            f"Not played: {left_out}." if left_out else "",
            self._guarded,
            held_back(refused) if refused else "",
            limited(slower) if slower else "",
        )
        return PlaybackState(
            playback_id=self.id,
            bag=self._request.bag,
            state="playing" if self.is_running else self.state,
            published={self._destinations[name]: count for name, count in published.items()},
            progress=round(self._progress, 4),
            at=iso_time(at_ns),
            seconds_from_start=seconds_from_start(at_ns, self._began_ns),
            loops=self._loops,
            elapsed_s=round(self.elapsed_s, 3),
            late_s=round(self._late_s, 3),
            note=" ".join(filter(None, (note, *told, *self._store.problems_of(self._bag)))),
        )

    def _relay_id(self, topic: str) -> str:
        """Return the id of the bridge's part that publishes a topic of the bag."""
        return f"{self.id}{topic}"

    def _counts_at_end(self, topic: str) -> RelayCounts | None:
        """Return the bridge's last counts of a topic's publisher; None while it is open."""
        return self._ended.get(topic) or self._robot.graph.relay_ended(self._relay_id(topic))

    async def _open(self, name: str, topic: StoredTopic) -> None:
        from ros2_mcp.bags.qos import is_latched  # imports rosbags: 55 ms that the start of the server need not take

        play = Play(
            principal=self.owner,
            name=self._destinations[name],
            type=topic.type,
            relay_id=self._relay_id(name),
            qos=QoS("reliable", "transient_local" if is_latched(topic.qos) else "volatile", depth=_DEPTH),
            bag=self._request.bag,
            topic=name,
            part=f"{iso_time(self._start_ns)} to {iso_time(self._start_ns + self._length_ns)}",
            duration_s=0.0 if self._request.loop else self._length_ns / 1e9 / self._request.rate,
            force=self._request.force,
            speed=self._request.rate,
            wait_match_s=_MATCH_S,
        )
        self._ended[name] = await self._robot.do(play, self._session)

    async def _until_ready(self, name: str) -> None:
        """Return when the topic's publisher can be fed; only a feed, even without messages, shows that."""
        deadline = monotonic() + _READY_S
        while True:
            try:
                await self._feed(name, ())
                return
            except NotFound:
                if monotonic() > deadline:
                    raise
                await anyio.sleep(_POLL_S)

    async def _play(self) -> None:
        try:
            while True:
                begun = monotonic()
                await self._play_once(begun)
                self._loops += 1
                if not any(self._published.values()):
                    self._note = "Nothing was published: that part of the bag has no messages of these topics."
                    return
                if not self._request.loop:
                    return
                loop_s = max(self._length_ns / 1e9 / self._request.rate, _SHORTEST_LOOP_S)
                await anyio.sleep(max(0.0, begun + loop_s - monotonic()))
        except Stopped as stopped:
            self.outcome, self.stop_reason = "stopped", self.stop_reason or stopped.reason
        except NotFound:  # the bridge has ended its publishers, and has reported that
            self.outcome = "stopped"
            if not self.is_stopping:
                self.stop_reason = await self._ended_by() or "the bridge"

    async def _ended_by(self) -> str:
        """Return what ended a publisher, as soon as the bridge has reported it; empty if it has not."""
        with anyio.move_on_after(_ANSWERED_S):
            while True:
                for counts in self._ended.values():
                    if reason := reason_of(self._robot, counts.ended_by):
                        return reason
                await anyio.sleep(_POLL_S)
        return ""

    async def _play_once(self, begun: float) -> None:
        """Publish the messages of the span in their recorded rhythm, counted from `begun`.
        Late messages are sent at once.
        """
        for topic, sample in await to_thread.run_sync(self._latched):
            self._published[topic] = await self._feed(topic, [sample.data])
            self._fed[topic] += 1
        rate, messages = self._request.rate, self._bag.messages(self._span)
        while batch := await to_thread.run_sync(_next_batch, messages):
            for group in _together(batch, rate):
                since_start_ns = group[0][1].received_ns - self._start_ns
                due = begun + since_start_ns / 1e9 / rate
                if (pause := due - monotonic()) > 0:
                    await anyio.sleep(pause)
                self._late_s = max(0.0, monotonic() - due)
                for topic, members in itertools.groupby(group, key=lambda message: message[0]):
                    bodies = [sample.data for _, sample in members]
                    self._published[topic] = await self._feed(topic, bodies)
                    self._fed[topic] += len(bodies)
                self._progress = min(max(since_start_ns / self._length_ns, 0.0), 1.0)
        self._progress = 1.0

    def _latched(self) -> list[tuple[str, Sample]]:
        """Return the latched messages from before the part of the bag that is played: at its beginning, a late
        subscriber would have received them.
        """
        span = replace(self._span, start_ns=self._start_ns)
        return [(name, one) for name, topic in self._topics.items() for one in latched_before(self._bag, topic, span)]

    async def _feed(self, topic: str, messages: Sequence[bytes]) -> int:
        """Send messages to the bridge. Return how many it has published so far on that topic."""
        feed = Feed(
            principal=self.owner,
            name=self._destinations[topic],
            type=self._topics[topic].type,
            relay_id=self._relay_id(topic),
            messages=messages,
        )
        return await self._robot.do(feed, self._session)


async def play(
    robot: Robot,
    session: Session,
    store: BagStore,
    request: PlayRequest,
    wait_s: float = 40.0,
    report: Report = silent,
) -> PlaybackState:
    """Play a bag, or a part of it. After `wait_s` the playback continues by itself; if the call is cancelled, it stops.

    Raises:
        Refused: if this server is read-only, or too many playbacks run; without `force`, if a topic has a live
            publisher, or a velocity topic has a subscriber.
        NotFound: if there is no such bag, or it has no such topic.
        TypeConflict: if a topic is there with another type.
        UnknownInterface: if the robot does not know the type of a topic that was asked for, or of any.
    """
    bounded("rate", request.rate, 0.01, 100.0, "times")
    robot.jobs.require_room(Playback)
    request = replace(request, remaps={recorded: names.absolute(name) for recorded, name in request.remaps.items()})
    request, bag, span, chosen = await to_thread.run_sync(_prepare, store, request)

    async def tell() -> None:
        state = playback.report()
        await report(state.progress, 1.0, state.summary())

    try:
        topics, unknown = await _installed(robot, request, chosen)
        await _check(robot, request, topics)
        span = replace(span, topics=frozenset(topics))
        playback = Playback(robot, session, request, store=store, bag=bag, span=span, topics=topics, unknown=unknown)
        await robot.jobs.start(playback)
    except BaseException:  # also if the call is cancelled
        bag.close()
        raise
    await robot.jobs.wait(playback, wait_s, every_second=tell)
    return playback.report()


async def status(robot: Robot, playback_id: str = "") -> PlaybackStates:
    """Return the state of playbacks: the playback with that id, or all running playbacks and the last that ended."""
    return PlaybackStates([playback.report() for playback in robot.jobs.chosen(Playback, playback_id)])


async def stop(robot: Robot, playback_id: str = "") -> PlaybackState:
    """Stop a playback. Raises the same errors as `Jobs.one`."""
    return (await robot.jobs.stop(Playback, playback_id)).report()


def _prepare(store: BagStore, request: PlayRequest) -> tuple[PlayRequest, Bag, Span, dict[str, StoredTopic]]:
    """Return the request with the topics' names as they are in the bag, the bag, the span to play,
    and the topics to play by name.
    """
    from ros2_mcp.bags.bag import Bag  # imports mcap and YAML, a tenth of the time that all tools take to import

    bag = Bag(store.find_bag(request.bag))
    try:
        remaps = {_name_in(bag, recorded): name for recorded, name in request.remaps.items()}
        chosen = [find_topic(bag, name) for name in request.topics]
        for topic in chosen:
            if (why := _why_not(topic, remaps)) and why != _OF_ACTION:  # a topic requested by name is played
                raise BadInput(f"{named(topic.name)} cannot be played: {why}.", _REMAP if topic.form == "ros2" else "")
        chosen = chosen or [topic for topic in bag.topics.values() if not _why_not(topic, remaps)]
        topics = {topic.name: topic for topic in chosen}
        unknown = set(remaps) - set(topics)
        if unknown:
            raise BadInput(
                f"remaps names {named(sorted(unknown)[0])}, which is not played.",
                f"Played: {', '.join(map(named, topics))}.",
            )
        if not topics:
            why = "; ".join(f"{named(topic.name)}: {_why_not(topic, remaps)}" for topic in bag.topics.values())
            raise BadInput(f"Nothing of {named(request.bag)} can be played. {why}.", _REMAP)
        request = replace(request, remaps={name: remaps.get(name) or names.absolute(name) for name in topics})
        types: dict[str, str] = {}
        for name, topic in topics.items():
            destination = request.remaps.get(name, name)
            other = types.setdefault(destination, topic.type)
            if other != topic.type:
                what = f"{named(destination)} would be both a {named(topic.type)} and a {named(other)}."
                raise TypeConflict(what, "Give other remaps.")
        return request, bag, replace(span_in(store, bag, request.start, request.end), topics=frozenset(topics)), topics
    except RobotError:
        bag.close()
        raise


def _name_in(bag: Bag, name: str) -> str:
    """Return the name of a topic as it is in the bag; a name that the bag does not have is returned unchanged."""
    try:
        return find_topic(bag, name).name
    except NotFound:
        return name


def _why_not(topic: StoredTopic, remaps: Mapping[str, str]) -> str:
    """Return a phrase that says why a topic cannot be played; empty if it can."""
    if topic.form != "ros2":
        return f"its messages are {topic.type.partition(':')[0]}, not of ROS 2"
    if names.is_of_action(topic.name) and topic.name not in remaps:
        return _OF_ACTION
    return "" if topic.name in remaps or names.is_valid(topic.name) else "ROS allows no such name"


_OF_ACTION = "published by servers of actions"
_REMAP = 'Give it a name of ROS with remaps, such as {"vehicle.speed": "/vehicle/speed"}.'


async def _installed(
    robot: Robot, request: PlayRequest, topics: Mapping[str, StoredTopic]
) -> tuple[Mapping[str, StoredTopic], Mapping[str, str]]:
    """Return the topics whose types the robot knows, and why each of the other topics is left out. Raises
    `UnknownInterface` if one of these was requested by name, or no topic is left.
    """
    errors: dict[str, UnknownInterface] = {}
    for name in {topic.type for topic in topics.values()}:
        try:
            await robot.values.learn(name)
        except UnknownInterface as error:
            errors[name] = error
    known = {name: topic for name, topic in topics.items() if topic.type not in errors}
    unknown = {name: topic.type for name, topic in topics.items() if topic.type in errors}
    if unknown and (request.topics or not known):
        name, type_name = next(iter(unknown.items()))
        others = f" Without it {listed(list(known), _MOST_NAMED)} can be played: name them in topics." if known else ""
        error = errors[type_name]
        raise UnknownInterface(f"{named(name)} cannot be played. {error.message}", f"{error.hint}{others}".lstrip())
    return known, {name: f"{named(kind)} is not known where the bridge runs" for name, kind in unknown.items()}


async def _check(robot: Robot, request: PlayRequest, topics: Mapping[str, StoredTopic]) -> None:
    """Check the topics against the robot's graph as it is now. Raises the same errors as `play`."""
    own = robot.graph.own_nodes  # the bridge keeps publishers ready that publish nothing
    ours = {topic: job.id for job in robot.jobs.running(Job) for topic in job.moves}
    busy: list[str] = []
    driven: list[str] = []
    for name, topic in topics.items():
        destination = request.remaps.get(name, name)
        present = await robot.graph.endpoints(destination)
        if present.types and topic.type not in present.types:
            raise TypeConflict(
                f"{destination} has the type {present.types[0]}, but the bag's {named(name)} is a {named(topic.type)}."
            )
        publishers = [publisher.node for publisher in present.publishers if publisher.node not in own]
        publishers += [ours[destination]] if destination in ours else []
        if publishers:
            busy.append(f"{destination} ({publishers[0]})")
        subscribers = [subscriber.node for subscriber in present.subscribers if subscriber.node not in own]
        if subscribers and topic.type in MOTION_TYPES:
            driven.append(f"{subscribers[0]} listens to {destination}")
    hint = "Give `remaps`, choose other topics, or set force=true."
    if busy and not request.force:
        raise Refused(f"These topics have a live publisher: {', '.join(busy)}.", hint)
    if driven and not request.force:
        raise Refused(f"Playing would move the robot: {', '.join(driven)}.", hint)


def _next_batch(messages: Iterator[tuple[str, Sample]]) -> list[tuple[str, Sample]]:
    batch: list[tuple[str, Sample]] = []
    size = 0
    for message in messages:
        batch.append(message)
        size += len(message[1].data)
        if len(batch) >= _BATCH or size >= _BATCH_BYTES:
            break
    return batch


def _together(batch: Sequence[tuple[str, Sample]], rate: float) -> Iterator[list[tuple[str, Sample]]]:
    """Yield groups of messages that are due within `_TOGETHER_S`."""
    group: list[tuple[str, Sample]] = []
    for message in batch:
        if group and message[1].received_ns - group[0][1].received_ns > _TOGETHER_S * 1e9 * rate:
            yield group
            group = []
        group.append(message)
    if group:
        yield group
