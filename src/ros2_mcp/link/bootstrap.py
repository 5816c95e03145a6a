"""Start a bridge where nothing is installed: the program to execute, the bytes to send, and the replies before the
stream.

A way in is a program that gives the standard streams of a shell on the far side: ssh, a container engine's client, or
any other. Its words are completed by two programs in single quotes, which every login shell passes on unchanged: a
shell script that looks for python3, and a line of Python that executes stage 1 (`ros2_mcp_common/start/stage1.py`).
Stage 1 comes on stdin, followed by the bridge as a zip. See
docs/decisions/0034-the-bridge-is-sent-and-not-installed.md.
"""

from __future__ import annotations

import base64
import io
import json
import re
import secrets
import zipfile
import zlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path
from typing import Any

import ros2_mcp_bridge
import ros2_mcp_common
from ros2_mcp.model.errors import LinkError
from ros2_mcp.model.text import quoted
from ros2_mcp_common.start import stage1
from ros2_mcp_common.start.finding import Search

PACKAGE = ros2_mcp_bridge.__name__
_SOURCES = tuple(Path(str(package.__file__)).parent for package in (ros2_mcp_bridge, ros2_mcp_common))
_NO_PYTHON, _IS_TERMINAL = 97, 96
# The exit codes of shells for a program that cannot be executed (126) or found (127).
_NO_SHELL = (126, 127)
# The script has no single quote, backslash, exclamation mark or newline, so that every shell accepts it in single
# quotes. `python3 -IS`: neither the working folder nor installed packages can interfere with stage 1. A python3 among a
# version switcher's shims is tested first, because it fails with 127 if its version is not selected. The test takes as
# long as a Python starts, 20 ms.
_SCRIPT = (
    f"[ -t 0 ] && exit {_IS_TERMINAL}; "
    "for p in python3 /usr/bin/python3 ~/*conda3/bin/python3 ~/*forge3/bin/python3 /opt/*conda*/bin/python3; do "
    'p=$(command -v "$p" 2>/dev/null) || continue; '
    'case $p in */shims/*) "$p" -ISc "" </dev/null >/dev/null 2>&1 || continue;; esac; '
    f'exec "$p" -ISc "$0"; done; exit {_NO_PYTHON}'
)
# The alarm ends the program if nothing arrives for 30 s; stage 1 continues with the same alarm.
_PYTHON = (
    "import base64,signal,sys,zlib;signal.alarm(30);"
    "line=sys.stdin.buffer.raw.readline();exec(zlib.decompress(base64.b64decode(line)))"
)
WORDS = ("sh", "-c", f":; exec sh -c '{_SCRIPT}' '{_PYTHON}'")
"""The words that follow the words of a way in. A way in that executes words (docker, kubectl) runs `sh` with this
script. A way in that joins the words for a shell (ssh, adb) runs `sh -c :`, which does nothing, and then the rest,
which is the same.
"""

# Text without effect in a program: comment lines, and docstrings that begin and end on their own lines.
_COMMENT = re.compile(r"^[ \t]*#.*$", re.MULTILINE)
_DOCSTRING = re.compile(r'^( *)"""(?:[^"\\]|"(?!""))*"""$', re.MULTILINE)

# The most output of a login before the marker. A program that prints more without the marker is no login.
_MOST_NOISE_BYTES = 64 * 1024
# The longest sentence of stage 1, in characters: it lists what it has found.
_MOST_SENTENCE = 600
# The longest line of stage 1: a path may have 4 kB.
_MOST_REPORT_BYTES = 64 * 1024


@dataclass(frozen=True, slots=True)
class Report:
    """One line of stage 1: the stage that was reached (`reached`, `container`, `found`, `bridge`), and its details."""

    stage: str
    details: dict[str, str]


