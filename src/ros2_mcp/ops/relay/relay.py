"""Relays: messages of one topic are published on another, all of them, at a limited rate, or only changes.

A relay is a request to the bridge that stays open. If the values of messages matter, the server takes part in it: it
subscribes to the source, and sends the bridge the messages to publish.
"""

from __future__ import annotations

import asyncio
import math
from collections import deque
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from time import monotonic

import anyio

from ros2_mcp.guard.policy import bounded
from ros2_mcp.model import commands, names
from ros2_mcp.model.aside import aside, load
from ros2_mcp.model.errors import BadData, BadInput, BadValue, LinkError, NotFound, Stopped, TypeConflict
from ros2_mcp.model.graph import RelayCounts, TopicEndpoints
from ros2_mcp.model.qos import QoS, for_subscribing
from ros2_mcp.model.samples import Counts, Sample
from ros2_mcp.model.text import counted
from ros2_mcp.ops.acting.endings import ended_by, guarded, held_back, limited, reason_of
from ros2_mcp.ops.results.results import IF_ANY, SAID
from ros2_mcp.robot import Robot
from ros2_mcp.robot.jobs import Job, State
from ros2_mcp.robot.session import Session
from ros2_mcp_common.rhythm import Rhythm
from ros2_mcp_common.wire.limits import MAX_RATE_HZ, MIN_RATE_HZ

Transform = Callable[[Sample], "bytes | None"]
"""Returns the bytes to publish for a message, or None if it is held back."""

TRANSFORMS = {"identity": "identity", "rate_limit": "rate_limit", "on_change": "on_change", "filter": "on_change"}
MAX_RELAY_S = 86_400.0
"""A day: longer than any task of a robot, and short enough that a forgotten relay ends."""
DEFAULT_RATE_HZ = 10.0
"""The rate limit if none is given: fast enough to follow a robot, and the default of the relay prompt."""
_STARTED_S = 5.0
"""A relay that has not begun by then (the bridge is busy) is reported as `starting`, and goes on."""
_MATCH_S = 1.0
"""How long the bridge waits for the destination's subscribers, which discovery may still be matching."""
_APPEARS_S = 1.0
"""How long to wait for a publisher of the source if no type is given: it may just be starting."""
_LOOK_EVERY_S = 0.02
"""Seconds between two checks of whether a relay has begun, which takes a few milliseconds."""
_SILENT_S = 1.0
"""After this long without a message, the publishers are looked up again: a new publisher may need another QoS."""
_LATCHED_DEPTH = 10
"""The depth assumed for a publisher whose depth is unknown; `/tf_static` with ten broadcasters fits."""
_DEPTH = 100
"""Messages queued for a slow subscriber of the destination: a second of a topic at 100 Hz."""
_BATCH = 100
_BATCH_BYTES = 1_000_000
"""The most that is sent to the bridge in one request, in messages and bytes: large enough that a request's overhead
does not matter, small enough that no request takes long."""


@dataclass(frozen=True, kw_only=True, slots=True)
class RelayRequest:
    """The settings of a relay. `duration_s` 0: until stopped. `destination_type` is allowed only with a mapping,
    `target_rate_hz` only with the transform `rate_limit` (default: `DEFAULT_RATE_HZ`).
    """

    source_topic: str
    destination_topic: str
    message_type: str = ""
    transform: str = "identity"
    target_rate_hz: float | None = None
    duration_s: float = 60.0
    tolerances: Mapping[str, float] = field(default_factory=dict[str, float])
    mapping: Mapping[str, str] = field(default_factory=dict[str, str])
    destination_type: str = ""


