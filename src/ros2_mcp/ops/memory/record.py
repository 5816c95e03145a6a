"""Record topics: bytes go from the robot to the disk without being decoded, and topics that appear later are added.

The black box is a recording like any other, which the server starts by itself, in a ring of files, with no database and
no other node.
"""

from __future__ import annotations

import json
import logging
import math
import shutil
import struct
from collections.abc import Generator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field, replace
from pathlib import Path
from time import monotonic
from typing import TYPE_CHECKING, Any, Literal

import anyio
from anyio import to_thread
from anyio.abc import TaskGroup

from ros2_mcp.bags.schema import schema_text
from ros2_mcp.bags.stored import StoredTopic
from ros2_mcp.guard.consent import Auditing
from ros2_mcp.guard.policy import bounded
from ros2_mcp.model import names
from ros2_mcp.model.commands import SERVER, Principal, Record
from ros2_mcp.model.errors import BadInput, BridgeLost, LinkError, Refused, RobotError
from ros2_mcp.model.graph import TopicRow
from ros2_mcp.model.qos import QoS
from ros2_mcp.model.samples import Counts, Sample
from ros2_mcp.model.text import counted, named
from ros2_mcp.model.times import Outage
from ros2_mcp.ops.memory.bag_store import BLACK_BOX, BagStore
from ros2_mcp.ops.results.results import HIDDEN, IF_ANY, SAID, iso_time
from ros2_mcp.robot import Listening, Robot
from ros2_mcp.robot.jobs import Job
from ros2_mcp.robot.session import Session

if TYPE_CHECKING:
    from ros2_mcp.bags.recorder import Recorder
    from ros2_mcp.settings import Settings

MAX_DURATION_S = 7 * 86_400.0
"""A week; most recordings end before, because of the disk space that must stay free."""
MAX_BYTES = 10**13
"""10 TB: more than the disk of any robot."""
LARGEST_BYTES = 32_000
"""Larger messages (pictures, clouds) would push all others out of the ring: their topics are recorded only if named."""
_TURN_S = 0.1
"""Seconds between two writes of the queued samples: rare enough to cost nothing, and a
crash loses no more than that."""
_SHORT_TURN_S, _MUCH_BYTES = 0.02, 2_000_000
"""The shorter interval after a turn with so many bytes: a raw camera at full HD sends 19 MB in a tenth of a second."""
_JOINED_POLL_S = 0.02
"""Seconds between two checks of whether the subscriptions have begun, which takes some milliseconds."""
_LOOK_S = 1.0
"""How often new topics are looked for, as the tool's description promises."""
_JOINED_S = 2.0
"""How long the start waits for the subscriptions of present topics; discovery takes up to that long."""
_LEFT_S = 3.0
"""How long the end waits for the last samples of subscriptions, which a busy bridge may delay."""
_WAITING_BYTES = 128_000_000
"""The most bytes that one topic may hold in memory while this server is busy: two bursts of
large pictures (see `QUEUE_BYTES`)."""
_TOLD = 3
"""The most topics with an error that the summary names in its one line; the list of topics has all."""
_MOST_NOTES = 20
"""The most notes: each topic may fail in its own way, and hundreds of notes are not read."""
CALLS = "/agent/calls"
"""The topic of a recording that has the lines of the audit, as JSON. No node publishes it."""
_TEXT = "std_msgs/msg/String"
_logger = logging.getLogger(__name__)


@dataclass(frozen=True, kw_only=True, slots=True)
class RecordRequest:
    """The settings of a recording; without topics and patterns, everything that is not hidden is recorded.

    A topic is dropped from the recording as soon as it has a message larger than `largest` bytes (0: never), unless it
    is latched.
    """

    topics: Sequence[str] = ()
    patterns: Sequence[str] = ()
    max_duration_s: float = 0.0
    max_bytes: int = 0
    split_bytes: int = 0
    name: str = ""
    largest: int = 0

    def chooses(self, topic: str) -> bool:
        """Return whether a topic of the graph is to be recorded."""
        if topic in self.topics:
            return True
        if names.is_hidden(topic):
            return False
        if not self.patterns:
            return not self.topics
        return any(names.matching([topic], pattern) for pattern in self.patterns)