@dataclass(slots=True)
class Arrival:
    """The reader of the bytes from the far side: separates noise, reports of stage 1, and the stream."""

    nonce: str
    reports: list[Report] = field(default_factory=list[Report])
    noise: bytes = b""
    is_through: bool = False
    """Whether the bytes from now on belong to the bridge's stream."""
    failure: LinkError | None = None
    """The reason of stage 1 if there will be no stream."""
    _waiting: bytes = b""

    @property
    def heard(self) -> str:
        """The text before the first marker: the noise, and bytes that may still become a marker."""
        return (self.noise if self.reports else self.noise + self._waiting).decode(errors="replace").strip()

    def feed(self, piece: bytes) -> bytes:
        """Return the part of these bytes that belongs to the stream; empty until the last marker has arrived."""
        if self.is_through:
            return piece
        self._waiting += piece
        marker = stage1.MARKER + self.nonce.encode() + b" "
        while not self.is_through and not self.failure:
            noise, found, rest = self._waiting.partition(marker)
            line, ended, behind = rest.partition(b"\n")
            if not found:
                kept = len(marker) - 1  # the beginning of a marker may be among these
                self._hear(noise[:-kept])
                self._waiting = noise[-kept:]
                return b""
            if not ended:
                if len(line) > _MOST_REPORT_BYTES:
                    self._fail("The first line of the reply does not end.")
                return b""
            self._hear(noise)
            self._waiting = behind
            self._take_in(line)
        stream, self._waiting = self._waiting, b""
        return stream if self.is_through else b""

    def _hear(self, noise: bytes) -> None:
        self.noise = (self.noise + noise)[: _MOST_NOISE_BYTES + 1]
        if len(self.noise) > _MOST_NOISE_BYTES:
            self._fail(
                f"The login there printed more than {_MOST_NOISE_BYTES // 1024} kB, and the bridge did not start."
            )

    def _fail(self, message: str) -> None:
        self.failure = LinkError(
            message,
            "A start-up file of that login (.bashrc, .zshenv, …) runs forever, or starts a program that does.",
        )

    def _take_in(self, line: bytes) -> None:
        try:
            told: dict[str, Any] = json.loads(line)
            details = {str(name): str(value) for name, value in told.items()}
            stage = details.pop("stage")
        except (ValueError, KeyError, AttributeError):
            self._fail("The reply does not come from the program that was sent.")
            return
        if stage == "failed":
            self.failure = LinkError(_on_one_line(details.get("message", "")), _on_one_line(details.get("hint", "")))
            return
        self.reports.append(Report(stage, details))
        self.is_through = stage == "bridge"

    def explain(self, exit_code: int | None, log_tail: Sequence[str] = ()) -> LinkError | None:
        """Return why the way in ended before the stream; None if the reason is not known here.

        Args:
            exit_code: the exit code of the way in; None if unknown.
            log_tail: the last lines of its stderr.
        """
        if self.failure:
            return self.failure
        said = next((line for line in reversed(log_tail) if line.strip()), "")
        if "found" in (report.stage for report in self.reports):
            return None  # the bridge or its setup file failed: their own last lines say more
        if exit_code == _IS_TERMINAL:
            return LinkError(
                "The connection is a terminal, which cannot carry a stream of bytes.",
                "Leave out what asks for one: -t of ssh, docker or kubectl.",
            )
        if exit_code == _NO_PYTHON:
            return LinkError(
                "There is no python3 there.", "ROS 2 needs one: is this the right machine, and the right container?"
            )
        if known := _of_an_engine(said):
            return known
        if exit_code in _NO_SHELL:
            return LinkError(
                f"The far side cannot execute a shell: {quoted(said)}",
                "The connection must end in a shell, as ssh and docker exec do.",
            )
        if exit_code == 0:
            return LinkError(
                "The connection ended before the bridge started.",
                "A start-up file of that login (.bashrc, .zshenv, …) may end it, or the login allows only certain "
                "commands.",
            )
        return None