@dataclass(frozen=True, kw_only=True, slots=True)
class RelayState:
    """A relay and its message counts.

    `state` is `starting`, `running`, `ended` (its duration was over), `stopped` or `failed`. `published` messages were
    published on the destination; `filtered_out` were omitted by the transform; `lost` did not reach the relay, or
    arrived faster than it could compare them (null if unknown); `errors` could not be decoded or mapped, or were
    velocities that are not finite. `subscribers` and `publishers` are the numbers matched now, or when the relay ended.
    `process` is where the relay runs: `bridge` or `server`.
    """

    relay_id: str = field(metadata=SAID)
    state: State = field(metadata=SAID)
    source_topic: str = field(metadata=SAID)
    destination_topic: str = field(metadata=SAID)
    message_type: str
    destination_type: str
    transform: str
    target_rate_hz: float | None
    duration_sec: float
    elapsed_sec: float
    published: int = field(metadata=SAID)
    filtered_out: int = field(metadata=SAID)
    lost: int | None
    errors: int
    publishers: int | None
    subscribers: int
    stopped_with_zero: bool
    process: str
    qos: Sequence[str]
    note: str = field(metadata=IF_ANY)

    def summary(self) -> str:
        """Return the result in one line."""
        return (
            f"{self.relay_id} ({self.transform}) {self.source_topic} → {self.destination_topic}: {self.state}, "
            f"{self.published} published, {self.filtered_out} filtered out. {self.note}"
        ).rstrip()


@dataclass(frozen=True, slots=True)
class RelayList:
    """All running relays, and the relays that ended last."""

    relays: Sequence[RelayState]
    running: int

    def summary(self) -> list[str]:
        """Return a line for each relay."""
        return [f"{counted(self.running, 'relay')} running.", *(relay.summary() for relay in self.relays)]


