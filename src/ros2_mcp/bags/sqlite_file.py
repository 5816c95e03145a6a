"""Reads one SQLite file of rosbag2, of any distribution."""

from __future__ import annotations

import sqlite3
import tempfile
from collections.abc import Iterator, Mapping
from contextlib import closing
from functools import partial
from pathlib import Path
from typing import Any

import zstandard

from ros2_mcp.bags.chunks import Damaged, unzstd
from ros2_mcp.bags.stored import FOREVER, Span, StoredTopic
from ros2_mcp.model.errors import BadData
from ros2_mcp.model.samples import Sample
from ros2_mcp.model.text import named

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
        self._compressed = compression == "message"
        self._whole = _decompressed(path) if compression == "file" else None
        try:
            self._database = _connect(Path(self._whole.name) if self._whole else path)
            self._names, self.topics = self._read_topics()
            row = self._database.execute("SELECT min(timestamp), max(timestamp) FROM messages").fetchone()
        except sqlite3.Error as error:
            raise BadData(f"{path.name} cannot be read: {error}.") from error
        self.times: tuple[int, int] | None = None if row[0] is None else (int(row[0]), int(row[1]))

    @property
    def count(self) -> int | None:
        """How many messages there are; None where damage keeps SQLite from counting."""
        try:
            return int(self._database.execute("SELECT count(*) FROM messages").fetchone()[0])
        except sqlite3.Error as error:
            self._note(error)
            return None

    def counts(self) -> dict[str, int]:
        """Messages of each topic. Reads an entry of each message."""
        try:
            rows = self._database.execute("SELECT topic_id, count(*) FROM messages GROUP BY topic_id").fetchall()
        except sqlite3.Error as error:
            self._note(error)
            return {}
        return {self._names[number]: int(count) for number, count in rows if number in self._names}

    def messages(self, span: Span, newest_first: bool = False) -> Iterator[tuple[str, Sample]]:
        """Topic and message in the order of time, as far as the file can be read."""
        ids = [number for number, name in self._names.items() if span.topics is None or name in span.topics]
        if not ids:
            return
        order = "DESC" if newest_first else "ASC"
        statement = (
            "SELECT topic_id, timestamp, data FROM messages WHERE timestamp >= ? AND timestamp < ? "
            f"AND topic_id IN ({','.join('?' * len(ids))}) ORDER BY timestamp {order}, id {order}"
        )
        try:
            with closing(self._database.cursor()) as cursor:
                for number, at_ns, data in cursor.execute(statement, (span.start_ns, min(span.end_ns, FOREVER), *ids)):
                    try:
                        body = unzstd(data) if self._compressed else bytes(data)
                    except (Damaged, TypeError) as error:
                        self.problems.append(f"{self.path.name}: a message at {at_ns} cannot be read: {error}.")
                        continue
                    yield self._names[number], Sample(int(at_ns), 0, None, body)
        except sqlite3.Error as error:
            self._note(error)

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

    def _note(self, error: sqlite3.Error) -> None:
        text = f"{self.path.name}: what follows is lost: {error}."
        if text not in self.problems:
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
