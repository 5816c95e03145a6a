"""Read one SQLite file of rosbag2, of any distribution."""

from __future__ import annotations

import os
import sqlite3
import tempfile
from collections.abc import Collection, Generator, Mapping, Sequence
from contextlib import ExitStack, closing, contextmanager
from functools import partial
from pathlib import Path
from time import monotonic
from typing import TypeAlias

import zstandard

from ros2_mcp.bags.chunks import Damaged, unzstd
from ros2_mcp.bags.contents import stored_topic
from ros2_mcp.bags.order import Written, odd_times, written
from ros2_mcp.bags.stored import FOREVER, MOST_PROBLEMS, Hole, OddTimes, Span, StoredTopic
from ros2_mcp.model.errors import BadData, Locked
from ros2_mcp.model.samples import Sample
from ros2_mcp.model.text import named
from ros2_mcp.model.times import iso_time

_BUSY_S = 1.0
"""Seconds to wait for a recorder that writes to the file; its transactions take milliseconds."""
_PAGE_ROWS = (16, 1024)
"""Rows of one query, of the first and at most: a query that ends lets others write to the file, and a reader of only
the last message does not need a thousand."""
_PAGE_BYTES = 8_000_000
"""Bytes of messages that one query holds in memory."""
_UNINDEXED_BYTES = 64_000_000
"""The same without an index of the times (`ros2 bag` makes no such index): each query then reads and sorts the whole
file.
"""
_ORDERED_ROWS = 20_000
"""Rows whose times are read at once, without their data: takes 10 ms."""
_Row: TypeAlias = "tuple[tuple[int, int], tuple[str, Sample] | None]"
"""The place of a row (its time and number), and its message; None if its topic is not wanted or it cannot be
unpacked."""
_NOWHERE = (-1, 0)
"""The place before any row."""


