"""Bags: which there are, what is in them, and their messages."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import islice
from typing import TYPE_CHECKING, Any

from ros2_mcp.guard.policy import bounded
from ros2_mcp.model import names
from ros2_mcp.model.errors import BadData, NotFound, UnknownInterface
from ros2_mcp.model.interfaces import DefinitionText
from ros2_mcp.model.samples import Sample
from ros2_mcp.ops.memory import Memory
from ros2_mcp.ops.moments import span_of
from ros2_mcp.ops.reading import View
from ros2_mcp.ops.recording import recordings
from ros2_mcp.ops.results import exact_time, iso_time
from ros2_mcp.robot import Robot

if TYPE_CHECKING:
    from ros2_mcp.bags.bag import Bag
    from ros2_mcp.bags.stored import Span, StoredTopic
    from ros2_mcp.codec.cdr import Codec

MAX_MESSAGES = 10_000
_MAX_BYTES = 64_000_000
_TO_DISK_NS = 1_000_000_000
_UNFINISHED = ("the recording was not closed.", "the end of the file is missing.")


@dataclass(frozen=True, slots=True)
class BagEntry:
    """A bag that can be read; `modified_at` is when its newest file was written."""

    bag: str
    bytes: int
    modified_at: str


@dataclass(frozen=True, slots=True)
class BagList:
    """The bags below the folder that this server may read."""

    bags: Sequence[BagEntry]
    total: int
    folder: str

    def summary(self) -> str:
        """One line."""
        return f"{len(self.bags)} of {self.total} bags in {self.folder}."


@dataclass(frozen=True, slots=True)
class BagTopic:
    """A topic of a bag; `has_definition` tells whether the bag itself says what its bytes mean.

    `messages` counts those in all files; a black box has the last latched message of a topic in each of them.
    """

    topic_name: str
    topic_type: str
    messages: int
    has_definition: bool


@dataclass(frozen=True, slots=True)
class BagInfo:
    """What is in a bag; `problems` say what is damaged or missing."""

    bag: str
    start: str
    end: str
    duration_s: float
    messages: int
    bytes: int
    topics: Sequence[BagTopic]
    problems: Sequence[str]

    def summary(self) -> str:
        """One line, and one for each problem."""
        line = f"{self.bag}: {self.messages} messages of {len(self.topics)} topics in {self.duration_s:.3f} s."
        return "\n".join([line, *self.problems])


@dataclass(frozen=True, slots=True)
class BagMessages:
    """Messages of one topic of a bag. `received_at` are the recorder's times; `truncated` names summarised paths."""

    bag: str
    topic_name: str
    topic_type: str
    messages: Sequence[dict[str, Any]]
    received_at: Sequence[str]
    count: int
    truncated: Sequence[str]
    problems: Sequence[str]
    note: str

    def summary(self) -> str:
        """One line, and one for each problem."""
        return "\n".join(
            [f"{self.bag} {self.topic_name}: {self.count} message(s). {self.note}".rstrip(), *self.problems]
        )


@dataclass(frozen=True, slots=True)
class Asked:
    """Which messages of a bag: the first ones from `start` on where that is given, else the last ones before `end`."""

    bag: str
    topic: str
    start: str = ""
    end: str = ""
    limit: int = 20


async def list_bags(memory: Memory, pattern: str = "", limit: int = 200) -> BagList:
    """The bags whose names match the pattern, the newest first."""
    return await asyncio.to_thread(_list, memory, pattern, limit)


async def info(memory: Memory, bag: str) -> BagInfo:
    """What is in a bag.

    Raises:
        NotFound: if there is no such bag.
        BadData: if nothing of it can be read.
    """
    return await asyncio.to_thread(_info, memory, bag)


async def read(robot: Robot, memory: Memory, asked: Asked, view: View) -> BagMessages:
    """Messages of one topic of a bag.

    Raises:
        NotFound: if there is no such bag or topic.
        UnknownInterface: if nobody knows the type's definition.
        BadValue: if a limit or a moment is out of range, or a field is not in the type.
    """
    bounded("limit", asked.limit, 1, MAX_MESSAGES, "messages")
    bounded("every_n", view.every_n, 1, 1_000_000, "messages")
    topic = await asyncio.to_thread(_topic, memory, asked.bag, asked.topic)
    codec = codec_of(await definitions_of(topic, robot))
    return await asyncio.to_thread(_read, memory, asked, view, topic, codec)


