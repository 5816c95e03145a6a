"""Reads one SQLite file of rosbag2, of any distribution."""

from __future__ import annotations

import sqlite3
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from contextlib import closing
from functools import partial
from pathlib import Path
from time import monotonic
from typing import Any

import zstandard

from ros2_mcp.bags.chunks import Damaged, unzstd
from ros2_mcp.bags.stored import FOREVER, MOST_PROBLEMS, Hole, Span, StoredTopic
from ros2_mcp.model.errors import BadData
from ros2_mcp.model.samples import Sample
from ros2_mcp.model.text import named
from ros2_mcp.model.times import iso_time

_BUSY_S = 1.0
"""How long to wait for a recorder that writes to the file; its transactions take milliseconds."""


class SqliteFile:
    """One `.db3` file, open for reading. SQLite has no checksums: only broken structure is noticed.

    `compression` is `""`, `message` or `file` (zstd, the only one rosbag2 has). The `topics` have no counts, for which
    everything would have to be read.

    Raises:
        BadData: if it is no rosbag2 database that can be read.
    """

    def __init__(self, path: Path, compression: str = "") -> None:
        self.path = path
        self.problems: list[str] = []
        self.unfinished: list[str] = []
        self.holes: list[Hole] = []
        self._compressed = compression == "message"
        self._whole = _decompressed(path) if compression == "file" else None
        try:
            self._database = _connect(Path(self._whole.name) if self._whole else path)
            self._names, self.topics = self._read_topics()
            ends = "ASC", "DESC"  # one after the other: each is found by the index, without reading what is between
            order = "SELECT timestamp FROM messages ORDER BY timestamp {} LIMIT 1"
            rows = [self._database.execute(order.format(end)).fetchone() for end in ends]
        except sqlite3.Error as error:
            raise BadData(f"{path.name} cannot be read: {error}.") from error
        self.times: tuple[int, int] | None = (int(rows[0][0]), int(rows[1][0])) if rows[0] and rows[1] else None
        self._unchecked: Iterator[object] | None = None

    @property
    def count(self) -> int | None:
        """How many messages there are; None where damage keeps SQLite from counting."""
        try:
            return int(self._database.execute("SELECT count(*) FROM messages").fetchone()[0])
        except sqlite3.Error as error:
            self._note(f"its messages cannot be counted: {error}")
            return None

    def counts(self) -> dict[str, int]:
        """Messages of each topic. Reads an entry of each message."""
        try:
            rows = self._database.execute("SELECT topic_id, count(*) FROM messages GROUP BY topic_id").fetchall()
        except sqlite3.Error as error:
            self._note(f"its messages cannot be counted: {error}")
            return {}
        return {self._names[number]: int(count) for number, count in rows if number in self._names}

    def messages(self, span: Span, newest_first: bool = False) -> Iterator[tuple[str, Sample]]:
        """Topic and message in the order of time; what cannot be read is left out, and noted as a hole."""
        numbers = [number for number, name in self._names.items() if span.topics is None or name in span.topics]
        start_ns, end_ns = span.start_ns, min(span.end_ns, FOREVER)
        while numbers:
            reached_ns: int | None = None
            try:
                for at_ns, message in self._rows(numbers, start_ns, end_ns, newest_first):
                    reached_ns = at_ns
                    if message:
                        yield message
                return
            except sqlite3.Error as error:
                if newest_first:
                    end_ns = end_ns if reached_ns is None else reached_ns
                    following_ns = self._beyond(numbers, start_ns, end_ns, newest_first)
                    hole_ns = start_ns if following_ns is None else following_ns, end_ns
                    end_ns = hole_ns[0] + 1
                else:
                    start_ns = start_ns if reached_ns is None else reached_ns
                    following_ns = self._beyond(numbers, start_ns, end_ns, newest_first)
                    hole_ns = start_ns, end_ns if following_ns is None else following_ns
                    start_ns = hole_ns[1]
                self._note_hole(Hole(*self._within(*hole_ns)), str(error))
                if following_ns is None:
                    return

    def _rows(
        self, numbers: Sequence[int], start_ns: int, end_ns: int, newest_first: bool
    ) -> Iterator[tuple[int, tuple[str, Sample] | None]]:
        """Time and message of each row; None where its data cannot be unpacked."""
        order = "DESC" if newest_first else "ASC"
        statement = (
            "SELECT topic_id, timestamp, data FROM messages WHERE timestamp >= ? AND timestamp < ? "
            f"AND topic_id IN ({','.join('?' * len(numbers))}) ORDER BY timestamp {order}, id {order}"
        )
        with closing(self._database.cursor()) as cursor:
            for number, at_ns, data in cursor.execute(statement, (start_ns, end_ns, *numbers)):
                name = self._names[number]
                try:
                    body = unzstd(data) if self._compressed else bytes(data)
                except (Damaged, TypeError) as error:
                    self._note(f"a message of {named(name)} at {iso_time(at_ns)} cannot be read: {error}")
                    self.holes.append(Hole(at_ns, at_ns, frozenset((name,))))
                    yield at_ns, None
                    continue
                yield at_ns, (name, Sample(int(at_ns), 0, None, body))

    def _beyond(self, numbers: Sequence[int], start_ns: int, end_ns: int, newest_first: bool) -> int | None:
        """The time of the first message that can be read again beyond damage at the start (or the end) of that time."""

        def found(away_ns: int) -> int | None:
            """The first message that is so far away, or None where there is no more; raises where it is damaged."""
            span = (start_ns, end_ns - away_ns) if newest_first else (start_ns + away_ns, end_ns)
            return next((at_ns for at_ns, _ in self._rows(numbers, *span, newest_first)), None)

        first_ns, last_ns = self._within(start_ns, end_ns)
        if newest_first:
            end_ns = last_ns
        else:
            start_ns = first_ns
        damaged_ns, step_ns = 0, 1
        best: int | None = None
        while best is None:  # ever further, until a message can be read
            try:
                best = found(step_ns)
            except sqlite3.Error:
                damaged_ns, step_ns = step_ns, 2 * step_ns
                continue
            if best is None:
                return None
        whole_ns = step_ns
        while whole_ns - damaged_ns > 1:  # and back, to where the damage ends
            middle_ns = (damaged_ns + whole_ns) // 2
            try:
                nearer = found(middle_ns)
                best, whole_ns = best if nearer is None else nearer, middle_ns
            except sqlite3.Error:
                damaged_ns = middle_ns
        return best

    def _within(self, start_ns: int, end_ns: int) -> tuple[int, int]:
        """A span as far as there are messages."""
        first_ns, last_ns = self.times or (start_ns, end_ns)
        return max(start_ns, first_ns), max(min(end_ns, last_ns + 1), start_ns)

    def check(self, until_s: float) -> bool:
        """Reads on, to find damage, until that steady time; whether all has been read."""
        if self._unchecked is None:
            self._unchecked = self.messages(Span())
        return all(monotonic() < until_s for _ in self._unchecked)

    def close(self) -> None:
        """Closes the file."""
        self._database.close()
        if self._whole:
            self._whole.close()

    def _read_topics(self) -> tuple[dict[int, str], Mapping[str, StoredTopic]]:
        """Names by the file's numbers, and topics by name.

        The first distributions kept no QoS, and only Iron and later keep definitions.
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
            if name in topics and topics[name].type != kind:
                self.problems.append(
                    f"{self.path.name}: {named(name)} has several types; only {named(topics[name].type)} is read."
                )
                continue
            encoding, text = definitions.get(kind, ("", ""))
            names[number] = name
            topics[name] = StoredTopic(
                name, kind, encoding=encoding, definition=text, qos=profiles or "", serialization=serialization
            )
        return names, topics

    def _columns(self, table: str) -> set[str]:
        """The names of the table's columns; empty where there is no such table."""
        return {row[1] for row in self._database.execute(f"PRAGMA table_info({table})")}

    def _note_hole(self, hole: Hole, error: str) -> None:
        if hole not in self.holes:
            self.holes.append(hole)
        self._note(f"{hole.words}: {error}")

    def _note(self, problem: str) -> None:
        text = f"{self.path.name}: {problem}."
        if len(self.problems) < MOST_PROBLEMS and text not in self.problems:
            self.problems.append(text)


def _connect(path: Path) -> sqlite3.Connection:
    """A connection that writes nothing, also where the folder is read-only."""
    uri = path.resolve().as_uri()
    try:
        database = sqlite3.connect(f"{uri}?mode=ro", _BUSY_S, uri=True, check_same_thread=False)
        database.execute("SELECT 1 FROM topics LIMIT 1").fetchone()
    except sqlite3.OperationalError:
        # SQLite wants to write to a journal (WAL) beside the file even to read it; `immutable` does without.
        database = sqlite3.connect(f"{uri}?immutable=1", _BUSY_S, uri=True, check_same_thread=False)
    database.text_factory = partial(str, encoding="utf-8", errors="replace")
    return database


def _decompressed(path: Path) -> Any:
    whole = tempfile.NamedTemporaryFile(prefix="ros2-mcp-", suffix=".db3")  # noqa: SIM115
    try:
        with path.open("rb") as packed:
            zstandard.ZstdDecompressor().copy_stream(packed, whole)
        whole.flush()
    except zstandard.ZstdError as error:
        whole.close()
        raise BadData(f"{path.name} cannot be decompressed: {error}.") from error
    return whole