@dataclass(frozen=True, slots=True)
class TopicCounts:
    """The counts of one topic of a recording.

    `written` messages are in the file; `dropped` were discarded because they could not be written fast enough, or this
    server was too busy; `lost` never arrived, as far as sequence numbers show (null if unknown; losses after the last
    message do not show). `other_types` are types of publishers that appeared later, and are not recorded.
    """

    topic_name: str
    topic_type: str
    written: int
    dropped: int
    lost: int | None
    error: str = ""
    other_types: Sequence[str] = ()

    def trouble(self) -> str:
        """Return a sentence that says why a topic is not recorded, or not completely; empty if it is recorded."""
        name = named(self.topic_name)
        if not self.error:
            others = ", ".join(map(named, self.other_types))
            return f"{name}: only {self.topic_type} is recorded, not {others}." if others else ""
        what = f"{name} is no longer recorded" if self.written else f"{name} is not recorded"
        return f"{what}: {self.error}"


@dataclass(frozen=True, kw_only=True, slots=True)
class RecordingState:
    """A recording. `bag` is its name for the tools that read bags; `state` is `recording`, `ended` or `failed`."""

    recording_id: str = field(metadata=SAID)
    state: Literal["recording", "ended", "failed"] = field(metadata=SAID)
    bag: str = field(metadata=SAID)
    path: str
    started_at: str = field(metadata=SAID)
    elapsed_s: float = field(metadata=SAID)
    bytes: int = field(metadata=SAID)
    messages: int = field(metadata=SAID)
    topics: Sequence[TopicCounts]
    reason: str = field(metadata={**IF_ANY, **SAID})
    notes: Sequence[str] = field(metadata=IF_ANY)
    why_dropped: str = field(default="", metadata=HIDDEN)

    def summary(self) -> str:
        """Return the result in one line."""
        lost = f", {self.why_dropped}" if self.why_dropped else ""
        troubles = [trouble for topic in self.topics if (trouble := topic.trouble())]
        recorded = sum(bool(topic.written or not topic.error) for topic in self.topics)
        more = [f"{counted(len(troubles) - _TOLD, 'more topic')} with an error."] if len(troubles) > _TOLD else []
        line = (
            f"{self.recording_id} {self.state} as bag {named(self.bag)}: {self.messages} messages of "
            f"{recorded} topics, {self.bytes} bytes{lost} in {self.elapsed_s:.1f} s since {self.started_at}."
        )
        reason = f"{self.reason.rstrip('.')}." if self.reason and troubles else self.reason
        return " ".join(filter(None, (line, reason, *troubles[:_TOLD], *more)))


@dataclass(frozen=True, slots=True)
class RecordingStates:
    """All running recordings, and the recordings that ended last."""

    recordings: Sequence[RecordingState]

    def summary(self) -> list[str]:
        """Return a line for each."""
        return [recording.summary() for recording in self.recordings] or ["Nothing has been recorded."]


@dataclass(slots=True)
class _Joined:
    """A topic that is being recorded. `former` are the counts of its former subscriptions.

    `lost` is the subscription that ended with its bridge, to be renewed; `must_renew`: the present subscription no
    longer fits the topic's publishers. `other_types` appeared later.
    """

    type: str
    publishers: int
    listening: Listening | None = None
    lost: Listening | None = None
    former: Counts = field(default_factory=Counts)
    error: str = ""
    must_renew: bool = False
    other_types: Sequence[str] = ()

    def counts(self) -> Counts:
        """Return the counts of messages, over all subscriptions so far."""
        return self.former + self.listening.counts if self.listening else self.former