async def definitions_of(topic: StoredTopic, robot: Robot | None) -> dict[str, DefinitionText]:
    """What a topic's bytes mean: as the bag itself says, else as ROS defines it, else as the robot knows it.

    Raises:
        UnknownInterface: if nobody knows.
    """
    from ros2_mcp.bags.schema import definitions_in, schema_text

    found = definitions_in(topic.type, topic.encoding, topic.definition)
    found = found or await asyncio.to_thread(_common_definitions, topic.type)
    if found:
        return found
    if robot is None:
        raise UnknownInterface(f"The bag has no definition of {topic.type}.", "It was recorded without.")
    await robot.values.learn(topic.type)
    return definitions_in(topic.type, "ros2msg", schema_text(robot.values.definitions.interface(topic.type)))


def find_topic(bag: Bag, name: str) -> StoredTopic:
    """A topic of a bag; raises `NotFound` with the nearest name."""
    full = names.absolute(name)
    if full not in bag.topics:
        known = list(bag.topics)
        hint = names.did_you_mean(full, known, f"It has {', '.join(sorted(known)[:20])}.")
        raise NotFound(f"{bag.path.name} has no topic {full}.", hint)
    return bag.topics[full]


def span_in(memory: Memory, bag: Bag, start: str, end: str) -> Span:
    """The time between two moments of a bag."""
    return span_of(start, end, *times_of(memory, bag))


def times_of(memory: Memory, bag: Bag) -> tuple[int, int]:
    """Unix times in nanoseconds of a bag's beginning and end: its last message, or now while it is being recorded.

    As messages are on their way to the disk for up to a second, now is a second ago where there is no later one.
    """
    first_ns, last_ns = bag.times or (0, 0)
    if bag.times and _is_growing(memory, bag):
        last_ns = max(last_ns, time.time_ns() - _TO_DISK_NS)
    return first_ns, last_ns


def _is_growing(memory: Memory, bag: Bag) -> bool:
    folders = [each.folder.resolve() for each in recordings(memory).values() if each.is_running]
    return any(bag.path.resolve().is_relative_to(folder) for folder in folders)


def _problems(memory: Memory, bag: Bag) -> Sequence[str]:
    """What is damaged or missing; that the end is not written yet is no damage."""
    if not _is_growing(memory, bag):
        return bag.problems
    return ["It is still being recorded.", *(each for each in bag.problems if not each.endswith(_UNFINISHED))]


def codec_of(definitions: Mapping[str, DefinitionText]) -> Codec:
    """Reads messages of these definitions."""
    from ros2_mcp.codec.cdr import Codec
    from ros2_mcp.codec.definitions import Definitions

    known = Definitions()
    known.add(definitions)
    return Codec(known)


def _common_definitions(type_name: str) -> dict[str, DefinitionText]:
    """Of the packages that every ROS 2 has, as the newest distribution defines them; for bags that have none."""
    from rosbags.typesys import Stores, TypesysError, get_typestore

    from ros2_mcp.bags.schema import definitions_in

    store = get_typestore(Stores.LATEST)
    try:
        return definitions_in(type_name, "ros2msg", store.generate_msgdef(type_name, ros_version=2)[0])
    except (TypesysError, KeyError):
        return {}


def _list(memory: Memory, pattern: str, limit: int) -> BagList:
    found = memory.bag_names()
    chosen = [_entry(name, found[name]) for name in names.matching(found, pattern)]
    chosen.sort(key=lambda entry: entry.modified_at, reverse=True)
    return BagList(chosen[:limit], len(found), str(memory.bag_dir))


def _entry(name: str, path: Any) -> BagEntry:
    files = [path] if path.is_file() else [each for each in path.iterdir() if each.is_file()]
    facts = [each.stat() for each in files]
    return BagEntry(name, sum(f.st_size for f in facts), iso_time(max(f.st_mtime_ns for f in facts)))


