"""The lines of the audit and the chain of hashes over them: made by one function, judged by another.

A line is a JSON object that begins with its number and the hash of the line before, and ends with its own hash, which
is SHA-256 over all that stands before it. So no line can be changed, left out, added or moved unseen, but the last
ones; of those the head (`audit.head`) knows how many there are. Who can write both files can make a new chain: a head
that was copied elsewhere (`ros2_status` shows it) tells that, too.
"""

from __future__ import annotations

import hashlib
import json
import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, cast

HEAD = "audit.head"
GENESIS = "0" * 64
"""Stands for the hash of the line before the first."""
_LINE = re.compile(rb'(\{"seq":(\d+),"prev":"([0-9a-f]{64})",[^\n]*),"hash":"([0-9a-f]{64})"\}\n')
_HASH = b',"hash":"'
_TAIL = len(_HASH) + 64 + 3
_DIGEST = slice(-67, -3)
"""Where the hash is in a line: 64 characters before `"}` and the new line."""
_FILE = re.compile(r"audit-(\d{12})\.jsonl")
_DROPPED, _DAMAGED = b'"dropped_to":', b'"kind":"damage"'
_MOST_FAULTS = 20
"""Somebody who sees that many knows; one changed file may have thousands."""


@dataclass(frozen=True, slots=True)
class Head:
    """The end of the chain: number and hash of the last line, the file that it is in, and where that ended then."""

    seq: int = 0
    hash: str = GENESIS
    file: str = ""
    bytes: int = 0

    @property
    def short(self) -> str:
        """What a person copies and compares: `1234:3f2a91c077ab1234`."""
        return f"{self.seq}:{self.hash[:16]}"


@dataclass(slots=True)
class Verdict:
    """What `verify` has found: `faults` say what was changed, `notes` what a killed server leaves behind."""

    lines: int = 0
    files: int = 0
    head: Head = field(default_factory=Head)
    faults: list[str] = field(default_factory=list[str])
    notes: list[str] = field(default_factory=list[str])


def line_of(seq: int, prev: str, fields: Mapping[str, Any]) -> tuple[bytes, str]:
    """One line as it is written, and its hash. It is ASCII: nothing in it can hide."""
    text = json.dumps(fields, ensure_ascii=True, separators=(",", ":"), default=str)
    body = f'{{"seq":{seq},"prev":"{prev}",{text[1:-1]}'.encode()
    digest = hashlib.sha256(body).hexdigest()
    return body + f',"hash":"{digest}"}}\n'.encode(), digest


def file_name(first_seq: int) -> str:
    """The name of the file that begins with this line."""
    return f"audit-{first_seq:012d}.jsonl"


def files_of(folder: Path) -> list[Path]:
    """The files of an audit, the oldest first."""
    return sorted(path for path in folder.glob("audit-*.jsonl") if _FILE.fullmatch(path.name))


def read_head(folder: Path) -> Head | None:
    """The head; None if there is none, or it cannot be read."""
    try:
        return parse_head((folder / HEAD).read_bytes())
    except OSError:
        return None


def parse_head(data: bytes) -> Head | None:
    """The head that these bytes are; None if they are none."""
    try:
        found = json.loads(data)
        return Head(int(found["seq"]), str(found["hash"]), str(found["file"]), int(found["bytes"]))
    except (ValueError, KeyError, TypeError, OverflowError):
        return None


def follows(line: bytes, head: Head) -> Head | None:
    """The head after this whole line, if it is the next one of the chain; the file and its size are left to others."""
    match = _LINE.fullmatch(line)
    if not match or int(match[2]) != head.seq + 1 or match[3].decode() != head.hash:
        return None
    digest = match[4].decode()
    return Head(head.seq + 1, digest) if hashlib.sha256(match[1]).hexdigest() == digest else None


def verify(folder: Path, copied: str = "", most: int = _MOST_FAULTS) -> Verdict:
    """Judges a whole audit.

    Args:
        folder: where its files are.
        copied: a head that was copied earlier (`1234:3f2a91c077ab1234`): that line must still be there.
        most: faults after which it ends.
    """
    verdict = Verdict()
    files = files_of(folder)
    verdict.files = len(files)
    chain = _Chain(verdict, copied, most)
    for path in files:
        if len(verdict.faults) >= most:
            return verdict
        chain.read(path)
    if len(verdict.faults) < most:
        chain.judge_ends(read_head(folder), bool(files))
    return verdict


