"""Managed relays: messages of one topic appear on another, all of them, at a limited rate, or only changes."""

from __future__ import annotations

import asyncio
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from time import monotonic

from ros2_mcp.guard.policy import MAX_RATE_HZ, bounded
from ros2_mcp.guard.relays import Relay
from ros2_mcp.model import commands, names
from ros2_mcp.model.errors import BadInput, LinkError, NotFound, TypeConflict
from ros2_mcp.model.qos import Choice, QoS, for_subscribing
from ros2_mcp.ops import relaying
from ros2_mcp.robot import Robot, TopicEndpoints

TRANSFORMS = {"identity": "identity", "rate_limit": "rate_limit", "on_change": "on_change", "filter": "on_change"}
MAX_RELAYS = 32
MAX_RELAY_S = 86_400.0
_STARTED_S = 5.0
_STOPPED_S = 3.0
_MATCH_S = 1.0
_APPEARS_S = 1.0
_LATCHED_DEPTH = 10


@dataclass(frozen=True, slots=True)
class Wanted:
    """What to relay. `duration_s` 0 is until stopped; `destination_type` matters only with a mapping."""

    source_topic: str
    destination_topic: str
    message_type: str = ""
    transform: str = "identity"
    target_rate_hz: float = 10.0
    duration_s: float = 60.0
    tolerances: Mapping[str, float] = field(default_factory=dict[str, float])
    mapping: Mapping[str, str] = field(default_factory=dict[str, str])
    destination_type: str = ""


@dataclass(frozen=True, slots=True)
class RelayState:
    """A relay and what became of the messages so far.

    `state` is `starting`, `running`, `ended` (its time was over), `stopped` or `failed`. `passed` messages were
    published on the destination; `dropped` were held back by the transform; `lost` never reached the relay or had to
    be left out for want of time, null where that cannot be known; `failed` could not be decoded or mapped.
    `subscribers` and `publishers` are those matched now, or last.
    """

    relay_id: str
    state: str
    source_topic: str
    destination_topic: str
    message_type: str
    destination_type: str
    transform: str
    target_rate_hz: float | None
    duration_sec: float
    elapsed_sec: float
    passed: int
    dropped: int
    lost: int | None
    failed: int
    publishers: int | None
    subscribers: int
    stopped_with_zero: bool
    runs_in: str
    qos: Sequence[str]
    note: str

    def summary(self) -> str:
        """One line."""
        return (
            f"{self.relay_id} ({self.transform}) {self.source_topic} → {self.destination_topic}: {self.state}, "
            f"{self.passed} passed, {self.dropped} dropped. {self.note}"
        ).rstrip()


@dataclass(frozen=True, slots=True)
class RelayList:
    """Every relay that runs, and the last that ended."""

    relays: Sequence[RelayState]
    running: int

    def summary(self) -> str:
        """A line for each."""
        return "\n".join([f"{self.running} relay(s) running.", *(relay.summary() for relay in self.relays)])


async def start(robot: Robot, wanted: Wanted) -> RelayState:
    """Starts a relay and returns as soon as it runs; it goes on by itself.

    Raises:
        Refused: if this server is read-only.
        BadInput: if it would feed itself, runs already, or its options do not fit the types.
        NotFound, TypeConflict: if there is no source topic and no type is given, or the types differ.
    """
    source, destination = names.absolute(wanted.source_topic), names.absolute(wanted.destination_topic)
    _check(robot, wanted, source, destination)
    present = await robot.graph.wait_for(source, publishers=0 if wanted.message_type else 1, timeout_s=_APPEARS_S)
    there = await robot.graph.endpoints(destination)
    source_type = await robot.types.topic(present, wanted.message_type)
    destination_type = await _destination_type(robot, wanted, source_type, there)
    await robot.values.learn(source_type, destination_type)
    relay = _relay(robot, wanted, source, destination, (source_type, destination_type))
    transform = relaying.transform_of(robot, relay)
    command = _command(robot, relay, present, there)
    _check(robot, wanted, source, destination)  # another call may have been faster
    robot.relays.add(relay)
    relay.work = asyncio.create_task(relaying.keep(robot, relay, command, transform))
    await _until_started(relay)
    return _state(relay)


async def list_relays(robot: Robot) -> RelayList:
    """Every relay with its counts up to now."""
    if robot.relays.open:
        with suppress(LinkError):  # the bridge is gone: they are about to end, their last counts are what is known
            await relaying.look(robot)
    states = [_state(relay) for relay in robot.relays.known.values()]
    return RelayList(states, sum(state.state in ("starting", "running") for state in states))


async def stop(robot: Robot, relay_id: str) -> RelayState:
    """Ends a relay; one that has ended already stays as it was.

    Raises:
        NotFound: if there is no such relay.
    """
    known = robot.relays.known
    if relay_id not in known:
        raise NotFound(f"There is no relay {relay_id!r}.", f"Known are: {', '.join(known) or 'none'}.")
    relay = known[relay_id]
    if relay.is_open and relay.work is not None:
        await robot.end_relay(relay_id)
        await asyncio.wait({relay.work}, timeout=_STOPPED_S)
    return _state(relay)