def _info(memory: Memory, name: str) -> BagInfo:
    with memory.reading(name) as bag:
        counts = bag.counts()
        first_ns, last_ns = bag.times or (0, 0)
        topics = [
            BagTopic(topic.name, topic.type, counts.get(topic.name, 0), bool(topic.definition))
            for topic in sorted(bag.topics.values(), key=lambda topic: topic.name)
        ]
        return BagInfo(
            name,
            iso_time(first_ns) if bag.times else "",
            iso_time(last_ns) if bag.times else "",
            (last_ns - first_ns) / 1e9,
            sum(counts.values()),
            bag.size,
            topics,
            _problems(memory, bag),
        )


def _topic(memory: Memory, bag_name: str, name: str) -> StoredTopic:
    with memory.reading(bag_name) as bag:
        return find_topic(bag, name)


def _read(memory: Memory, asked: Asked, view: View, topic: StoredTopic, codec: Codec) -> BagMessages:
    with memory.reading(asked.bag) as bag:
        span = replace(span_in(memory, bag, asked.start, asked.end), topics=(topic.name,))
        backwards = not asked.start.strip()
        samples = (sample for _, sample in bag.messages(span, newest_first=backwards))
        chosen, beyond = taken(islice(samples, 0, None, view.every_n), asked.limit)
        problems = _problems(memory, bag)
        first_ns, last_ns = times_of(memory, bag)
    if backwards:
        chosen.reverse()
    shown, rendered, bad = rendered_within(topic.type, codec, chosen, view)
    notes: list[str] = []
    if beyond and backwards:
        notes.append(f"There are earlier ones too: for those, give end {exact_time(chosen[0].received_ns - 1)}.")
    elif beyond:
        notes.append(f"There are later ones too: for those, give start {exact_time(beyond.received_ns)}.")
    if len(shown) + bad < len(chosen):
        notes.append(f"{len(chosen) - len(shown) - bad} more do not fit: choose fields, or every_n.")
    if bad:
        notes.append(f"{bad} message(s) are not what their type says and are left out.")
    if not chosen:
        notes.append(f"None in that time; the bag goes from {iso_time(first_ns)} to {iso_time(last_ns)}.")
    return BagMessages(
        asked.bag,
        topic.name,
        topic.type,
        [each.value for each in rendered],
        [iso_time(sample.received_ns) for sample in shown],
        len(shown),
        sorted({path for each in rendered for path in each.truncated}),
        problems,
        " ".join(notes),
    )


def taken(samples: Iterable[Sample], most: int, max_bytes: int = _MAX_BYTES) -> tuple[list[Sample], Sample | None]:
    """The first ones, at least one, within both bounds; and the next one, if there are more."""
    found: list[Sample] = []
    size = 0
    for sample in samples:
        size += len(sample.data)
        if len(found) == most or (found and size > max_bytes):
            return found, sample
        found.append(sample)
    return found, None


def rendered_within(
    type_name: str, codec: Codec, samples: Sequence[Sample], view: View
) -> tuple[list[Sample], list[Any], int]:
    """As many messages as fit, evenly spread; and how many of those looked at could not be decoded."""
    from ros2_mcp.codec.render import RenderOptions, render
    from ros2_mcp.codec.select import parse_fields
    from ros2_mcp.ops.reading import spread

    if view.fields:
        parse_fields(codec.definitions, type_name, view.fields)

    def rendered(sample: Sample, max_bytes: int) -> Any:
        options = RenderOptions(max_array=view.max_array, max_bytes=max_bytes, fields=tuple(view.fields) or None)
        try:
            message = codec.decode(type_name, sample.data)
        except BadData:
            return None
        return render(codec.definitions, type_name, message, options=options)

    last = len(samples)
    newest = None
    while last and newest is None:
        last -= 1
        newest = rendered(samples[last], view.max_bytes)
    if newest is None:
        return [], [], len(samples)
    chosen = spread(samples[: last + 1], max(view.max_bytes // (newest.bytes + 60), 1))
    share = max(view.max_bytes // len(chosen), 500)
    results = [(sample, rendered(sample, share)) for sample in chosen]
    readable = [(sample, result) for sample, result in results if result is not None]
    bad = len(samples) - last - 1 + len(chosen) - len(readable)
    return [sample for sample, _ in readable], [result for _, result in readable], bad