class _Chain:
    """The state of one `verify`."""

    def __init__(self, verdict: Verdict, copied: str, most: int) -> None:
        self._verdict = verdict
        self._copied_seq, _, self._copied_hash = copied.partition(":")
        self._copied_seen = not copied
        self._most = most
        self._first_seq = 0
        self._dropped: set[int] = {0}
        self._cut = 0
        self._ends: dict[int, str] = {}

    def read(self, path: Path) -> None:
        """Judges the lines of one file, each by the one before it."""
        verdict, number = self._verdict, 0
        with path.open("rb") as file:
            for number, line in enumerate(file, 1):
                if not line.endswith(b"\n"):
                    self._cut = len(line)
                    continue
                self._line(line, f"{path.name} line {number}", path if number == 1 else None)
                if len(verdict.faults) >= self._most:
                    return
        if not number:
            verdict.notes.append(f"{path.name} is empty: the server ended before it wrote there.")
        if self._cut and path != files_of(path.parent)[-1]:
            verdict.faults.append(f"{path.name}: its last line is cut.")
            self._cut = 0

    def _line(self, line: bytes, place: str, begins: Path | None) -> None:
        verdict, last = self._verdict, self._verdict.head
        body, digest = line[:-_TAIL], line[_DIGEST]
        if (
            verdict.lines
            and line.startswith(b'{"seq":%d,"prev":"%s",' % (last.seq + 1, last.hash.encode()))
            and line[-_TAIL : _DIGEST.start] == _HASH
            and line[_DIGEST.stop :] == b'"}\n'
            and hashlib.sha256(body).hexdigest().encode() == digest
            and not (begins or _DROPPED in body or _DAMAGED in body)
            and str(last.seq + 1) != self._copied_seq
        ):  # as nearly all are; the rest of this finds out what is wrong with the others
            verdict.lines += 1
            verdict.head = Head(last.seq + 1, digest.decode())
            return
        match = _LINE.fullmatch(line)
        if not match:
            verdict.faults.append(f"{place} is no line of an audit: it was changed.")
            return
        body, seq, prev, digest = match[1], int(match[2]), match[3].decode(), match[4].decode()
        if hashlib.sha256(body).hexdigest() != digest:
            verdict.faults.append(f"{place} (number {seq}) was changed: its hash does not fit.")
        if begins and begins.name != file_name(seq):
            verdict.faults.append(f"{place}: it has number {seq}, which is not where this file begins.")
        if not verdict.lines:
            self._first_seq = seq
            if seq == 1 and prev != GENESIS:
                verdict.faults.append(f"{place}: the first line names another one before it.")
        elif seq != last.seq + 1:
            verdict.faults.append(f"{place}: number {seq} follows {last.seq}: {_gap(last.seq, seq)}.")
        elif prev != last.hash:
            verdict.faults.append(f"{place} (number {seq}) does not follow the line before it: one was exchanged.")
        if _DROPPED in body or _DAMAGED in body:
            self._note_event(body, place)
        if str(seq) == self._copied_seq and digest.startswith(self._copied_hash):
            self._copied_seen = True
        verdict.lines += 1
        verdict.head = Head(seq, digest)

    def _note_event(self, body: bytes, place: str) -> None:
        """What the writer itself said of the files; an act whose text only looks like it says nothing."""
        entry = _entry(body + b"}")
        if entry.get("kind") == "rotation":
            self._dropped |= {int(last) for last in [entry.get("dropped_to", 0)] if isinstance(last, int)}
        elif entry.get("kind") == "damage":
            self._verdict.faults.append(f"{place}: the server found damage when it went on: {entry.get('what')}.")

    def judge_ends(self, head: Head | None, any_file: bool) -> None:
        """Judges what no chain shows: its beginning and its end."""
        verdict, last = self._verdict, self._verdict.head
        if verdict.lines and self._first_seq - 1 not in self._dropped:
            verdict.faults.append(f"It begins with number {self._first_seq}: what was before is missing.")
        if head is None:
            if any_file:
                verdict.faults.append(f"{HEAD} is missing or damaged: lines at the end may be missing.")
        elif last.seq < head.seq:
            verdict.faults.append(f"Lines {last.seq + 1} to {head.seq} are missing at the end.")
        elif last.seq == head.seq and last.hash != head.hash:
            verdict.faults.append(f"The last line is another one than {HEAD} knows.")
        elif last.seq == head.seq + 1:
            verdict.notes.append("The last line came after the head: the server was killed while it wrote it.")
        elif last.seq > head.seq:
            verdict.faults.append(f"Lines {head.seq + 1} to {last.seq} came after {HEAD}: they may be made up.")
        if self._cut:
            verdict.notes.append(f"{self._cut} bytes of a cut line are at the end: the server was killed in it.")
        if not self._copied_seen:
            verdict.faults.append(f"There is no line {self._copied_seq} with the hash {self._copied_hash}.")


def _gap(last: int, seq: int) -> str:
    return f"lines {last + 1} to {seq - 1} are missing" if seq > last else "lines were moved or added"


def _entry(line: bytes) -> Mapping[str, Any]:
    """What a line says; nothing if it is no JSON object: that is left to `verify`."""
    try:
        entry = json.loads(line)
    except (ValueError, RecursionError):
        return {}
    return cast("Mapping[str, Any]", entry) if isinstance(entry, dict) else {}


def entries(folder: Path) -> Iterator[Mapping[str, Any]]:
    """Every line that can be read, the oldest first."""
    for path in files_of(folder):
        with path.open("rb") as file:
            yield from filter(None, map(_entry, file))


def newest(folder: Path) -> Iterator[Mapping[str, Any]]:
    """The same, the newest first. Reads a whole file at a time."""
    for path in reversed(files_of(folder)):
        yield from filter(None, map(_entry, reversed(path.read_bytes().splitlines())))


def tail(folder: Path, most_bytes: int) -> list[Mapping[str, Any]]:
    """The last lines, the oldest first, of the newest file that has some, as far as they are in so many bytes."""
    for path in reversed(files_of(folder)):
        with path.open("rb") as file:
            file.seek(0, 2)
            start = max(0, file.tell() - most_bytes)
            file.seek(start)
            lines = file.read().splitlines()
        if found := [entry for entry in map(_entry, lines[1:] if start else lines) if entry]:
            return found
    return []
