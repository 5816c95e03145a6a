"""Recording topics: bytes go from the robot to the disk, never decoded, and topics that appear later join in."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Sequence
from contextlib import AbstractAsyncContextManager
from dataclasses import dataclass, field, replace
from pathlib import Path
from time import monotonic
from typing import TYPE_CHECKING

from ros2_mcp.guard.policy import bounded
from ros2_mcp.model import names, qos
from ros2_mcp.model.commands import Record
from ros2_mcp.model.errors import BadInput, LinkError, NotFound, Refused, RobotError
from ros2_mcp.model.samples import Counts, Sample
from ros2_mcp.ops.memory import Memory
from ros2_mcp.ops.opening import opened
from ros2_mcp.ops.results import iso_time
from ros2_mcp.robot import Listening, Robot

if TYPE_CHECKING:
    from ros2_mcp.bags.recorder import Limits, Recorder

MAX_DURATION_S = 7 * 86_400.0
MAX_RECORDINGS = 4
_TURN_S = 0.1
_LOOK_S = 1.0
_JOINED_S = 2.0
_WAITING_BYTES = 64_000_000
_MOST_NOTES = 20


@dataclass(frozen=True, slots=True)
class Wanted:
    """What to record; without topics and patterns, everything that is not hidden.

    A topic is left as soon as it has a message larger than `largest` bytes (0: never), unless it is latched.
    """

    topics: Sequence[str] = ()
    patterns: Sequence[str] = ()
    max_duration_s: float = 0.0
    max_bytes: int = 0
    split_bytes: int = 0
    name: str = ""
    largest: int = 0

    def chooses(self, topic: str) -> bool:
        """Whether a topic of the graph is recorded."""
        if topic in self.topics:
            return True
        if names.is_hidden(topic):
            return False
        if not self.patterns:
            return not self.topics
        return any(names.matching([topic], pattern) for pattern in self.patterns)


@dataclass(frozen=True, slots=True)
class TopicCounts:
    """One topic of a recording.

    `written` messages are in the file; `dropped` were discarded because the disk or this server was too slow; `lost`
    never arrived (null where that cannot be known).
    """

    topic_name: str
    topic_type: str
    written: int
    dropped: int
    lost: int | None
    error: str = ""


@dataclass(frozen=True, slots=True)
class RecordingState:
    """A recording. `bag` is its name for the tools that read bags; `state` is `recording`, `ended` or `failed`."""

    recording_id: str
    state: str
    bag: str
    path: str
    started_at: str
    elapsed_s: float
    bytes: int
    messages: int
    topics: Sequence[TopicCounts]
    reason: str
    notes: Sequence[str]

    def summary(self) -> str:
        """One line."""
        dropped = sum(topic.dropped for topic in self.topics)
        lost = f", {dropped} dropped" if dropped else ""
        return (
            f"{self.recording_id} {self.state}: {self.messages} messages of {len(self.topics)} topics, "
            f"{self.bytes} bytes{lost} in {self.elapsed_s:.1f} s. {self.reason}"
        ).rstrip()


@dataclass(frozen=True, slots=True)
class RecordingStates:
    """All recordings since the server started."""

    recordings: Sequence[RecordingState]

    def summary(self) -> str:
        """A line for each."""
        return "\n".join(each.summary() for each in self.recordings) or "Nothing has been recorded."


@dataclass(slots=True)
class _Joined:
    """A topic that is being recorded; `lost` is the subscription that went with a bridge, to be made anew."""

    type: str
    publishers: int
    task: asyncio.Task[None] | None = None
    listening: Listening | None = None
    lost: Listening | None = None
    former: Counts = field(default_factory=Counts)
    error: str = ""
    leaving: bool = False

    @property
    def is_joining(self) -> bool:
        """Whether its subscription is still to come."""
        return self.listening is None and not self.error

    def counts(self) -> Counts:
        """What became of the messages, over all subscriptions there were."""
        return self.former if self.listening is None else _sum(self.former, self.listening.counts)


class Recording:
    """One recording under way: finds its topics, subscribes to them and hands their bytes to the recorder."""

    def __init__(self, robot: Robot, recording_id: str, folder: Path, recorder: Recorder, wanted: Wanted) -> None:
        self.id = recording_id
        self.folder = folder
        self._robot = robot
        self._recorder = recorder
        self._wanted = wanted
        self._topics: dict[str, _Joined] = {}
        self._notes: list[str] = []
        self._stopping = False
        self._started_ns = time.time_ns()
        self._watch: asyncio.Task[None] | None = None

    async def begin(self) -> None:
        """Subscribes to the topics that are there and looks for more from then on; ends it all if it is cancelled."""
        try:
            await self._look_or_note()
            deadline = monotonic() + _JOINED_S
            while any(each.is_joining for each in self._topics.values()) and monotonic() < deadline:
                await asyncio.sleep(_TURN_S / 5)
            self._watch = asyncio.create_task(self._keep_looking())
        finally:
            if self._watch is None:
                await asyncio.shield(self.end())

    async def end(self) -> None:
        """Ends the subscriptions, takes what they still have, and closes the files."""
        await self._leave("stopped")

    @property
    def is_running(self) -> bool:
        """Whether it still records."""
        return not self._recorder.ended

    def state(self) -> RecordingState:
        """How it stands."""
        recorder = self._recorder
        counts = dict(recorder.sink.counts)
        state = "recording" if self.is_running else "failed" if recorder.failed else "ended"
        return RecordingState(
            self.id,
            state,
            self.folder.name,
            str(self.folder),
            iso_time(self._started_ns),
            round(recorder.elapsed_s, 3),
            recorder.sink.size,
            sum(counts.values()),
            [self._topic_counts(name, joined, counts) for name, joined in sorted(self._topics.items())],
            "" if self.is_running else recorder.ended,
            [*self._notes, *recorder.notes, *self._unheard()],
        )

    def _unheard(self) -> list[str]:
        said = "nobody has published it so far; it joins within a second after somebody does."
        return [f"{name}: {said}" for name in self._wanted.topics if name not in self._topics]

    def _topic_counts(self, name: str, joined: _Joined, written: dict[str, int]) -> TopicCounts:
        counts = joined.counts()
        dropped = counts.dropped + self._recorder.dropped.get(name, 0)
        return TopicCounts(name, joined.type, written.get(name, 0), dropped, counts.lost, joined.error)

    async def _keep_looking(self) -> None:
        while self.is_running and not self._stopping:
            await asyncio.sleep(_LOOK_S)
            await self._look_or_note()
        if not self._stopping:
            await self._leave("stopped")

    async def _leave(self, reason: str) -> None:
        self._stopping = True
        tasks = [joined.task for joined in self._topics.values() if joined.task]
        if tasks:
            await asyncio.wait(tasks, timeout=3.0)
        await asyncio.to_thread(self._recorder.stop, reason)
        if self._watch and self._watch is not asyncio.current_task():
            self._watch.cancel()

    async def _look_or_note(self) -> None:
        try:
            await self._look()
        except RobotError as error:
            self._note(str(error))

    async def _look(self) -> None:
        """Joins new topics that are wanted; joins those anew whose publishers now need another QoS."""
        for row in await self._robot.graph.topics():
            name, types, publishers = row.name, row.types, row.publishers
            if not publishers or self._stopping or not self._wanted.chooses(name):
                continue
            joined = self._topics.get(name)
            if joined is None:
                self._join(name, types, publishers)
            elif joined.publishers != publishers and joined.listening:
                joined.publishers = publishers
                joined.leaving = await self._needs_another_qos(name, joined.listening)

    def _join(self, name: str, types: Sequence[str], publishers: int) -> None:
        joined = self._topics[name] = _Joined(types[0], publishers)
        if len(types) > 1:
            joined.error = f"It has several types: {', '.join(types)}."
            return
        joined.task = asyncio.create_task(self._record(name, joined))

    async def _needs_another_qos(self, name: str, listening: Listening) -> bool:
        present = await self._robot.graph.endpoints(name)
        publishers = [each for each in present.publishers if each.type == listening.type]
        if not publishers:
            return False
        now, then = qos.for_subscribing(publishers).qos, listening.choice.qos
        return (now.reliability, now.durability) != (then.reliability, then.durability)

    async def _record(self, name: str, joined: _Joined) -> None:
        """Until the recording ends: subscription after subscription, should the bridge be lost meanwhile."""
        while not self._stopping:
            try:
                await self._record_once(name, joined)
            except LinkError as error:
                self._note(f"{name}: {error}")
                await asyncio.sleep(_TURN_S)
            except RobotError as error:
                joined.error = str(error)
                return

    async def _record_once(self, name: str, joined: _Joined) -> None:
        joined.leaving = False
        async with self._subscription(name, joined) as listening:
            if joined.lost is None:
                self._describe(listening)
            joined.listening, joined.lost = listening, None
            try:
                while not (self._stopping or joined.leaving or self._recorder.ended):
                    samples = await listening.take(0.0)
                    self._require_small(listening, samples)
                    self._recorder.put(name, samples)
                    await asyncio.sleep(_TURN_S)
            except LinkError:
                joined.former, joined.listening, joined.lost = joined.counts(), None, listening
                raise
        self._recorder.put(name, await listening.take(0.0))
        joined.former, joined.listening = joined.counts(), None
        if self._recorder.ended:
            self._stopping = True

    def _require_small(self, listening: Listening, samples: Sequence[Sample]) -> None:
        largest, latched = self._wanted.largest, listening.choice.qos.durability == "transient_local"
        size = max((len(sample.data) for sample in samples), default=0)
        if largest and not latched and size > largest:
            raise Refused(f"Left out: it has messages of {size} bytes, more than {largest}.", "Name it to have it.")

    def _subscription(self, name: str, joined: _Joined) -> AbstractAsyncContextManager[Listening]:
        if joined.lost is not None:
            return self._robot.listen_again(joined.lost, max_bytes=_WAITING_BYTES)
        return self._robot.listen(name, joined.type, max_bytes=_WAITING_BYTES)

    def _describe(self, listening: Listening) -> None:
        from ros2_mcp.bags.qos import qos_text
        from ros2_mcp.bags.schema import schema_text
        from ros2_mcp.bags.stored import StoredTopic

        definitions = self._robot.values.definitions
        text = schema_text(definitions.interface(listening.type))
        profiles = qos_text([publisher.qos for publisher in listening.publishers])
        topic = StoredTopic(listening.topic, listening.type, None, "ros2msg", text, profiles)
        self._recorder.add_topic(topic, next((p.hash for p in listening.publishers if p.hash), ""))

    def _note(self, text: str) -> None:
        if text not in self._notes and len(self._notes) < _MOST_NOTES:
            self._notes.append(text)


async def start(robot: Robot, memory: Memory, wanted: Wanted) -> RecordingState:
    """Begins to record; it goes on until a limit is reached, it is stopped, or the server ends.

    Raises:
        Refused: if this server is read-only, or too many recordings run.
        BadInput: if the folder cannot be written or the disk is nearly full.
        BadValue: if a limit is out of range.
    """
    wanted = _checked(wanted)
    await robot.do(Record(principal=robot.principal, name=wanted.name, topics=wanted.topics))
    if sum(each.is_running for each in recordings(memory).values()) >= MAX_RECORDINGS:
        raise Refused(f"{MAX_RECORDINGS} recordings run already.", "Stop one with ros2_record_stop.")
    recording = await opened(lambda: _open(robot, memory, wanted))
    memory.running[recording.id] = recording
    await recording.begin()
    return recording.state()


def recordings(memory: Memory) -> dict[str, Recording]:
    """The recordings of this server, by their ids."""
    running = list(memory.running.items())  # at once: threads ask too
    return {name: each for name, each in running if isinstance(each, Recording)}


async def status(memory: Memory, recording_id: str = "") -> RecordingStates:
    """How recordings stand; all of this server, or one."""
    chosen = [_find(memory, recording_id)] if recording_id else list(recordings(memory).values())
    return RecordingStates([each.state() for each in chosen])


async def stop(memory: Memory, recording_id: str) -> RecordingState:
    """Ends a recording and closes its files."""
    recording = _find(memory, recording_id)
    await recording.end()
    return recording.state()


def _checked(wanted: Wanted) -> Wanted:
    bounded("max_duration_sec", wanted.max_duration_s, 0.0, MAX_DURATION_S, "s")
    for name, value in (("max_bytes", wanted.max_bytes), ("split_bytes", wanted.split_bytes)):
        bounded(name, value, 0, 10**13, "bytes")
    return replace(wanted, topics=[names.absolute(topic) for topic in wanted.topics])


def _open(robot: Robot, memory: Memory, wanted: Wanted) -> Recording:
    from ros2_mcp.bags.recorder import Limits, Recorder
    from ros2_mcp.bags.writer import BagWriter, fresh_folder

    limits = Limits(wanted.max_duration_s, wanted.max_bytes)
    try:
        folder = fresh_folder(memory.record_dir, wanted.name)
        _require_room(folder, limits)
        recorder = Recorder(BagWriter(folder, folder.name, wanted.split_bytes), folder, limits)
    except OSError as error:
        raise _cannot_write(memory.record_dir, error) from error
    return Recording(robot, folder.name, folder, recorder, wanted)


def _require_room(folder: Path, limits: Limits) -> None:
    from ros2_mcp.bags.writer import free_bytes

    free = free_bytes(folder)
    if free < limits.free_floor_bytes:
        folder.rmdir()
        raise BadInput(
            f"The disk of {folder.parent} has {free} bytes free; {limits.free_floor_bytes} must stay free.",
            "Delete old recordings, or start the server with another --record-dir.",
        )


def _cannot_write(folder: Path, error: OSError) -> BadInput:
    return BadInput(
        f"{folder} cannot be written: {error.strerror or error}.", "Start the server with another --record-dir."
    )


def _find(memory: Memory, recording_id: str) -> Recording:
    known = recordings(memory)
    if recording_id not in known:
        raise NotFound(
            f"There is no recording {recording_id!r}.",
            names.did_you_mean(recording_id, list(known), "ros2_record_status shows them."),
        )
    return known[recording_id]


def _sum(one: Counts, other: Counts) -> Counts:
    lost = None if one.lost is None or other.lost is None else one.lost + other.lost
    return Counts(one.received + other.received, one.dropped + other.dropped, lost)