class SqliteFile:
    """One `.db3` file, open for reading. SQLite has no checksums: only broken structure is noticed.

    `compression` is `""`, `message` or `file` (zstd, the only one that rosbag2 has). The `topics` have no counts,
    because counting reads the whole file.

    Every method that reads raises `Locked` if another program writes to the file for longer than a second.

    Raises:
        BadData: if it is not a readable rosbag2 database.
    """

    def __init__(self, path: Path, compression: str = "") -> None:
        self.path = path
        self.problems: list[str] = []
        self.unfinished: list[str] = []
        self._holes: dict[Hole, None] = {}  # in the order they were found, each once however often it is read
        self._compressed = compression == "message"
        self._checked_ns = 0
        self._order: list[
            dict[int, Written]
        ] = []  # of the rows up to a number, in the order in which they were written
        self._ordered_to = -1
        self._opened = ExitStack()
        with ExitStack() as opened:  # closed again if the rest fails
            whole = opened.enter_context(_decompressed(path)) if compression == "file" else path
            try:
                database = _connect(whole)
                self._database = opened.enter_context(closing(database))
                self._names, self.topics = self._read_topics()
                ends = "ASC", "DESC"  # two queries: each uses the index, without reading the rows in between
                order = "SELECT timestamp FROM messages WHERE timestamp > 0 ORDER BY timestamp {} LIMIT 1"
                rows = [self._database.execute(order.format(end)).fetchone() for end in ends]
                self._has_index = self._database.execute("PRAGMA index_list(messages)").fetchone() is not None
            except sqlite3.Error as error:
                _raise_if_locked(path, error)
                raise BadData(f"{path.name} cannot be read: {error}.") from error
            self.times: tuple[int, int] | None = (int(rows[0][0]), int(rows[1][0])) if rows[0] and rows[1] else None
            self._opened = opened.pop_all()

    @property
    def holes(self) -> list[Hole]:
        """The time ranges of lost messages, as far as they are known yet."""
        return list(self._holes)

    @property
    def count(self) -> int | None:
        """Number of messages; None if SQLite cannot count them because of damage."""
        try:
            return int(self._database.execute("SELECT count(*) FROM messages").fetchone()[0])
        except sqlite3.Error as error:
            _raise_if_locked(self.path, error)
            self._note(f"its messages cannot be counted: {error}")
            return None

    def counts(self) -> dict[str, int]:
        """Return the number of messages of each topic. This reads an index entry per message."""
        try:
            rows = self._database.execute("SELECT topic_id, count(*) FROM messages GROUP BY topic_id").fetchall()
        except sqlite3.Error as error:
            _raise_if_locked(self.path, error)
            self._note(f"its messages cannot be counted: {error}")
            return {}
        return {self._names[number]: int(count) for number, count in rows if number in self._names}

    def messages(self, span: Span, newest_first: bool = False) -> Generator[tuple[str, Sample], None, None]:
        """Yield topic and message in the order of time; omit what cannot be read, and note it as a hole.

        Rows of other topics are skipped here, not by the query: a hole reaches from the last readable message before
        the damage to the first one after it, whichever topics are wanted.
        """
        numbers = {number for number, name in self._names.items() if span.topics is None or name in span.topics}
        start_ns, end_ns, past = span.start_ns, min(span.end_ns, FOREVER), _NOWHERE
        most, longest = _PAGE_ROWS
        while numbers:
            page, is_last, damage = self._page(numbers, start_ns, end_ns, newest_first, past, most)
            most = min(4 * most, longest)
            for place, message in page:
                past = place
                if message:
                    yield message
            start_ns, end_ns = _beyond_place(past, start_ns, end_ns, newest_first)
            if is_last:
                return
            if not damage:
                continue
            following_ns = self._beyond(numbers, start_ns, end_ns, newest_first)
            if newest_first:
                hole_ns = start_ns if following_ns is None else following_ns, end_ns - (past != _NOWHERE)
                end_ns = hole_ns[0] + 1
            else:
                hole_ns = start_ns, end_ns if following_ns is None else following_ns
                start_ns = hole_ns[1]
            past = _NOWHERE
            self._note_hole(Hole(*self._within(*hole_ns)), damage)
            if following_ns is None:
                return

    def _page(
        self,
        numbers: Collection[int],
        start_ns: int,
        end_ns: int,
        newest_first: bool,
        past: tuple[int, int],
        most: int,
    ) -> tuple[list[_Row], bool, str]:
        """Return the next rows that fit in memory, whether they are the last, and the damage after them.

        No query is open on return: an open query would keep other programs from writing to the file.
        """
        found: list[_Row] = []
        size, room = 0, _PAGE_BYTES if self._has_index else _UNINDEXED_BYTES
        try:
            with closing(self._rows(numbers, start_ns, end_ns, newest_first, past)) as rows:
                for row in rows:
                    found.append(row)
                    size += len(row[1][1].data) if row[1] else 0
                    if size >= room or (self._has_index and len(found) >= most):
                        return found, False, ""
        except sqlite3.Error as error:
            # `sqlite3` reads a row ahead and drops the one before the damage, so that row is queried on its own.
            past = found[-1][0] if found else past
            start_ns, end_ns = _beyond_place(past, start_ns, end_ns, newest_first)
            before = self._next_row(numbers, start_ns, end_ns, newest_first, past)
            return ([*found, before], False, "") if before else (found, False, str(error))
        return found, True, ""

    def _rows(
        self,
        numbers: Collection[int],
        start_ns: int,
        end_ns: int,
        newest_first: bool,
        past: tuple[int, int] = _NOWHERE,
        most: int = -1,
    ) -> Generator[_Row, None, None]:
        """Yield each row in that time range beyond the place `past`; data is read only for the topics in `numbers`."""
        order, beyond = ("DESC", "<") if newest_first else ("ASC", ">")
        spans = [("timestamp >= ? AND timestamp < ? AND (timestamp != ? OR id {beyond} ?)", (start_ns, end_ns, *past))]
        if past != _NOWHERE and self._has_index:
            # Two queries: with one, SQLite would skip all rows with the time of `past` again for each page.
            rest = (start_ns, past[0]) if newest_first else (past[0] + 1, end_ns)
            spans = [("timestamp = ? AND id {beyond} ?", past), ("timestamp >= ? AND timestamp < ?", rest)]
        for condition, bounds in spans:
            statement = (
                f"SELECT id, topic_id, timestamp, CASE WHEN topic_id IN ({','.join('?' * len(numbers))}) THEN data END "
                f"FROM messages WHERE {condition.format(beyond=beyond)} "
                f"ORDER BY timestamp {order}, id {order} LIMIT ?"
            )
            yield from self._queried(numbers, statement, (*numbers, *bounds, most))

    def _queried(self, numbers: Collection[int], statement: str, values: Sequence[int]) -> Generator[_Row, None, None]:
        with closing(self._database.cursor()) as cursor:
            try:
                rows = cursor.execute(statement, values)
            except sqlite3.Error as error:
                _raise_if_locked(self.path, error)
                raise
            for row, number, at_ns, data in rows:
                place = int(at_ns), row
                if number not in numbers:
                    yield place, None
                    continue
                name = self._names[number]
                try:
                    if not isinstance(data, bytes):  # SQLite lets a damaged row have another type than its column
                        raise Damaged("it is not of bytes")
                    body = unzstd(data) if self._compressed else data
                except Damaged as error:
                    self._note(f"a message of {named(name)} at {iso_time(at_ns)} cannot be read: {error}")
                    self._holes[Hole(at_ns, at_ns, frozenset((name,)))] = None
                    yield place, None
                    continue
                yield place, (name, Sample(int(at_ns), 0, None, body))

    def _next_row(
        self, numbers: Collection[int], start_ns: int, end_ns: int, newest_first: bool, past: tuple[int, int]
    ) -> _Row | None:
        """Return the next row beyond `past`; None if it cannot be read."""
        try:
            return next(self._rows(numbers, start_ns, end_ns, newest_first, past, 1), None)
        except sqlite3.Error:
            return None

    def _beyond(self, numbers: Collection[int], start_ns: int, end_ns: int, newest_first: bool) -> int | None:
        """Return the time of the first readable message beyond damage at the start (or end) of a time range."""

        def found(away_ns: int) -> int | None:
            """Return the time of the first message so far away, or None if there is none; raises if it is damaged."""
            span = (start_ns, end_ns - away_ns) if newest_first else (start_ns + away_ns, end_ns)
            return next((place[0] for place, _ in self._rows(numbers, *span, newest_first, most=1)), None)

        first_ns, last_ns = self._within(start_ns, end_ns)
        if newest_first:
            end_ns = last_ns
        else:
            start_ns = first_ns
        damaged_ns, step_ns = 0, 1
        best: int | None = None
        while best is None:  # double the distance until a message can be read
            try:
                best = found(step_ns)
            except sqlite3.Error:
                damaged_ns, step_ns = step_ns, 2 * step_ns
                continue
            if best is None:
                return None
        whole_ns = step_ns
        while whole_ns - damaged_ns > 1:  # then bisect back to where the damage ends
            middle_ns = (damaged_ns + whole_ns) // 2
            try:
                nearer = found(middle_ns)
                best, whole_ns = best if nearer is None else nearer, middle_ns
            except sqlite3.Error:
                damaged_ns = middle_ns
        return best

    def _within(self, start_ns: int, end_ns: int) -> tuple[int, int]:
        """Return a time range limited to that of the file's messages."""
        first_ns, last_ns = self.times or (start_ns, end_ns)
        return max(start_ns, first_ns), max(min(end_ns, last_ns + 1), start_ns)

    def check(self, until_s: float) -> bool:
        """Read on until the monotonic time `until_s` to find damage; return whether everything has been read."""
        with closing(self.messages(Span(start_ns=self._checked_ns))) as messages:
            for _, sample in messages:
                self._checked_ns = sample.received_ns
                if monotonic() >= until_s:
                    return False  # closes the query: an open one would keep other programs from writing to the file
        return True

    def odd_times(self, until_s: float) -> dict[str, OddTimes]:
        """Return irregular message times by topic, of the rows that are read until the monotonic time `until_s`."""
        query = "SELECT id, topic_id, timestamp FROM messages WHERE id > ? ORDER BY id LIMIT ?"
        try:
            while monotonic() < until_s:
                rows = self._database.execute(query, (self._ordered_to, _ORDERED_ROWS)).fetchall()
                if not rows:
                    break
                self._order.append(written([(number, int(at_ns)) for _, number, at_ns in rows]))
                self._ordered_to = int(rows[-1][0])
        except (sqlite3.Error, TypeError, ValueError):
            pass  # damage, which is reported where messages are read
        return odd_times(self._order, self._names)

    def close(self) -> None:
        """Close the file."""
        self._opened.close()

    def __del__(self) -> None:
        """Close the file with its last reader.

        A bag that has changed is opened again while others may still read the old one.
        """
        self.close()

    def _read_topics(self) -> tuple[dict[int, str], Mapping[str, StoredTopic]]:
        """Return topic names by their numbers in the file, and topics by name.

        The first distributions stored no QoS, and only Iron and later store definitions.
        """
        execute = self._database.execute
        qos = "offered_qos_profiles" if "offered_qos_profiles" in self._columns("topics") else "''"
        query = "SELECT topic_type, encoding, encoded_message_definition FROM message_definitions"
        rows = execute(query) if self._columns("message_definitions") else ()
        definitions: dict[str, tuple[str, str]] = {kind: (encoding, text) for kind, encoding, text in rows}
        names: dict[int, str] = {}
        topics: dict[str, StoredTopic] = {}
        for number, name, kind, serialization, profiles in execute(
            f"SELECT id, name, type, serialization_format, {qos} FROM topics"
        ):
            encoding, text = definitions.get(kind, ("", ""))
            topic = stored_topic(name, kind, encoding, text, serialization=serialization, qos=profiles or "")
            if name in topics and topics[name].type != topic.type:
                self.problems.append(
                    f"{self.path.name}: {named(name)} has several types; only {named(topics[name].type)} is read."
                )
                continue
            names[number] = name
            topics[name] = topic
        return names, topics

    def _columns(self, table: str) -> set[str]:
        """Return the names of the table's columns; empty if there is no such table."""
        return {row[1] for row in self._database.execute(f"PRAGMA table_info({table})")}

    def _note_hole(self, hole: Hole, error: str) -> None:
        self._holes[hole] = None
        self._note(f"{hole.words}: {error}")

    def _note(self, problem: str) -> None:
        text = f"{self.path.name}: {problem}."
        if len(self.problems) < MOST_PROBLEMS and text not in self.problems:
            self.problems.append(text)


