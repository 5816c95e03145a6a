"""A bag: a rosbag2 folder, or a single file, as one sequence of messages."""

from __future__ import annotations

import heapq
import re
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import replace
from itertools import islice
from pathlib import Path
from types import TracebackType

from ros2_mcp.bags.mcap_file import McapFile
from ros2_mcp.bags.rosbag2 import METADATA, FolderFacts, read_metadata
from ros2_mcp.bags.sqlite_file import SqliteFile
from ros2_mcp.bags.stored import Span, StoredFile, StoredTopic
from ros2_mcp.model.errors import BadData, NotFound
from ros2_mcp.model.samples import Sample

SUFFIXES = (".mcap", ".db3", ".db3.zstd", ".mcap.zstd")


class Bag:
    """A bag, open for reading. `problems` say what is damaged or missing, and grow while more of it is found.

    Messages come in the order of time over all files; each file is read only as far as it is needed. `former` is the
    same bag as it was before: files that have not changed since are not looked through again.

    Raises:
        NotFound: if there is no bag at that path.
        BadData: if nothing of it can be read.
    """

    def __init__(self, path: Path, former: Bag | None = None) -> None:
        self.path = path
        self._problems: list[str] = []
        self.distro = ""
        self._files = self._open(_files_of(path), self._facts(), former.known_files() if former else {})
        self.topics = self._merged_topics()

    @property
    def problems(self) -> list[str]:
        """What is damaged or missing, as far as it is known yet."""
        return [*self._problems, *(problem for file in self._files for problem in file.problems)]

    @property
    def count(self) -> int | None:
        """How many messages there are; None where damage keeps it from being known."""
        counts = [file.count for file in self._files]
        return None if None in counts else sum(count or 0 for count in counts)

    @property
    def times(self) -> tuple[int, int] | None:
        """Unix times in nanoseconds of the first and the last message; None if there is none."""
        spans = [file.times for file in self._files if file.times]
        return (min(first for first, _ in spans), max(last for _, last in spans)) if spans else None

    @property
    def size(self) -> int:
        """Bytes of all files."""
        return sum(path.stat().st_size for path in _files_of(self.path))

    def messages(self, span: Span | None = None, newest_first: bool = False) -> Iterator[tuple[str, Sample]]:
        """Topic and message, in the order of time or in its reverse; what several files of a ring have comes once."""
        span = span or Span()
        if len(self._files) == 1:
            return self._files[0].messages(span, newest_first)
        files = self._files[::-1] if newest_first else self._files
        sources = [_numbered(number, file.messages(span, newest_first)) for number, file in enumerate(files)]
        return _once(heapq.merge(*sources, key=lambda each: each[2].received_ns, reverse=newest_first))

    def last(self, topic: str, most: int, span: Span | None = None) -> list[Sample]:
        """The last messages of a topic (before the span's end), the oldest first; read from the end of the bag."""
        span = replace(span or Span(), topics=(topic,))
        newest = [sample for _, sample in islice(self.messages(span, newest_first=True), most)]
        return newest[::-1]

    def counts(self) -> dict[str, int]:
        """Messages of each topic in all files together; in SQLite files an entry of each message is read for it."""
        total: dict[str, int] = {}
        for file in self._files:
            own = (
                file.counts() if isinstance(file, SqliteFile) else {t.name: t.count or 0 for t in file.topics.values()}
            )
            for name, count in own.items():
                total[name] = total.get(name, 0) + count
        return total

    def known_files(self) -> dict[Path, McapFile]:
        """The MCAP files that were looked through. (What SQLite files say may change although they do not.)"""
        return {file.path: file for file in self._files if isinstance(file, McapFile)}

    def close(self) -> None:
        """Closes all files."""
        for file in self._files:
            file.close()

    def __enter__(self) -> Bag:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def _facts(self) -> FolderFacts | None:
        if not self.path.is_dir():
            return None
        facts = read_metadata(self.path)
        if isinstance(facts, str):
            self._problems.append(facts)
            return None
        self.distro = facts.distro
        return facts

    def _open(self, paths: list[Path], facts: FolderFacts | None, known: Mapping[Path, McapFile]) -> list[StoredFile]:
        opened: list[StoredFile] = []
        for path in paths:
            try:
                same = known.get(path)
                compression = facts.compression_mode if facts else ""
                opened.append(same if same and same.is_current else _open_file(path, compression))
            except (BadData, OSError) as error:
                self._problems.append(f"{path.name}: {error}" if isinstance(error, OSError) else str(error))
        if not opened:
            raise BadData(f"{self.path.name} cannot be read: {' '.join(self._problems)}")
        if facts:
            self._compare(facts, paths, opened)
        return opened

    def _compare(self, facts: FolderFacts, paths: list[Path], opened: list[StoredFile]) -> None:
        missing = {Path(name).name for name in facts.files} - {path.name for path in paths}
        self._problems += [f"{name} is listed in {METADATA}, but missing." for name in sorted(missing)]
        there = [file.count for file in opened]
        if facts.count is not None and None not in there and sum(count or 0 for count in there) < facts.count:
            self._problems.append(f"{METADATA} counts {facts.count} messages, {sum(c or 0 for c in there)} are there.")

    def _merged_topics(self) -> Mapping[str, StoredTopic]:
        found: dict[str, StoredTopic] = {}
        for file in self._files:
            for name, topic in file.topics.items():
                known = found.setdefault(name, topic)
                if known.type != topic.type:
                    raise BadData(f"{name} has the type {known.type} in one file and {topic.type} in another.")
                if topic.definition and not known.definition:
                    found[name] = topic
        return found