class Recording(Job):
    """One recording in progress: it finds its topics, subscribes to them and passes their bytes to the recorder."""

    kind = "recording"
    most_kept = 100
    listed_by = "ros2_record_status"
    stopped_by = "ros2_record_stop"

    def __init__(self, robot: Robot, store: BagStore, request: RecordRequest, *, owner: Principal) -> None:
        super().__init__(owner=owner)
        self._robot = robot
        self._store = store
        self._request = request
        self.at_most_s = request.max_duration_s or math.inf
        self._recorder: Recorder | None = None
        self._folder: Path | None = None
        self._topics: dict[str, _Joined] = {}
        self._notes: list[str] = []
        self._told: Outage | None = None
        self._is_ending = False
        self._has_calls = False
        self._began_at = monotonic()
        self._started_ns = robot.now_ns()

    @property
    def about(self) -> str:
        """The bag's name."""
        return self._folder.name if self._folder else self._request.name

    async def run(self) -> None:
        """Record until a limit is reached or the recording is stopped. The files are closed in any case."""
        calls = ExitStack()
        try:
            # A thread cannot be cancelled: anyio waits for it, so that what it has opened is always closed again.
            self._folder, self._recorder = await to_thread.run_sync(self._open)
            recorder = self._recorder
            self._store.writes(self._folder, lambda: not recorder.ended, self._robot.now_ns)
            async with anyio.create_task_group() as topics:
                calls.enter_context(self._with_calls(recorder))
                await self._look(topics, recorder)
                # After its first answer the robot's clock is known, by which the messages are stamped.
                self._started_ns = self._robot.now_ns() - round((monotonic() - self._began_at) * 1e9)
                with anyio.move_on_after(_JOINED_S):
                    while any(not (joined.listening or joined.error) for joined in self._topics.values()):
                        await anyio.sleep(_JOINED_POLL_S)
                self.begun()
                look_at = monotonic() + _LOOK_S
                while not (self._is_ending or recorder.ended):
                    await anyio.sleep(_TURN_S)
                    if monotonic() >= look_at:
                        await self._look(topics, recorder)
                        look_at = monotonic() + _LOOK_S
                self._is_ending = True
                topics.cancel_scope.deadline = anyio.current_time() + _LEFT_S
        finally:
            self._is_ending = True
            calls.close()
            with anyio.CancelScope(shield=True):
                if self._recorder:
                    await to_thread.run_sync(self._recorder.stop, "stopped")

    @contextmanager
    def _with_calls(self, recorder: Recorder) -> Generator[None, None, None]:
        """While the context is open, also record the audit's lines on this server's commands,
        which may explain an incident.
        """
        auditing = self._robot.guard.audit
        log = auditing.log if isinstance(auditing, Auditing) else None
        if log is None or not self._request.chooses(CALLS) or self._is_forbidden(CALLS):
            yield
            return

        def record(_at_ns: int, entry: Mapping[str, Any]) -> None:
            at_ns = self._robot.now_ns()  # by the clock of the recorded messages
            if not self._has_calls:
                from ros2_mcp.bags.qos import qos_text  # as in `_describe`

                profiles = qos_text([QoS("reliable", "volatile", depth=1)])
                recorder.add_topic(
                    StoredTopic(CALLS, _TEXT, encoding="ros2msg", definition="string data\n", qos=profiles)
                )
                self._has_calls = True
            recorder.put(CALLS, [Sample(at_ns, at_ns, None, _text_message(json.dumps(entry, default=str)))])

        with log.listened(record):
            yield

    async def wind_down(self) -> None:
        """Make the subscriptions pass on their last samples."""
        self._is_ending = True

    def doing(self) -> str:
        """Name the number of topics and the folder."""
        return f"{counted(len(self._topics), 'topic')} into {self._folder.name}" if self._folder else ""

    def report(self) -> RecordingState:
        """Return the current state of the recording."""
        recorder, folder = self._recorder, self._folder
        written = dict(recorder.sink.counts) if recorder else {}
        discarded = recorder.dropped if recorder else {}
        has_ended = bool(recorder.ended) if recorder else not self.is_running
        has_failed = bool(self.failure or (recorder and recorder.failed))
        reason = str(self.failure) if self.failure else recorder.ended if recorder else "stopped"
        topics: list[TopicCounts] = []
        busy = 0
        for name, joined in sorted(self._topics.items()):
            counts = joined.counts()
            busy += counts.dropped
            dropped = counts.dropped + discarded.get(name, 0)
            row = TopicCounts(name, joined.type, written.get(name, 0), dropped, counts.lost, joined.error)
            topics.append(replace(row, other_types=joined.other_types))
        if CALLS in written:
            topics.append(TopicCounts(CALLS, _TEXT, written[CALLS], discarded.get(CALLS, 0), 0))
        absent = "no publisher yet; recording begins within a second after one appears."
        notes = [*self._notes, *(recorder.notes if recorder else ())]
        why_dropped = drops_in_words(busy, sum(discarded.values()), is_remote=self._robot.graph.is_remote)
        notes += [f"{why_dropped}."] if why_dropped else []
        notes += [f"{name}: {absent}" for name in self._request.topics if name not in self._topics and name != CALLS]
        return RecordingState(
            recording_id=self.id,
            state="recording" if not has_ended else "failed" if has_failed else "ended",
            bag=folder.name if folder else "",
            path=str(folder or ""),
            started_at=iso_time(self._started_ns),
            elapsed_s=round(recorder.elapsed_s, 3) if recorder else 0.0,
            bytes=recorder.sink.size if recorder else 0,
            messages=sum(written.values()),
            topics=topics,
            reason=reason if has_ended else "",
            notes=notes,
            why_dropped=why_dropped,
        )

    def _open(self) -> tuple[Path, Recorder]:
        # Imported with the first recording: mcap and YAML take a tenth of the time that all tools take to import.
        from ros2_mcp.bags.recorder import Limits, Recorder
        from ros2_mcp.bags.writer import BagWriter, fresh_folder

        request, record_dir = self._request, self._store.record_dir
        limits = Limits(request.max_duration_s, request.max_bytes)
        try:
            folder = fresh_folder(record_dir, request.name)
            free = shutil.disk_usage(folder).free
            if free < limits.free_floor_bytes:
                folder.rmdir()
                raise BadInput(
                    f"The disk of {record_dir} has {free} bytes free, but {limits.free_floor_bytes} must stay free.",
                    "Delete old recordings, or start the server with another --record-dir.",
                )
            return folder, Recorder(BagWriter(folder, folder.name, request.split_bytes), folder, limits)
        except OSError as error:
            raise BadInput(
                f"{record_dir} cannot be written: {error.strerror or error}.",
                "Start the server with another --record-dir.",
            ) from error

    async def _look(self, topics: TaskGroup, recorder: Recorder) -> None:
        """Begin to record chosen topics that are new, and renew subscriptions that no longer fit the publishers' QoS.

        Errors are noted: the next check may succeed, and the other topics continue to be recorded.
        """
        try:
            for row in await self._robot.graph.topics():
                if not row.publishers or self._is_ending or not self._request.chooses(row.name):
                    continue
                if row.name == CALLS:
                    self._note(f"{CALLS} records what this server does, not the topic of that name on the robot.")
                    continue
                joined = self._topics.get(row.name)
                if joined is None:
                    await self._join(row, topics, recorder)
                    continue
                if not joined.error and set(row.types) - {joined.type, *joined.other_types}:
                    joined.other_types = sorted({*joined.other_types, *await self._sent_types(row)} - {joined.type})
                if joined.publishers != row.publishers and joined.listening:
                    joined.publishers = row.publishers
                    joined.must_renew = not joined.listening.still_fits(await self._robot.graph.endpoints(row.name))
        except RobotError as error:
            self._note(str(error))

    async def _join(self, row: TopicRow, topics: TaskGroup, recorder: Recorder) -> None:
        """Begin to record a topic, if one type is published on it. Subscribers may expect another one."""
        if problem := self._is_forbidden(row.name):
            self._topics[row.name] = _Joined(row.types[0], row.publishers, error=problem)
            return
        if not (types := await self._sent_types(row)):
            return  # its publishers have left meanwhile
        joined = self._topics[row.name] = _Joined(types[0], row.publishers)
        if len(types) > 1:
            joined.error = f"It has several types: {', '.join(map(named, types))}."
        else:
            topics.start_soon(self._record, row.name, joined, recorder)

    async def _sent_types(self, row: TopicRow) -> Sequence[str]:
        """Return the types that are published on a topic."""
        if len(row.types) == 1:
            return row.types
        return sorted({one.type for one in (await self._robot.graph.endpoints(row.name)).publishers})

    def _is_forbidden(self, topic: str) -> str:
        """Return why the policy forbids recording this topic, also as one of all topics; empty if it does not."""
        return self._robot.policy.forbids_recording(topic) if self.owner != SERVER else ""

    async def _record(self, name: str, joined: _Joined, recorder: Recorder) -> None:
        """Record one topic until the recording ends, with a new subscription after each loss of the bridge."""
        while not self._is_ending:
            try:
                await self._record_once(name, joined, recorder)
            except LinkError as error:
                if not self._robot.graph.is_remote:
                    self._note(f"{name}: {error}")
                elif isinstance(error, BridgeLost):  # all topics get this error at once
                    self._note(str(error))
                await anyio.sleep(_TURN_S)
            except RobotError as error:
                joined.error = str(error)
                return
            except Exception as error:  # whatever the error, the other topics continue
                joined.error = f"It cannot be recorded: {error}"
                _logger.exception("%s cannot be recorded", name)
                return

    async def _record_once(self, name: str, joined: _Joined, recorder: Recorder) -> None:
        """Record one subscription, until the recording ends, it has to be renewed, or
        the bridge is lost (`LinkError`).
        """
        joined.must_renew = False
        if joined.lost is None:
            subscription = self._robot.listen(name, joined.type, max_bytes=_WAITING_BYTES)
        else:
            subscription = self._robot.listen_again(joined.lost, max_bytes=_WAITING_BYTES)
        async with subscription as listening:
            if joined.lost is None:
                self._describe(listening, recorder)
            else:
                self._note_outage()
            joined.listening, joined.lost = listening, None
            is_latched = listening.choice.qos.durability == "transient_local"
            largest = 0 if is_latched else self._request.largest
            try:
                while not (self._is_ending or joined.must_renew or recorder.ended):
                    samples = await listening.take(0.0)
                    sizes = [len(sample.data) for sample in samples]
                    if largest and (size := max(sizes, default=0)) > largest:
                        what = f"Not recorded: it has messages of {size} bytes, more than {largest}."
                        raise Refused(what, "Name the topic to record it.")
                    recorder.put(name, samples)
                    await anyio.sleep(_SHORT_TURN_S if sum(sizes) > _MUCH_BYTES else _TURN_S)
            except LinkError:
                joined.former, joined.listening, joined.lost = joined.counts(), None, listening
                raise
        joined.former, joined.listening = joined.counts(), None  # before a call that may raise: the counts are not lost
        recorder.put(name, await listening.take(0.0))
        if recorder.ended:
            self._is_ending = True

    def _note_outage(self) -> None:
        """Note the gap that the recording has because the robot was out of reach."""
        for outage in self._robot.graph.outages[-1:]:
            if outage is self._told:
                return  # noted for another topic
            self._told = outage
            began_ns = self._robot.now_ns() - round((monotonic() - outage.began_at) * 1e9)
            self._note(
                f"The robot was out of reach for {outage.lasted_s:.1f} s from {iso_time(began_ns)} on; nothing was "
                f"recorded then."
            )

    def _describe(self, listening: Listening, recorder: Recorder) -> None:
        """Give the recorder the description of a topic for the bag: type, definition, QoS and hash."""
        from ros2_mcp.bags.qos import qos_text  # imports rosbags: 55 ms that the start of the server need not take

        text = schema_text(self._robot.values.definitions.interface(listening.type))
        profiles = qos_text([publisher.qos for publisher in listening.publishers])
        topic = StoredTopic(listening.topic, listening.type, encoding="ros2msg", definition=text, qos=profiles)
        recorder.add_topic(topic, next((p.hash for p in listening.publishers if p.hash), ""))

    def _note(self, text: str) -> None:
        if text not in self._notes and len(self._notes) < _MOST_NOTES:
            self._notes.append(text)


