"""A bag: a rosbag2 folder or a single file, read as one sequence of messages."""

from __future__ import annotations

import heapq
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from itertools import islice
from pathlib import Path
from time import monotonic
from typing import TypeAlias

from ros2_mcp.bags.chunks import MAGIC
from ros2_mcp.bags.mcap_file import McapFile
from ros2_mcp.bags.recordings import files_of, of_ros_1, order_of
from ros2_mcp.bags.rosbag2 import METADATA, NOT_CLOSED, read_metadata
from ros2_mcp.bags.schema import bare
from ros2_mcp.bags.sqlite_file import SqliteFile
from ros2_mcp.bags.stored import FOREVER, Hole, OddTimes, Span, StoredTopic, odd_times_in_words
from ros2_mcp.model.errors import BadData, Locked
from ros2_mcp.model.samples import Sample
from ros2_mcp.model.text import named

StoredFile: TypeAlias = McapFile | SqliteFile
"""One file of a bag. A new kind of file needs the interface of these two classes: `topics`, `times`, `count`, `counts`,
`messages`, `check`, `odd_times`, `close`, and `problems` with their `holes`. `problems` and `holes` grow while damage
is found; damage never changes the messages that are returned. `unfinished` are the problems that every file has while
it is being written."""
_SQLITE_START = b"SQLite format 3"