def _open_file(path: Path, compression: str) -> StoredFile:
    if path.name.endswith(".mcap"):
        return McapFile(path)
    if path.name.endswith(".mcap.zstd"):
        raise BadData(f"{path.name} is compressed as a whole: unpack it with `unzstd` first.")
    return SqliteFile(path, "file" if path.suffix == ".zstd" else compression.replace("file", ""))


def is_bag(path: Path) -> bool:
    """Whether it is a bag's file, or a folder with such files; what cannot be looked into is none."""
    try:
        return bool(_files_in(path)) if path.is_dir() else path.name.endswith(SUFFIXES) and path.is_file()
    except OSError:
        return False


def _files_of(path: Path) -> list[Path]:
    try:
        if not path.is_dir() and not path.is_file():
            raise NotFound(f"There is no bag {path.name}.")
        found = _files_in(path) if path.is_dir() else [path]
    except OSError as error:
        raise BadData(f"{path.name} cannot be read: {error.strerror}.") from error
    if not found:
        raise NotFound(f"{path.name} holds no bag: there is no .mcap or .db3 file in it.")
    return found


def _files_in(folder: Path) -> list[Path]:
    return sorted((path for path in folder.iterdir() if path.name.endswith(SUFFIXES) and path.is_file()), key=_order)


def _order(path: Path) -> list[tuple[int, str]]:
    """`run_2.mcap` comes before `run_10.mcap`."""
    return [(int(part), "") if part.isdigit() else (-1, part) for part in re.split(r"(\d+)", path.name)]


def _numbered(number: int, messages: Iterable[tuple[str, Sample]]) -> Iterator[tuple[int, str, Sample]]:
    return ((number, topic, sample) for topic, sample in messages)


def _once(messages: Iterable[tuple[int, str, Sample]]) -> Iterator[tuple[str, Sample]]:
    """Without the copies of latched messages with which the files of a ring begin."""
    last: dict[str, tuple[int, Sample]] = {}
    for file, topic, sample in messages:
        before = last.get(topic)
        last[topic] = file, sample
        if before is None or before[0] == file or before[1] != sample:
            yield topic, sample
