"""Bags: list them, and read their contents and messages."""

from __future__ import annotations

import asyncio
from collections.abc import Sequence
from dataclasses import dataclass, field
from time import monotonic
from typing import TYPE_CHECKING, Any

from ros2_mcp.guard.policy import bounded
from ros2_mcp.model import names
from ros2_mcp.model.meanings import Meaning
from ros2_mcp.model.text import counted, counted_of, named
from ros2_mcp.model.times import recorded_time
from ros2_mcp.model.values import summarised
from ros2_mcp.ops.memory.bag_store import BagStore
from ros2_mcp.ops.results.results import IF_ANY, ON_REQUEST, SAID, beside, iso_time
from ros2_mcp.ops.sources.bag import has_definition, open_bag
from ros2_mcp.ops.sources.selection import Selection, fit, message_times
from ros2_mcp.ops.space.meaning import meaning_of_newest
from ros2_mcp.ops.topics.subscribe import collect
from ros2_mcp.robot import Robot

if TYPE_CHECKING:
    from ros2_mcp.bags.bag import Bag

_CHECK_S = 2.0
"""How long a bag is checked for damage: some 150 MB of compressed pictures, or half a million small messages (measured
on a busy machine). A request for the contents of a bag should not take longer; reading the messages reports damage,
too."""
_CHECK_TURN_S = 0.2
"""How long one turn of the check lasts, in which no other thread can read the bag."""
MAX_MESSAGES = 10_000
"""The most messages of one call: more cannot be shown in any result."""


@dataclass(frozen=True, slots=True)
class BagEntry:
    """A bag that can be read; `modified_at` is when its newest file was written."""

    bag: str
    bytes: int
    modified_at: str


@dataclass(frozen=True, slots=True)
class BagList:
    """The bags in the folder that this server may read; `note` names recordings stored elsewhere."""

    bags: Sequence[BagEntry]
    total: int = field(metadata=SAID)
    folder: str = field(metadata=SAID)
    note: str = field(default="", metadata={**IF_ANY, **SAID})

    def summary(self) -> str:
        """Return the result in one line."""
        return f"{counted_of(len(self.bags), self.total, 'bag')} in {self.folder}. {self.note}".rstrip()


@dataclass(frozen=True, slots=True)
class BagTopic:
    """A topic of a bag; `has_definition`: the bag itself contains a usable definition of the type.

    Types that are not ROS 2 messages begin with their encoding, such as `json:app.Log` or `protobuf:foxglove.Grid`.
    `messages` is the number in all files; a black box repeats the last latched messages of a topic in each of its
    files.
    """

    topic_name: str
    topic_type: str
    messages: int
    has_definition: bool


@dataclass(frozen=True, slots=True)
class BagInfo:
    """The contents of a bag; `problems` lists what is damaged or missing. `start` and `end` may be empty.

    `note` says whether the whole bag was checked for damage.
    """

    bag: str = field(metadata=SAID)
    start: str = field(metadata=SAID)
    end: str = field(metadata=SAID)
    duration_s: float = field(metadata=SAID)
    messages: int = field(metadata=SAID)
    bytes: int
    topics: Sequence[BagTopic]
    problems: Sequence[str] = field(metadata={**IF_ANY, **SAID})
    note: str = field(metadata=IF_ANY)

    def summary(self) -> list[str]:
        """Return one line, and one line for each problem."""
        line = f"{named(self.bag)}: {self.messages} messages of {len(self.topics)} topics in {self.duration_s:.3f} s"
        when = f", from {self.start} to {self.end}" if self.start else ""
        return [f"{line}{when}. {self.note}", *self.problems]


@dataclass(frozen=True, slots=True, kw_only=True)
class BagMessages:
    """Messages of one topic of a bag, received by the recorder `times_s` seconds after the bag's `start`.

    `truncated` lists the paths of shortened values; `problems` lists what is damaged or missing in the bag. `meaning`
    interprets the newest message of a laser scan, a point cloud or a depth image, seen from the robot's base.
    """

    bag: str
    topic_name: str = field(metadata=SAID)
    topic_type: str
    messages: Sequence[dict[str, Any]]
    start: str
    times_s: Sequence[float] = field(metadata=beside("messages"))
    count: int = field(metadata=SAID)
    truncated: Sequence[str] = field(metadata={**IF_ANY, **SAID})
    problems: Sequence[str] = field(metadata={**IF_ANY, **SAID})
    note: str = field(metadata=IF_ANY)
    meaning: Meaning | None = field(default=None, metadata={**ON_REQUEST, **SAID})

    def summary(self) -> list[str]:
        """Return one line, and one line for each problem."""
        said = f"{self.note} {self.meaning or ''}".strip()
        line = f"{named(self.bag)} {named(self.topic_name)}: {counted(self.count, 'message')}. {said}"
        return [line.rstrip(), *self.problems]