class Bag:
    """A bag, open for reading. `problems` lists what is damaged or missing; it grows as reading finds more.

    Messages are returned in the order of time over all files; each file is read only as far as needed. A topic has one
    type and definition, those of the newest file with messages of the topic; messages with another type or definition
    in other files are omitted. `former` is the same bag as opened before: files that have not changed since are not
    scanned again.

    Raises:
        NotFound: if there is no bag at that path.
        BadData: if no file of the bag can be read.
        Locked: if another program is writing to the bag.
    """

    def __init__(self, path: Path, former: Bag | None = None) -> None:
        self.path = path
        self._problems: list[str] = []
        self._unfinished: list[str] = []
        self._holes: list[Hole] = []
        self._odd_times: Mapping[str, OddTimes] = {}
        self._files = self._open(former)
        self.topics = self._merged_topics()
        self._left_out = self._misfits()

    @property
    def problems(self) -> list[str]:
        """Sentences about damaged or missing data, as far as known yet."""
        of_files = [problem for file in self._files for problem in file.problems]
        return [*self._unfinished, *self._problems, *of_files, *odd_times_in_words(self._odd_times)]

    @property
    def unfinished(self) -> list[str]:
        """The problems that are expected while the bag is still being recorded."""
        return [*self._unfinished, *(problem for file in self._files for problem in file.unfinished)]

    @property
    def holes(self) -> list[Hole]:
        """The time ranges of lost messages, as far as they are known yet.

        Losses after the last message are not listed.
        """
        begins_ns = [file.times[0] for file in self._files if file.times]
        found: list[Hole] = []
        for hole in (*self._holes, *(hole for file in self._files for hole in file.holes)):
            later_ns = [at_ns for at_ns in begins_ns if at_ns > hole.start_ns]
            if hole.end_ns < FOREVER:
                found.append(hole)
            elif later_ns:  # this hole ends where the next file begins
                found.append(replace(hole, end_ns=min(later_ns)))
        return found

    @property
    def times(self) -> tuple[int, int] | None:
        """Unix times in ns of the first and the last message; None if the bag is empty."""
        spans = [file.times for file in self._files if file.times]
        return (min(first for first, _ in spans), max(last for _, last in spans)) if spans else None

    @property
    def size(self) -> int:
        """Size of all files in bytes."""
        return sum(path.stat().st_size for path in files_of(self.path))

    def messages(self, span: Span | None = None, newest_first: bool = False) -> Iterator[tuple[str, Sample]]:
        """Return topic and message in the order of time, or newest first.

        A message that is in several files of a ring is returned once.
        """
        span = span or Span()
        sources: list[Iterator[tuple[str, Sample]]] = []
        for file, left_out in zip(self._files, self._left_out, strict=True):
            topics = frozenset(file.topics if span.topics is None else span.topics) - left_out
            sources.append(file.messages(replace(span, topics=topics) if left_out else span, newest_first))
        if len(sources) == 1:
            return sources[0]
        if newest_first:
            sources.reverse()
        return _merged(sources, newest_first)

    def last(self, topic: str, most: int, span: Span | None = None) -> list[Sample]:
        """Return the last `most` messages of a topic before the span's end, oldest first.

        Only the end of the bag is read.
        """
        span = replace(span or Span(), topics=(topic,))
        newest = [sample for _, sample in islice(self.messages(span, newest_first=True), most)]
        return newest[::-1]

    def counts(self) -> dict[str, int]:
        """Return the number of messages of each topic over all files.

        For SQLite files this reads an index entry per message.
        """
        total: dict[str, int] = {}
        for file, left_out in zip(self._files, self._left_out, strict=True):
            for name, count in file.counts().items():
                if name not in left_out:
                    total[name] = total.get(name, 0) + count
        return total

    def check(self, for_s: float) -> bool:
        """Read on for at most `for_s` seconds to find damage; return whether everything has been read.

        What was read once is not read again.
        """
        until_s = monotonic() + for_s
        is_read = all(file.check(until_s) for file in self._files)
        self.odd_times(for_s)
        return is_read

    def odd_times(self, for_s: float = 0.2) -> Mapping[str, OddTimes]:
        """Return irregular message times by topic, as far as they are found within `for_s` seconds."""
        until_s = monotonic() + for_s
        found: dict[str, OddTimes] = {}
        for file in self._files:
            for name, odd in file.odd_times(until_s).items():
                found[name] = found[name].joined(odd) if name in found else odd
        self._odd_times = found
        return found

    def known_files(self) -> dict[Path, McapFile]:
        """Return the MCAP files that have been scanned.

        SQLite files are excluded: their contents may change in place.
        """
        return {file.path: file for file in self._files if isinstance(file, McapFile)}

    def close(self) -> None:
        """Close all files."""
        for file in self._files:
            file.close()

    def __enter__(self) -> Bag:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _open(self, former: Bag | None) -> list[StoredFile]:
        """Open every readable file.

        Note the others as problems, and what `metadata.yaml` lists but the folder lacks.
        """
        paths = files_of(self.path)
        facts, is_without = read_metadata(self.path) if self.path.is_dir() else None, False
        if isinstance(facts, str):
            if facts != NOT_CLOSED:
                self._problems.append(facts)
            facts, is_without = None, facts == NOT_CLOSED
        former_files = former.known_files() if former else {}
        opened: list[StoredFile] = []
        for path in paths:
            try:
                same = former_files.get(path)
                compression = facts.compression_mode if facts else ""
                opened.append(same if same and same.is_current else _open_file(path, compression))
            except (BadData, OSError) as error:
                self._problems.append(f"{path.name}: {error}" if isinstance(error, OSError) else str(error))
            except Locked:
                for file in opened:
                    if file.path not in former_files:
                        file.close()
                raise
        if not opened:
            raise BadData(f"{self.path.name} cannot be read: {' '.join(self._problems)}")
        if is_without and not all(isinstance(file, McapFile) and not file.unfinished for file in opened):
            self._unfinished.append(NOT_CLOSED)  # an MCAP file with a footer was closed
        readable = {file.path for file in opened}
        self._holes += [_hole_of(path, opened) for path in paths if path not in readable]
        if facts:
            missing = {Path(name).name for name in facts.files} - {path.name for path in paths}
            for name in sorted(missing, key=lambda name: order_of(Path(name))):
                hole = _hole_of(Path(name), opened)
                self._holes.append(hole)
                self._problems.append(f"{named(name)} is listed in {METADATA}, but missing: its {hole.words}.")
            counts = [file.count for file in opened]
            count = sum(count or 0 for count in counts)
            if None not in counts and count < facts.count:
                self._problems.append(f"{METADATA} lists {facts.count} messages, but the bag has {count}.")
        return opened

    def _merged_topics(self) -> Mapping[str, StoredTopic]:
        """Return each topic as in the newest file with messages of it.

        If that file has no definition of the topic, the definition of an older file is used.
        """
        found: dict[str, StoredTopic] = {}
        newest_first = [topic for file in reversed(self._files) for topic in file.topics.values()]
        for topic in sorted(newest_first, key=lambda topic: topic.count == 0):
            newest = found.setdefault(topic.name, topic)
            if newest.type == topic.type and topic.definition and not newest.definition:
                found[topic.name] = replace(newest, encoding=topic.encoding, definition=topic.definition)
        return found

    def _misfits(self) -> list[frozenset[str]]:
        """Return for each file the topics whose type or definition conflicts with the newest file.

        Note them as problems.
        """
        misfits = [[topic for topic in file.topics.values() if not self._fits(topic)] for file in self._files]
        conflicts = [topic for topics in misfits for topic in topics if topic.count != 0]
        for name in sorted({topic.name for topic in conflicts}):
            now, types = self.topics[name].type, [topic.type for topic in conflicts if topic.name == name]
            others = sorted({named(kind) if kind != now else f"another definition of {named(kind)}" for kind in types})
            self._problems.append(
                f"{named(name)}: its messages in {len(types)} of {len(misfits)} files are left out: they are of "
                f"{' and '.join(others)}, the newest of {named(now)}."
            )
        return [frozenset(topic.name for topic in topics) for topics in misfits]

    def _fits(self, topic: StoredTopic) -> bool:
        """Return whether a topic's bytes mean the same as in the newest file; comments and spacing are ignored."""
        newest = self.topics[topic.name]
        if newest.type != topic.type or topic.form == "json" or not topic.definition or not newest.definition:
            return newest.type == topic.type
        return newest.definition == topic.definition or bare(newest.definition) == bare(topic.definition)