def _check(robot: Robot, wanted: Wanted, source: str, destination: str) -> None:
    if wanted.transform not in TRANSFORMS:
        raise BadInput(f"There is no transform {wanted.transform!r}.", f"Choose from {', '.join(TRANSFORMS)}.")
    if TRANSFORMS[wanted.transform] != "on_change" and wanted.tolerances:
        raise BadInput(f"tolerances mean nothing with {wanted.transform}.", "They belong to transform on_change.")
    bounded("target_rate_hz", wanted.target_rate_hz, 0.001, MAX_RATE_HZ, "Hz")
    bounded("duration_sec", wanted.duration_s, 0.0, MAX_RELAY_S, "s")
    if source == destination:
        raise BadInput(f"A relay from {source} to itself would feed itself.", "Choose another destination.")
    way = robot.relays.way(destination, source)
    if way:
        raise BadInput(
            f"This relay would feed itself: relays lead from {' to '.join(way)} already.",
            "Stop one of them first (ros2_relay_stop).",
        )
    for relay in robot.relays.open:
        if (relay.source, relay.destination) == (source, destination):
            raise BadInput(f"{relay.relay_id} relays {source} to {destination} already.", "Stop it first.")
    if len(robot.relays.open) >= MAX_RELAYS:
        raise BadInput(f"{MAX_RELAYS} relays are running.", "Stop one first (ros2_relay_stop).")


async def _destination_type(robot: Robot, wanted: Wanted, source_type: str, there: TopicEndpoints) -> str:
    if wanted.mapping:
        try:
            return await robot.types.topic(there, wanted.destination_type)
        except NotFound as error:
            raise NotFound(f"{there.topic} has no type yet.", "Give destination_type, too.") from error
    if wanted.destination_type:
        raise BadInput("destination_type needs a mapping.", "Without one, the messages pass as they are.")
    try:
        return await robot.types.topic(there, source_type)
    except TypeConflict as error:
        raise TypeConflict(error.message, "Give a mapping of its fields, or another destination.") from error


def _relay(robot: Robot, wanted: Wanted, source: str, destination: str, types: tuple[str, str]) -> Relay:
    transform = TRANSFORMS[wanted.transform]
    return Relay(
        robot.relays.new_id(),
        source,
        destination,
        *types,
        transform,
        wanted.target_rate_hz if transform == "rate_limit" else None,
        wanted.duration_s,
        dict(wanted.tolerances),
        dict(wanted.mapping),
        in_server=transform == "on_change" or bool(wanted.mapping),
    )


def _command(robot: Robot, relay: Relay, present: TopicEndpoints, there: TopicEndpoints) -> commands.Relay:
    """What the bridge does of it: where the server feeds it, it has neither source, rate nor end."""
    publishers = [publisher for publisher in present.publishers if publisher.type == relay.source_type]
    subscribers = [subscriber for subscriber in there.subscribers if subscriber.type == relay.destination_type]
    reading = for_subscribing(publishers, depth=1000)
    asked = any(subscriber.qos.durability == "transient_local" for subscriber in subscribers)
    latched = reading.qos.durability == "transient_local"
    depths = [publisher.qos.depth or _LATCHED_DEPTH for publisher in publishers]
    writing = QoS(
        durability="transient_local" if latched or asked else "volatile",
        depth=min(sum(depths) or _LATCHED_DEPTH, 100) if latched or asked else 100,
    )
    relay.qos = _words(reading, writing)
    return commands.Relay(
        principal=robot.principal,
        name=relay.destination,
        type=relay.destination_type,
        relay_id=relay.relay_id,
        qos=writing,
        source="" if relay.in_server else relay.source,
        rate_hz=None if relay.in_server else relay.rate_hz,
        duration_s=None if relay.in_server else relay.duration_s,
        wait_match_s=_MATCH_S if subscribers else 0.0,
    )


def _words(reading: Choice, writing: QoS) -> list[str]:
    return [
        f"source: {reading.qos.reliability}, {reading.qos.durability} ({reading.reason})",
        f"destination: {writing.reliability}, {writing.durability}",
    ]


async def _until_started(relay: Relay) -> None:
    deadline = monotonic() + _STARTED_S
    while relay.state == "starting" and monotonic() < deadline:
        await asyncio.sleep(0.01)
    if relay.failure is not None:
        raise relay.failure


def _state(relay: Relay) -> RelayState:
    counts = relay.counts
    return RelayState(
        relay.relay_id,
        relay.state,
        relay.source,
        relay.destination,
        relay.source_type,
        relay.destination_type,
        relay.transform,
        relay.rate_hz,
        relay.duration_s,
        round(counts.elapsed_s, 3),
        counts.passed,
        counts.dropped + relay.held_back,
        _lost(relay),
        relay.failed,
        None if relay.in_server else counts.publishers,
        counts.matched,
        counts.final_sent,
        "server" if relay.in_server else "bridge",
        relay.qos,
        " ".join(_notes(relay)),
    )


def _lost(relay: Relay) -> int | None:
    in_bridge: int | None = relay.counts.lost
    if in_bridge is None or relay.lost_here is None:
        return None
    return in_bridge + relay.lost_here + relay.dropped_here


def _notes(relay: Relay) -> list[str]:
    notes = [str(relay.failure)] if relay.failure else []
    if relay.failed:
        notes.append(f"{relay.failed} message(s) could not be passed on, the last because: {relay.last_trouble}")
    if relay.dropped_here:
        notes.append(f"{relay.dropped_here} message(s) came faster than they could be compared.")
    if relay.is_open and not relay.counts.matched:
        notes.append("Nobody subscribes to the destination.")
    if relay.is_open and not relay.in_server and not relay.counts.publishers:
        notes.append("Nobody publishes on the source now; the relay waits.")
    return notes