def _text_message(text: str) -> bytes:
    """Return a `std_msgs/msg/String` as CDR: the encapsulation, the length with the final zero, the text."""
    data = text.encode() + b"\0"
    return b"\0\1\0\0" + struct.pack("<I", len(data)) + data


def drops_in_words(busy: int, slow: int, *, is_remote: bool = False) -> str:
    """Return a phrase with the numbers of received messages that are not in the file,
    and why; empty if there are none.
    """
    who = "the link was too slow, or this server too busy" if is_remote else "this server was too busy"
    reasons = ((busy, f"dropped because {who}"), (slow, "dropped because they were not written fast enough"))
    return ", ".join(f"{count} {why}" for count, why in reasons if count)


class BlackBox(Recording):
    """The recording that the server starts by itself, in a ring of files: the oldest files are deleted to make room for
    new files.
    """

    needs_no_id = False

    def __init__(self, robot: Robot, store: BagStore, settings: Settings) -> None:
        topics = [names.absolute(topic) for topic in settings.black_box or ()]
        request = RecordRequest(topics=topics, largest=0 if topics else LARGEST_BYTES)
        super().__init__(robot, store, request, owner=SERVER)
        self._folder = store.record_dir / BLACK_BOX
        self._settings = settings

    def _open(self) -> tuple[Path, Recorder]:
        from ros2_mcp.bags.recorder import Recorder
        from ros2_mcp.bags.ring import RingWriter

        folder, settings = self._store.record_dir / BLACK_BOX, self._settings
        ring = RingWriter(folder, settings.black_box_bytes, settings.black_box_hours * 3600.0)
        return folder, Recorder(ring, folder)


