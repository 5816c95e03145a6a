"""Recording topics: bytes go from the robot to the disk, never decoded, and topics that appear later join in.

The black box is a recording like any other, which the server begins by itself, in a ring of files, with no database
and no other node.
"""

from __future__ import annotations

import logging
import shutil
import time
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from time import monotonic
from typing import TYPE_CHECKING

import anyio
from anyio import to_thread
from anyio.abc import TaskGroup

from ros2_mcp.bags.schema import schema_text
from ros2_mcp.bags.stored import StoredTopic
from ros2_mcp.guard.policy import bounded
from ros2_mcp.model import names
from ros2_mcp.model.commands import SERVER, Principal, Record
from ros2_mcp.model.errors import BadInput, LinkError, Refused, RobotError
from ros2_mcp.model.samples import Counts
from ros2_mcp.ops.memory.bag_store import BLACK_BOX, BagStore
from ros2_mcp.ops.results import iso_time
from ros2_mcp.robot import Listening, Robot
from ros2_mcp.robot.jobs import Job

if TYPE_CHECKING:
    from ros2_mcp.bags.recorder import Recorder
    from ros2_mcp.settings import Settings

MAX_DURATION_S = 7 * 86_400.0
"""A week; the disk's floor ends most recordings before."""
MAX_BYTES = 10**13
"""10 TB: more than the disk of any robot."""
LARGEST_BYTES = 32_000
"""Larger messages (pictures, clouds) would push all others out of the ring: their topics are kept only by name."""
_TURN_S = 0.1
"""How often waiting samples are handed to the disk: rarely enough to cost nothing, and no more is lost at a crash."""
_JOINED_POLL_S = 0.02
"""A subscription takes some milliseconds; this is by how much a start is longer than it needs to be."""
_LOOK_S = 1.0
"""How often new topics are looked for, as the tool's description promises."""
_JOINED_S = 2.0
"""How long a start waits for the subscriptions of topics that are there; discovery takes up to that long."""
_LEFT_S = 3.0
"""How long an end waits for the last samples of subscriptions, which a busy bridge may withhold."""
_WAITING_BYTES = 64_000_000
"""What one topic may hold in memory while this server is busy: two seconds of a camera's raw pictures."""
_MOST_NOTES = 20
"""Each topic may fail in its own way, and a result with hundreds of notes is read by nobody."""
_logger = logging.getLogger(__name__)