async def list_bags(store: BagStore, pattern: str = "", limit: int = 200) -> BagList:
    """Return the bags whose names match the pattern, the newest first."""

    from ros2_mcp.bags.recordings import files_of  # imports YAML

    def listed() -> BagList:
        found = store.bag_names()
        bags: list[BagEntry] = []
        for name in names.matching(found, pattern):
            facts = [file.stat() for file in files_of(found[name])]
            newest_ns = max(fact.st_mtime_ns for fact in facts)
            bags.append(BagEntry(name, sum(fact.st_size for fact in facts), iso_time(newest_ns)))
        bags.sort(key=lambda entry: entry.modified_at, reverse=True)
        return BagList(bags[:limit], len(found), str(store.bag_dir), store.not_listed())

    return await asyncio.to_thread(listed)


async def info(store: BagStore, bag: str) -> BagInfo:
    """Return the contents of a bag: times, topics, numbers of messages, and damage.

    Raises:
        NotFound: if there is no such bag.
        BadData: if nothing of it can be read.
    """

    def checked() -> bool:
        with store.reading(bag) as found:
            return found.check(_CHECK_TURN_S)

    def read_info(is_checked: bool) -> BagInfo:
        with store.reading(bag) as found:
            counts = found.counts()
            first_ns, last_ns = found.times or (0, 0)
            return BagInfo(
                bag=bag,
                start=iso_time(first_ns) if found.times else "",
                end=iso_time(last_ns) if found.times else "",
                duration_s=(last_ns - first_ns) / 1e9,
                messages=sum(counts.values()),
                bytes=found.size,
                topics=[
                    BagTopic(name, topic.type, counts.get(name, 0), has_definition(topic))
                    for name, topic in sorted(found.topics.items())
                ],
                problems=_problems(store, found),
                note="The whole bag was read."
                if is_checked
                else f"Only a part of the bag was read in {_CHECK_S:g} s; the rest may be damaged.",
            )

    until_s, is_checked = monotonic() + _CHECK_S, False
    while not is_checked and monotonic() < until_s:
        is_checked = await asyncio.to_thread(checked)
    return await asyncio.to_thread(read_info, is_checked)


async def read(
    robot: Robot, store: BagStore, bag: str, topic: str, selection: Selection, start: str = "", end: str = ""
) -> BagMessages:
    """Return messages of one topic of a bag: with a `start` the first messages from there on, else the last messages.

    Raises:
        NotFound: if there is no such bag or topic.
        UnknownInterface: if the definition of the type is unknown.
        BadValue: if a limit or a time is out of range, or a field is not in the type.
    """

    def read_problems() -> Sequence[str]:
        with store.reading(bag) as found:
            return _problems(store, found)

    bounded("message_limit", selection.message_limit or 1, 1, MAX_MESSAGES, "messages")
    source = await open_bag(store, bag, start, end, robot, may_be_empty=True)
    collected = await collect(source, topic, "", selection, latched=False)
    stream = collected.stream
    fitted = await asyncio.to_thread(fit, stream.codec, stream.type, collected.samples, selection)
    start, times_s = message_times(source, fitted.samples)
    notes = [stream.note, collected.more, fitted.note, summarised(fitted.truncated)]
    if not collected.samples:
        first_ns, last_ns = source.covers
        notes.append(
            f"No message in that time; the bag covers {iso_time(first_ns)} to {recorded_time(last_ns, first_ns)}."
        )
    return BagMessages(
        bag=bag,
        topic_name=stream.topic,
        topic_type=stream.type,
        messages=fitted.values,
        start=start,
        times_s=times_s,
        count=len(fitted.values),
        truncated=list(fitted.truncated),
        problems=await asyncio.to_thread(read_problems),
        meaning=await meaning_of_newest(source, stream, fitted),
        note=" ".join(filter(None, notes)),
    )


def _problems(store: BagStore, bag: Bag) -> Sequence[str]:
    return [*(["It is still being recorded."] if store.is_growing(bag) else []), *store.problems_of(bag)]