async def start(robot: Robot, session: Session, store: BagStore, request: RecordRequest) -> RecordingState:
    """Start a recording. It continues until a limit is reached, it is stopped, or the server ends.

    Raises:
        Refused: if this server is read-only, or too many recordings run.
        BadInput: if the folder cannot be written or the disk is nearly full.
        BadValue: if a limit is out of range.
    """
    bounded("max_duration_s", request.max_duration_s, 0.0, MAX_DURATION_S, "s")
    bounded("max_bytes", request.max_bytes, 0, MAX_BYTES, "bytes")
    bounded("split_bytes", request.split_bytes, 0, MAX_BYTES, "bytes")
    request = replace(request, topics=[names.absolute(topic) for topic in request.topics])
    topics, patterns = request.topics, request.patterns
    command = Record(principal=session.principal, name=request.name, topics=topics, patterns=patterns)
    await robot.do(command, session)
    recording = Recording(robot, store, request, owner=session.principal)
    await robot.jobs.start(recording)
    return recording.report()


async def keep_black_box(robot: Robot, store: BagStore, settings: Settings) -> None:
    """Start the black box, if the settings ask for it. Errors are logged."""
    if settings.black_box is None or settings.read_only:
        return
    try:
        black_box = BlackBox(robot, store, settings)
        await robot.do(Record(principal=SERVER, name=BLACK_BOX, topics=settings.black_box))
        await robot.jobs.start(black_box)
    except (RobotError, OSError) as error:
        _logger.warning("the black box keeps nothing: %s", error)
    except Exception:  # this runs in the server's task group: an exception would end the server
        _logger.exception("the black box keeps nothing")


async def status(robot: Robot, recording_id: str = "") -> RecordingStates:
    """Return the state of recordings: the recording with that id, or all running recordings and the last that ended."""
    return RecordingStates([recording.report() for recording in robot.jobs.chosen(Recording, recording_id)])


async def stop(robot: Robot, recording_id: str = "") -> RecordingState:
    """Stop a recording and close its files. Without an id, stop the only one that runs, never the black box.

    If none runs, return the one that ended last (for example by its limits), with what was recorded and why it ended.

    Raises:
        NotFound: if there is no recording with that id, or there has been none.
        BadInput: if several run and no id is given.
    """
    return (await robot.jobs.stop(Recording, recording_id)).report()