@dataclass(frozen=True, kw_only=True, slots=True)
class RecordRequest:
    """What to record; without topics and patterns, everything that is not hidden.

    A topic is left out as soon as it has a message larger than `largest` bytes (0: never), unless it is latched.
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


@dataclass(frozen=True, kw_only=True, slots=True)
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
    """The recordings that run, and the last ones that ended."""

    recordings: Sequence[RecordingState]

    def summary(self) -> list[str]:
        """A line for each."""
        return [recording.summary() for recording in self.recordings] or ["Nothing has been recorded."]


@dataclass(slots=True)
class _Joined:
    """A topic that is being recorded. `former` are the counts of the subscriptions that it has had before.

    `lost` is the subscription that ended with its bridge, to be made anew; `must_renew` says that the one that runs no
    longer fits the topic's publishers.
    """

    type: str
    publishers: int
    listening: Listening | None = None
    lost: Listening | None = None
    former: Counts = field(default_factory=Counts)
    error: str = ""
    must_renew: bool = False

    def counts(self) -> Counts:
        """What became of the messages, over all subscriptions there were."""
        return self.former + self.listening.counts if self.listening else self.former


class Recording(Job):
    """One recording under way: finds its topics, subscribes to them and hands their bytes to the recorder."""

    kind = "recording"
    most_kept = 100
    listed_by = "ros2_record_status"
    stopped_by = "ros2_record_stop"

    def __init__(
        self, robot: Robot, store: BagStore, request: RecordRequest, *, owner: Principal | None = None
    ) -> None:
        super().__init__(owner=owner or robot.principal)
        self._robot = robot
        self._store = store
        self._request = request
        self._recorder: Recorder | None = None
        self._folder: Path | None = None
        self._topics: dict[str, _Joined] = {}
        self._notes: list[str] = []
        self._is_ending = False
        self._started_ns = time.time_ns()

    async def run(self) -> None:
        """Records until a limit is reached or it is told to end; however it ends, the files are closed."""
        try:
            # A thread cannot be cancelled: anyio waits for it, so that what it has opened is always closed again.
            self._folder, self._recorder = await to_thread.run_sync(self._open)
            recorder = self._recorder
            self._store.writes(self._folder, lambda: not recorder.ended)
            async with anyio.create_task_group() as topics:
                await self._look(topics, recorder)
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
            with anyio.CancelScope(shield=True):
                if self._recorder:
                    await to_thread.run_sync(self._recorder.stop, "stopped")

    async def wind_down(self) -> None:
        """Lets the subscriptions hand over what they still have."""
        self._is_ending = True

    def report(self) -> RecordingState:
        """How it stands."""
        recorder, folder = self._recorder, self._folder
        written = dict(recorder.sink.counts) if recorder else {}
        discarded = recorder.dropped if recorder else {}
        has_ended = bool(recorder.ended) if recorder else not self.is_running
        has_failed = bool(self.failure or (recorder and recorder.failed))
        reason = str(self.failure) if self.failure else recorder.ended if recorder else "stopped"
        topics: list[TopicCounts] = []
        for name, joined in sorted(self._topics.items()):
            counts = joined.counts()
            dropped = counts.dropped + discarded.get(name, 0)
            topics.append(TopicCounts(name, joined.type, written.get(name, 0), dropped, counts.lost, joined.error))
        absent = "nobody has published it so far; it joins within a second after somebody does."
        notes = [*self._notes, *(recorder.notes if recorder else ())]
        notes += [f"{name}: {absent}" for name in self._request.topics if name not in self._topics]
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
                    f"The disk of {record_dir} has {free} bytes free; {limits.free_floor_bytes} must stay free.",
                    "Delete old recordings, or start the server with another --record-dir.",
                )
            return folder, Recorder(BagWriter(folder, folder.name, request.split_bytes), folder, limits)
        except OSError as error:
            raise BadInput(
                f"{record_dir} cannot be written: {error.strerror or error}.",
                "Start the server with another --record-dir.",
            ) from error

    async def _look(self, topics: TaskGroup, recorder: Recorder) -> None:
        """Joins the chosen topics that are new, and renews subscriptions that no longer fit the publishers' QoS.

        What goes wrong is noted: the next look may succeed, and the topics that have been joined go on.
        """
        try:
            for row in await self._robot.graph.topics():
                if not row.publishers or self._is_ending or not self._request.chooses(row.name):
                    continue
                joined = self._topics.get(row.name)
                if joined is None:
                    joined = self._topics[row.name] = _Joined(row.types[0], row.publishers)
                    if len(row.types) > 1:
                        joined.error = f"It has several types: {', '.join(row.types)}."
                    else:
                        topics.start_soon(self._record, row.name, joined, recorder)
                elif joined.publishers != row.publishers and joined.listening:
                    joined.publishers = row.publishers
                    joined.must_renew = not joined.listening.still_fits(await self._robot.graph.endpoints(row.name))
        except RobotError as error:
            self._note(str(error))

    async def _record(self, name: str, joined: _Joined, recorder: Recorder) -> None:
        """Until the recording ends: subscription after subscription, should the bridge be lost meanwhile."""
        while not self._is_ending:
            try:
                await self._record_once(name, joined, recorder)
            except LinkError as error:
                self._note(f"{name}: {error}")
                await anyio.sleep(_TURN_S)
            except RobotError as error:
                joined.error = str(error)
                return
            except Exception as error:  # whatever it is, the other topics are recorded on
                joined.error = f"It cannot be recorded: {error}"
                _logger.exception("%s cannot be recorded", name)
                return

    async def _record_once(self, name: str, joined: _Joined, recorder: Recorder) -> None:
        """One subscription, until the recording ends, it has to be renewed, or the bridge is lost (`LinkError`)."""
        joined.must_renew = False
        if joined.lost is None:
            subscription = self._robot.listen(name, joined.type, max_bytes=_WAITING_BYTES)
        else:
            subscription = self._robot.listen_again(joined.lost, max_bytes=_WAITING_BYTES)
        async with subscription as listening:
            if joined.lost is None:
                self._describe(listening, recorder)
            joined.listening, joined.lost = listening, None
            is_latched = listening.choice.qos.durability == "transient_local"
            largest = 0 if is_latched else self._request.largest
            try:
                while not (self._is_ending or joined.must_renew or recorder.ended):
                    samples = await listening.take(0.0)
                    size = max((len(sample.data) for sample in samples), default=0)
                    if largest and size > largest:
                        what = f"Left out: it has messages of {size} bytes, more than {largest}."
                        raise Refused(what, "Name it to have it.")
                    recorder.put(name, samples)
                    await anyio.sleep(_TURN_S)
            except LinkError:
                joined.former, joined.listening, joined.lost = joined.counts(), None, listening
                raise
        joined.former, joined.listening = joined.counts(), None  # before what may raise: the counts are not lost
        recorder.put(name, await listening.take(0.0))
        if recorder.ended:
            self._is_ending = True

    def _describe(self, listening: Listening, recorder: Recorder) -> None:
        """Tells the recorder what the bag has to say of a topic: type, definition, QoS and hash."""
        from ros2_mcp.bags.qos import qos_text  # imports rosbags: 55 ms that the start of the server need not take

        text = schema_text(self._robot.values.definitions.interface(listening.type))
        profiles = qos_text([publisher.qos for publisher in listening.publishers])
        topic = StoredTopic(listening.topic, listening.type, encoding="ros2msg", definition=text, qos=profiles)
        recorder.add_topic(topic, next((p.hash for p in listening.publishers if p.hash), ""))

    def _note(self, text: str) -> None:
        if text not in self._notes and len(self._notes) < _MOST_NOTES:
            self._notes.append(text)


class BlackBox(Recording):
    """The recording that the server begins by itself, in a ring of files: the oldest make room for new ones."""

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


async def start(robot: Robot, store: BagStore, request: RecordRequest) -> RecordingState:
    """Begins to record; it goes on until a limit is reached, it is stopped, or the server ends.

    Raises:
        Refused: if this server is read-only, or too many recordings run.
        BadInput: if the folder cannot be written or the disk is nearly full.
        BadValue: if a limit is out of range.
    """
    bounded("max_duration_sec", request.max_duration_s, 0.0, MAX_DURATION_S, "s")
    bounded("max_bytes", request.max_bytes, 0, MAX_BYTES, "bytes")
    bounded("split_bytes", request.split_bytes, 0, MAX_BYTES, "bytes")
    request = replace(request, topics=[names.absolute(topic) for topic in request.topics])
    await robot.do(Record(principal=robot.principal, name=request.name, topics=request.topics))
    recording = Recording(robot, store, request)
    await robot.jobs.start(recording)
    return recording.report()


async def keep_black_box(robot: Robot, store: BagStore, settings: Settings) -> None:
    """Begins to keep the topics of the settings, if they name some; what goes wrong is logged."""
    if settings.black_box is None or settings.read_only:
        return
    try:
        black_box = BlackBox(robot, store, settings)
        await robot.do(Record(principal=SERVER, name=BLACK_BOX, topics=settings.black_box))
        await robot.jobs.start(black_box)
    except (RobotError, OSError) as error:
        _logger.warning("the black box keeps nothing: %s", error)
    except Exception:  # this runs in the server's task group: what it lets out would end the server
        _logger.exception("the black box keeps nothing")


async def status(robot: Robot, recording_id: str = "") -> RecordingStates:
    """How recordings stand: the one of that id, or all that run and the last that ended."""
    return RecordingStates([recording.report() for recording in robot.jobs.chosen(Recording, recording_id)])


async def stop(robot: Robot, recording_id: str) -> RecordingState:
    """Ends a recording and closes its files."""
    return (await robot.jobs.stop(Recording, recording_id)).report()