class Relay(Job):
    """A relay in progress. The bridge's part of it has the same id.

    `source_type` and `destination_type` are full types that the codec has learnt.
    """

    kind = "relay"
    most_running = 32
    listed_by = "ros2_relay_list"
    stopped_by = "ros2_relay_stop"

    def __init__(
        self,
        robot: Robot,
        session: Session,
        request: RelayRequest,
        *,
        source: TopicEndpoints,
        destination: TopicEndpoints,
        source_type: str,
        destination_type: str,
    ) -> None:
        super().__init__(owner=session.principal, moves=[destination.topic])
        self.source, self.destination = source.topic, destination.topic
        self._robot, self._session = robot, session
        self._request = request
        self.at_most_s = request.duration_s or math.inf
        self._types = source_type, destination_type
        self._transform = TRANSFORMS[request.transform]
        self._rate_hz = (request.target_rate_hz or DEFAULT_RATE_HZ) if self._transform == "rate_limit" else None
        self._in_server = self._transform == "on_change" or bool(request.mapping)
        self._pass = self._make_transform()
        self._choose_qos(source, destination)
        self.counts = RelayCounts()
        """The bridge's last counts; the counts of the server's own part follow below."""
        self._held_back = 0
        self._failed = 0
        self._last_error = ""
        self._listened = Counts()
        self._time_is_over = False

    def check_beside(self, running: Sequence[Job]) -> None:
        """Raise `BadInput` if this relay would feed itself through others, or if the same relay already runs."""
        others = [job for job in running if isinstance(job, Relay)]
        topics = path_between(((other.source, other.destination) for other in others), self.destination, self.source)
        if topics:
            raise BadInput(
                f"This relay would feed itself: relays already lead from {' to '.join(topics)}.",
                "Stop one of these relays first (ros2_relay_stop).",
            )
        for other in others:
            if (other.source, other.destination) == (self.source, self.destination):
                raise BadInput(f"{other.id} relays {self.source} to {self.destination} already.", "Stop it first.")

    async def run(self) -> None:
        """Keep the bridge's part open until that ends, and feed it if values matter."""
        relay = commands.Relay(
            principal=self.owner,
            name=self.destination,
            type=self._types[1],
            relay_id=self.id,
            qos=self._qos,
            source=self.source,
            is_fed=self._in_server,
            rate_hz=self._rate_hz,
            duration_s=self._request.duration_s,
            wait_match_s=self._wait_match_s,
        )
        async with anyio.create_task_group() as group:
            group.start_soon(self._feed_until_over if self._in_server else self._until_open)
            self.counts = await self._robot.do(relay, self._session)
            group.cancel_scope.cancel()
        is_early = self.counts.ended_by and not self._time_is_over
        self.outcome = "stopped" if is_early else "ended"
        self.stop_reason = self.stop_reason or reason_of(self._robot, self.counts.ended_by)

    async def wind_down(self) -> None:
        """Make the bridge send the zero, if the relay has a zero, and answer with its last counts."""
        await self._robot.end_relay(self.id)

    def report(self) -> RelayState:
        """Return the current state of the relay."""
        counts = self.counts = self.counts if self.is_running else self._robot.graph.relay_ended(self.id) or self.counts
        late, unseen = self._listened.dropped, self._listened.lost
        lost = None if counts.lost is None or unseen is None else counts.lost + unseen + late
        publishers = None if self._in_server else counts.publishers
        is_told = isinstance(self.failure, Stopped) and self.stop_reason  # `ended_by` says it
        notes: list[str] = [str(self.failure)] if self.failure and not is_told else []
        if self._failed:
            notes.append(f"{counted(self._failed, 'message')} could not be published; last error: {self._last_error}")
        notes.append(guarded(counts.stopper_s, counts.unguarded))
        if counts.refused:
            notes.append(held_back(counts.refused))
        if counts.limited:
            notes.append(limited(counts.limited))
        if self.stop_reason and not self.is_running:
            notes.append(ended_by(self.stop_reason))
        if late:
            notes.append(f"{counted(late, 'message')} came faster than they could be compared.")
        if self.is_running and not counts.matched:
            notes.append("The destination has no subscriber.")
        if self.is_running and publishers == 0:
            notes.append("The source has no publisher now; the relay waits.")
        return RelayState(
            relay_id=self.id,
            state=self.state,
            source_topic=self.source,
            destination_topic=self.destination,
            message_type=self._types[0],
            destination_type=self._types[1],
            transform=self._transform,
            target_rate_hz=self._rate_hz,
            duration_sec=self._request.duration_s,
            elapsed_sec=round(counts.elapsed_s, 3),
            published=counts.passed,
            filtered_out=counts.dropped + self._held_back,
            lost=lost,
            errors=self._failed + counts.refused,
            publishers=publishers,
            subscribers=counts.matched,
            stopped_with_zero=counts.final_sent,
            process="server" if self._in_server else "bridge",
            qos=self._qos_words,
            note=" ".join(filter(None, notes)),
        )

    # ── the bridge's part ──────────────────────────────────────────────────────────────────────────────────────

    def _choose_qos(self, source: TopicEndpoints, destination: TopicEndpoints) -> None:
        """Choose the destination's QoS: latched if the source is, or a subscriber asks for it, with room
        for what every publisher keeps.
        """
        publishers = [publisher for publisher in source.publishers if publisher.type == self._types[0]]
        subscribers = [subscriber for subscriber in destination.subscribers if subscriber.type == self._types[1]]
        reading = for_subscribing(publishers, depth=1000)
        is_asked_for = any(subscriber.qos.durability == "transient_local" for subscriber in subscribers)
        is_latched = is_asked_for or reading.qos.durability == "transient_local"
        kept = sum(publisher.qos.depth or _LATCHED_DEPTH for publisher in publishers) or _LATCHED_DEPTH
        self._qos = QoS(
            durability="transient_local" if is_latched else "volatile",
            depth=min(kept, _DEPTH) if is_latched else _DEPTH,
        )
        self._wait_match_s = _MATCH_S if subscribers else 0.0
        self._qos_words = [
            f"source: {reading.qos.reliability}, {reading.qos.durability} ({reading.reason})",
            f"destination: {self._qos.reliability}, {self._qos.durability}",
        ]

    async def _until_open(self) -> None:
        while not (counts := await self._robot.graph.relays()).get(self.id, RelayCounts()).running:
            await anyio.sleep(_LOOK_EVERY_S)
        self.counts = counts[self.id]
        self.begun()

    # ── the server's part ──────────────────────────────────────────────────────────────────────────────────────

    async def _feed_until_over(self) -> None:
        await self._until_open()
        end = monotonic() + (self._request.duration_s or math.inf)
        while (left_s := end - monotonic()) > 0:
            present = await self._robot.graph.wait_for(self.source, publishers=1, timeout_s=min(left_s, _SILENT_S))
            if present.publishers:
                await self._feed_from(end)
        self._time_is_over = True
        await self.wind_down()

    async def _feed_from(self, end: float) -> None:
        """Feed the bridge from one subscription, until the time is over or another QoS fits the publishers better.

        The QoS is checked only while no message arrives: a subscription with the wrong QoS receives nothing.
        """
        before = self._listened
        async with self._robot.listen(self.source, self._types[0]) as listening:
            while (left_s := end - monotonic()) > 0:
                samples = await listening.take(min(left_s, _SILENT_S))
                for start in range(0, len(samples), _BATCH):
                    await self._feed(samples[start : start + _BATCH])
                self._listened = before + listening.counts
                is_silent = not samples and left_s > _SILENT_S
                if is_silent and not listening.still_fits(await self._robot.graph.endpoints(self.source)):
                    return

    async def _feed(self, samples: Sequence[Sample]) -> None:
        """Send the messages that pass the transform to the bridge, several in a request as long as they are small."""
        batch: list[bytes] = []
        size = 0
        for sample in samples:
            await asyncio.sleep(0)  # a hundred messages take 100 ms, and the link lease is renewed by this event loop
            try:
                message = await aside(len(sample.data), self._pass, sample)
            except (BadValue, BadData) as error:
                self._failed += 1
                self._last_error = str(error)
                continue
            if message is None:
                self._held_back += 1
                continue
            if batch and size + len(message) > _BATCH_BYTES:
                await self._send(batch)
                batch, size = [], 0
            batch.append(message)
            size += len(message)
        if batch:
            await self._send(batch)

    async def _send(self, messages: Sequence[bytes]) -> None:
        feed = commands.Feed(
            principal=self.owner, name=self.destination, type=self._types[1], relay_id=self.id, messages=messages
        )
        try:
            await self._robot.do(feed, self._session)
        except (NotFound, Stopped):
            await anyio.sleep_forever()  # the bridge has ended the relay, and its answer to that is under way

    def _make_transform(self) -> Transform:
        """Return the transform of a message. Raises `BadInput` if an option does not fit the types."""
        # Loaded with the first relay: numpy, which these need, would double the time until tools/list is answered.
        from ros2_mcp.values.change import ChangeDetector
        from ros2_mcp.values.mapping import FieldMapping

        codec, request = self._robot.values.codec, self._request
        change = ChangeDetector(codec, self._types[0], request.tolerances) if self._transform == "on_change" else None
        rhythm = Rhythm(self._rate_hz) if self._rate_hz else None
        mapping = FieldMapping(codec, *self._types, request.mapping) if request.mapping else None

        def transform(sample: Sample) -> bytes | None:
            if change is not None and not change.is_change(sample.data):
                return None
            if rhythm is not None and not rhythm.passes(sample.received_ns):
                return None
            return mapping.apply(sample.data) if mapping is not None else sample.data

        return transform