def _on_one_line(text: str) -> str:
    """Return a sentence of stage 1 on one line of bounded length: it contains names of the far side."""
    return " ".join(text.split())[:_MOST_SENTENCE]


def _of_an_engine(said: str) -> LinkError | None:
    """Return the error for a message of a container engine's client; None for other messages."""
    lower = said.lower()
    if "no such container" in lower or "no such exec" in lower:
        return LinkError(f"There is no such container: {quoted(said)}", "docker ps lists the running containers.")
    if "is not running" in lower or "container state improper" in lower:
        return LinkError(f"The container does not run: {quoted(said)}", "Start it: docker start NAME.")
    if "cannot connect to the docker daemon" in lower:
        return LinkError(
            f"The container engine cannot be reached: {quoted(said)}", "Start it, or say with DOCKER_HOST where it is."
        )
    if "permission denied" in lower and ("docker" in lower or "podman" in lower):
        return LinkError(
            f"The container engine denies access: {quoted(said)}",
            "Add this user to the group docker, and log in again.",
        )
    return None


@dataclass(frozen=True, slots=True)
class Bootstrap:
    """One start: the command, the bytes for its stdin, and the reader of its output.

    `pack` makes the bytes. It takes 40 ms, during which the way in can already start.
    """

    argv: tuple[str, ...]
    pack: Callable[[], bytes]
    arrival: Arrival


def bootstrap(way: Sequence[str], search: Search, *, container: str = "", options: Sequence[str] = ()) -> Bootstrap:
    """Return how to start a bridge through this way in.

    Args:
        way: the words of the way in, such as `ssh -- me@robot` or `docker exec -i NAME`.
        search: which ROS to look for on the far side.
        container: the container with ROS on the machine that the way in reaches; "" for none.
        options: the options of the bridge.
    """
    nonce = secrets.token_hex(8)

    def pack() -> bytes:
        outer = _sent(nonce, search, container, ()) if container else b""
        return outer + _sent(nonce, search, "", options)

    return Bootstrap((*way, *WORDS), pack, Arrival(nonce))


def installed(way: Sequence[str], options: Sequence[str] = ()) -> Bootstrap:
    """Return how to start a bridge that is installed on the far side (the ROS package): nothing is sent.

    Args:
        way: the words that start it, and accept further words, such as `ssh me@robot ros2 run ros2_mcp_bridge bridge`.
        options: the options of the bridge.
    """
    nonce = secrets.token_hex(8)
    return Bootstrap((*way, "--arrival", nonce, *options), bytes, Arrival(nonce))


def _sent(nonce: str, search: Search, container: str, options: Sequence[str]) -> bytes:
    archive = b"" if container else packed_bridge()
    head = {
        "nonce": nonce,
        "size": len(archive),
        "container": container,
        "words": WORDS if container else (),
        "search": search.as_json(),
        "options": tuple(options),
    }
    first = base64.b64encode(zlib.compress(bare(Path(stage1.__file__).read_text("utf-8")).encode(), 9))
    return first + b"\n" + json.dumps(head).encode() + b"\n" + archive


@cache
def packed_bridge() -> bytes:
    """Return the bridge as a compressed zip file. Compression as a whole is a fifth smaller than file by file.

    Comments and docstrings are removed: they are a third of the size.
    """
    archive = io.BytesIO()
    with zipfile.ZipFile(archive, "w") as file:
        for folder in _SOURCES:
            for source in sorted(folder.rglob("*.py")):
                name = source.relative_to(folder.parent).as_posix()
                file.writestr(name, bare(source.read_text("utf-8")))
    return zlib.compress(archive.getvalue(), 9)


def bare(source: str) -> str:
    """Return the source of a module without comments and docstrings; line numbers stay the same."""

    def emptied(docstring: re.Match[str]) -> str:
        return f'{docstring[1]}""' + "\n" * docstring[0].count("\n")

    return _DOCSTRING.sub(emptied, _COMMENT.sub("", source))