def _connect(path: Path) -> sqlite3.Connection:
    """Return a read-only connection, which also works in a read-only folder."""
    uri = path.resolve().as_uri()
    database = sqlite3.connect(f"{uri}?mode=ro", timeout=_BUSY_S, uri=True, check_same_thread=False)
    try:
        database.execute("SELECT 1 FROM topics LIMIT 1").fetchone()
    except sqlite3.Error as error:
        database.close()
        if not isinstance(error, sqlite3.OperationalError):
            raise
        _raise_if_locked(path, error)
        # SQLite needs a journal (WAL) beside the file even to read it; `immutable` avoids that.
        database = sqlite3.connect(f"{uri}?immutable=1", timeout=_BUSY_S, uri=True, check_same_thread=False)
    database.text_factory = partial(str, encoding="utf-8", errors="replace")
    return database


def _raise_if_locked(path: Path, error: sqlite3.Error) -> None:
    """Raise `Locked` if the error says that the database is locked, which is not damage."""
    if "locked" in str(error):
        hint = "Ask again when the other program has finished or paused; the file is not damaged."
        raise Locked(f"{path.name} is locked: another program writes to it.", hint) from error


def _beyond_place(past: tuple[int, int], start_ns: int, end_ns: int, newest_first: bool) -> tuple[int, int]:
    """Return the part of a time range at or beyond the time of a place."""
    if past == _NOWHERE:
        return start_ns, end_ns
    return (start_ns, past[0] + 1) if newest_first else (past[0], end_ns)


@contextmanager
def _decompressed(path: Path) -> Generator[Path, None, None]:
    """Decompress a file into a temporary file; delete the temporary file when the context ends."""
    descriptor, name = tempfile.mkstemp(prefix="ros2-mcp-", suffix=".db3")
    try:
        with os.fdopen(descriptor, "wb") as whole, path.open("rb") as packed:  # closed again: else Windows keeps it
            try:
                zstandard.ZstdDecompressor().copy_stream(packed, whole)
            except zstandard.ZstdError as error:
                raise BadData(f"{path.name} cannot be decompressed: {error}.") from error
        yield Path(name)
    finally:
        Path(name).unlink()