async def start(robot: Robot, session: Session, request: RelayRequest) -> RelayState:
    """Start a relay, and return as soon as it runs; it continues by itself.

    Raises:
        Refused: if this server is read-only, or too many relays run.
        BadInput: if it would feed itself, runs already, or its options do not fit the types.
        NotFound: if the source has no type and none is given, or with a mapping the destination has none.
        TypeConflict: if the source has several types and none is given, or not the given type; or if the destination
            has another type and no mapping is given, or with a mapping another than `destination_type`.
    """
    source, destination = names.absolute(request.source_topic), names.absolute(request.destination_topic)
    if request.transform not in TRANSFORMS:
        raise BadInput(f"There is no transform {request.transform!r}.", f"Choose from {', '.join(TRANSFORMS)}.")
    if TRANSFORMS[request.transform] != "on_change" and request.tolerances:
        raise BadInput(
            f"tolerances have no meaning with {request.transform}.", "Leave tolerances out, or use transform on_change."
        )
    if request.target_rate_hz is not None:
        if TRANSFORMS[request.transform] != "rate_limit":
            raise BadInput(
                f"target_rate_hz has no meaning with {request.transform}.",
                "Leave target_rate_hz out, or use transform rate_limit.",
            )
        bounded("target_rate_hz", request.target_rate_hz, MIN_RATE_HZ, MAX_RATE_HZ, "Hz")
    bounded("duration_sec", request.duration_s, 0.0, MAX_RELAY_S, "s")
    if source == destination:
        raise BadInput(f"A relay from {source} to itself would feed itself.", "Choose another destination.")
    robot.jobs.require_room(Relay)
    sending = await robot.graph.wait_for(source, publishers=0 if request.message_type else 1, timeout_s=_APPEARS_S)
    receiving = await robot.graph.endpoints(destination)
    source_type = await robot.types.topic(sending, request.message_type)
    destination_type = await _destination_type(robot, request, source_type, receiving)
    await robot.values.learn(source_type, destination_type)
    await load("ros2_mcp.values.change", "ros2_mcp.values.mapping")
    relay = Relay(
        robot,
        session,
        request,
        source=sending,
        destination=receiving,
        source_type=source_type,
        destination_type=destination_type,
    )
    await robot.jobs.start(relay, within_s=_STARTED_S)
    return relay.report()


