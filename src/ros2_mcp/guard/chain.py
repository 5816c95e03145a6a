"""The lines of the audit and the chain of hashes over them: one function makes a line, another verifies the chain.

A line is a JSON object that begins with its number and the hash of the line before, and ends with its own hash, which
is SHA-256 over everything before that hash. A line therefore cannot be changed, removed, inserted or moved unnoticed,
except for the last lines; the head (`audit.head`) records how many lines there are. A user who can write both can make
a new chain: only a copy of the head that is kept elsewhere (`ros2_status` shows the head) reveals that.
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
"""The hash that the first line names as its predecessor."""
_LINE = re.compile(rb'(\{"seq":(\d+),"prev":"([0-9a-f]{64})",[^\n]*),"hash":"([0-9a-f]{64})"\}\n')
_HASH = b',"hash":"'
_TAIL = len(_HASH) + 64 + 3
_DIGEST = slice(-67, -3)
"""The position of the hash in a line: the 64 characters before `"}` and the newline."""
_FILE = re.compile(r"audit-(\d{12})\.jsonl")
_DROPPED, _DAMAGED = b'"dropped_to":', b'"kind":"damage"'
_MOST_FAULTS = 20
"""The most faults that are reported: one changed file may have thousands."""


@dataclass(frozen=True, slots=True)
class Head:
    """The end of the chain: number and hash of the last line, the name of its file, and the length of that file in
    bytes.
    """

    seq: int = 0
    hash: str = GENESIS
    file: str = ""
    bytes: int = 0

    @property
    def short(self) -> str:
        """A short form that a person can copy and compare: `1234:3f2a91c077ab1234`."""
        return f"{self.seq}:{self.hash[:16]}"


@dataclass(slots=True)
class Verdict:
    """The result of `verify`: `faults` are signs of changes, `notes` the harmless traces of a killed server."""

    lines: int = 0
    files: int = 0
    head: Head = field(default_factory=Head)
    faults: list[str] = field(default_factory=list[str])
    notes: list[str] = field(default_factory=list[str])


def line_of(seq: int, prev: str, fields: Mapping[str, Any]) -> tuple[bytes, str]:
    """Return one line as it is written, and its hash. The line is ASCII, so that no character in it is invisible."""
    text = json.dumps(fields, ensure_ascii=True, separators=(",", ":"), default=str)
    body = f'{{"seq":{seq},"prev":"{prev}",{text[1:-1]}'.encode()
    digest = hashlib.sha256(body).hexdigest()
    return body + f',"hash":"{digest}"}}\n'.encode(), digest


def file_name(first_seq: int) -> str:
    """Return the name of the file whose first line has this number."""
    return f"audit-{first_seq:012d}.jsonl"


def files_of(folder: Path) -> list[Path]:
    """Return the files of an audit, oldest first."""
    return sorted(path for path in folder.glob("audit-*.jsonl") if _FILE.fullmatch(path.name))


def read_head(folder: Path) -> Head | None:
    """Return the head; None if it is missing or cannot be read."""
    try:
        return parse_head((folder / HEAD).read_bytes())
    except OSError:
        return None


def parse_head(data: bytes) -> Head | None:
    """Parse the head; None if the bytes are no head."""
    try:
        found = json.loads(data)
        return Head(int(found["seq"]), str(found["hash"]), str(found["file"]), int(found["bytes"]))
    except (ValueError, KeyError, TypeError, OverflowError):
        return None


def follows(line: bytes, head: Head) -> Head | None:
    """Return the head after this whole line; None if the line is not the next of the chain. The caller sets `file` and
    `bytes`.
    """
    match = _LINE.fullmatch(line)
    if not match or int(match[2]) != head.seq + 1 or match[3].decode() != head.hash:
        return None
    digest = match[4].decode()
    return Head(head.seq + 1, digest) if hashlib.sha256(match[1]).hexdigest() == digest else None


def verify(folder: Path, copied: str = "", most: int = _MOST_FAULTS) -> Verdict:
    """Verify a whole audit and return the verdict.

    Args:
        folder: the folder of the audit.
        copied: a head that was copied earlier (`1234:3f2a91c077ab1234`); the line with that hash must still exist.
        most: the number of faults after which verification ends.
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
    """The state of one verification."""

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
        """Verify the lines of one file, each against the line before it."""
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
        ):  # nearly all lines take this fast path; the code below finds the fault in the others
            verdict.lines += 1
            verdict.head = Head(last.seq + 1, digest.decode())
            return
        match = _LINE.fullmatch(line)
        if not match:
            verdict.faults.append(f"{place} is not a line of an audit: it was changed.")
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
        """Evaluate a line of the writer about its files. A line of another kind that only contains such text is
        ignored.
        """
        entry = _entry(body + b"}")
        if entry.get("kind") == "rotation":
            self._dropped |= {int(last) for last in [entry.get("dropped_to", 0)] if isinstance(last, int)}
        elif entry.get("kind") == "damage":
            self._verdict.faults.append(f"{place}: the server found damage when it went on: {entry.get('what')}.")

    def judge_ends(self, head: Head | None, any_file: bool) -> None:
        """Check the beginning and the end: the chain itself protects neither."""
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
    """Parse a line; an empty mapping if it is no JSON object (`verify` reports this)."""
    try:
        entry = json.loads(line)
    except (ValueError, RecursionError):
        return {}
    return cast("Mapping[str, Any]", entry) if isinstance(entry, dict) else {}


def entries(folder: Path) -> Iterator[Mapping[str, Any]]:
    """Yield every readable line, oldest first."""
    for path in files_of(folder):
        with path.open("rb") as file:
            yield from filter(None, map(_entry, file))


def newest(folder: Path) -> Iterator[Mapping[str, Any]]:
    """Yield every readable line, newest first. Reads a whole file at a time."""
    for path in reversed(files_of(folder)):
        yield from filter(None, map(_entry, reversed(path.read_bytes().splitlines())))


def tail(folder: Path, most_bytes: int) -> list[Mapping[str, Any]]:
    """Return the last lines, oldest first, from the last `most_bytes` bytes of the newest file that has readable lines
    there.
    """
    for path in reversed(files_of(folder)):
        with path.open("rb") as file:
            file.seek(0, 2)
            start = max(0, file.tell() - most_bytes)
            file.seek(start)
            lines = file.read().splitlines()
        if found := [entry for entry in map(_entry, lines[1:] if start else lines) if entry]:
            return found
    return []