def _open_file(path: Path, compression: str) -> StoredFile:
    """Open a file by its content, not its name; raises the errors of `McapFile` and `SqliteFile`."""
    if why := of_ros_1(path):
        raise BadData(why)
    with path.open("rb") as file:
        start = file.read(len(_SQLITE_START))
    if start.startswith(MAGIC):
        opened = McapFile(path)
        if not path.name.endswith(".mcap"):
            opened.problems.append(
                f"{named(path.name)} is an MCAP file, whatever its name says, and is read as one: others read it as "
                f"{named(path.name.partition('.')[0])}.mcap, or convert it with `rosbags-convert`."
            )
        return opened
    if path.name.endswith(".mcap.zstd"):
        raise BadData(f"{path.name} is compressed as a whole: unpack it with `unzstd` first.")
    if path.suffix == ".mcap" and start.startswith(_SQLITE_START):
        opened = SqliteFile(path, compression.replace("file", ""))
        opened.problems.append(f"{named(path.name)} is a database of SQLite (.db3), and is read as one.")
        return opened
    if path.suffix == ".mcap":
        return McapFile(path)
    return SqliteFile(path, "file" if path.suffix == ".zstd" else compression.replace("file", ""))


def _hole_of(missing: Path, opened: Sequence[StoredFile]) -> Hole:
    """Return the hole of a missing file: from the end of the file before it to the start of the next file."""
    before = [file.times[1] for file in opened if file.times and order_of(file.path) < order_of(missing)]
    after = [file.times[0] for file in opened if file.times and order_of(file.path) > order_of(missing)]
    start_ns = max(before, default=0)
    return Hole(start_ns, max(min(after, default=FOREVER), start_ns))


def _merged(sources: list[Iterator[tuple[str, Sample]]], newest_first: bool) -> Iterator[tuple[str, Sample]]:
    """Yield the messages of several files in the order of time.

    Skips the copies of latched messages with which the files of a ring begin: a message equal to the previous one of
    its topic, but from another file.
    """

    def numbered(number: int, messages: Iterator[tuple[str, Sample]]) -> Iterator[tuple[int, str, Sample]]:
        return ((number, topic, sample) for topic, sample in messages)

    files = [numbered(number, messages) for number, messages in enumerate(sources)]
    last: dict[str, tuple[int, Sample]] = {}
    for file, topic, sample in heapq.merge(*files, key=lambda entry: entry[2].received_ns, reverse=newest_first):
        before = last.get(topic)
        last[topic] = file, sample
        if before is None or before[0] == file or before[1] != sample:
            yield topic, sample