async def list_relays(robot: Robot) -> RelayList:
    """Return every relay with its counts up to now."""
    if robot.jobs.running(Relay):
        with suppress(
            LinkError
        ):  # the bridge is gone: the relays are about to end, their last counts are all that is known
            counts = await robot.graph.relays()
            for relay in robot.jobs.running(Relay):  # relays that ended meanwhile keep their last counts
                relay.counts = counts.get(relay.id, relay.counts)
    states = [relay.report() for relay in robot.jobs.all(Relay)]
    return RelayList(states, len(robot.jobs.running(Relay)))


async def stop(robot: Robot, relay_id: str = "") -> RelayState:
    """End a relay. One that has ended already stays as it is.

    Raises:
        NotFound: if there is no such relay.
        BadInput: if several run and no id is given.
    """
    return (await robot.jobs.stop(Relay, relay_id)).report()


def path_between(relays: Iterable[tuple[str, str]], start: str, end: str) -> list[str]:
    """Return the topics along relays (source, destination) from one topic to another; empty if
    no chain of relays leads there.
    """
    pairs = list(relays)
    paths = deque([[start]])
    seen = {start}
    while paths:
        topics = paths.popleft()
        if topics[-1] == end:
            return topics
        following = dict.fromkeys(to for source, to in pairs if source == topics[-1] and to not in seen)
        seen.update(following)
        paths.extend([*topics, topic] for topic in following)
    return []


async def _destination_type(robot: Robot, request: RelayRequest, source_type: str, receiving: TopicEndpoints) -> str:
    if request.mapping:
        try:
            return await robot.types.topic(receiving, request.destination_type)
        except NotFound as error:
            raise NotFound(f"{receiving.topic} has no type yet.", "Give destination_type.") from error
    if request.destination_type:
        raise BadInput(
            "destination_type needs a mapping.",
            "Give a mapping, or leave destination_type out to pass messages unchanged.",
        )
    try:
        return await robot.types.topic(receiving, source_type)
    except TypeConflict as error:
        raise TypeConflict(error.message, "Give a mapping of its fields, or another destination.") from error
