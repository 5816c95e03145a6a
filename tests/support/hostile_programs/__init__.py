"""Hostile programs as data: what a fooled model might give to `ros2_program_run`, in files of text beside this one.

In them `=== name` begins a program, `<U+202E>` is one character, and words between @ stand for a `Trap`.
"""

from __future__ import annotations

import re
import secrets
import socket
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from support.outlets import FORGED

VARIABLE = "ROS2_MCP_TEST_SECRET"
"""A variable of the server's environment that has the trap's secret."""
_NAME = re.compile(r"^=== (.+)\n", re.MULTILINE)
_CHARACTER = re.compile(r"<U\+([0-9A-F]{4,6})>")


def _programs(file: Path) -> Iterator[tuple[str, str]]:
    _, *parts = _NAME.split(file.read_text(encoding="utf-8"))
    for name, text in zip(parts[::2], parts[1::2], strict=True):
        yield name, _CHARACTER.sub(lambda found: chr(int(found[1], 16)), text)


FILES = tuple(sorted(Path(__file__).parent.glob("*.txt")))
PROGRAMS: Mapping[str, str] = {f"{file.stem}: {name}": text for file in FILES for name, text in _programs(file)}
"""Each program by its kind and name."""


@dataclass(frozen=True)
class Trap:
    """What a program would touch if it reached the host: a folder with a secret, and a port that waits."""

    folder: Path
    secret: str
    listener: socket.socket

    def environment(self) -> dict[str, str]:
        """What the server's environment gets."""
        return {VARIABLE: self.secret}

    def set_for(self, program: str, pid: int, topic: str = "/cmd_vel") -> str:
        """The program with the trap's paths, port and variable, the server's process, and a velocity topic."""
        words = {
            "SECRET": self.folder / "secret",
            "MARKER": self.folder / "marker",
            "FOLDER": self.folder,
            "CWD": Path.cwd(),
            "PORT": self.listener.getsockname()[1],
            "VARIABLE": VARIABLE,
            "PID": pid,
            "FORGED": FORGED,
            "TOKEN": "reached",
            "TOPIC": topic,
        }
        return re.sub(r"@([A-Z]+)@", lambda found: str(words[found[1]]), program)

    def sprung(self, said: str) -> list[str]:
        """What of the host the program has reached, by what was said and what is to be seen here."""
        found = [f"said the {what}" for what, text in {"secret": self.secret}.items() if text in said]
        if sorted(each.name for each in self.folder.iterdir()) != ["planted.py", "secret"]:
            found.append("changed the folder")
        elif (self.folder / "secret").read_text() != self.secret:
            found.append("changed the secret")
        try:
            self.listener.accept()[0].close()
            found.append("opened a connection")
        except BlockingIOError:
            pass
        return found


@contextmanager
def trap(folder: Path) -> Iterator[Trap]:
    """A trap in a folder that is empty."""
    secret = secrets.token_hex(16)
    (folder / "secret").write_text(secret)
    (folder / "planted.py").write_text(f"open({str(folder / 'marker')!r}, 'w')\n")
    with socket.create_server(("127.0.0.1", 0)) as listener:
        listener.setblocking(False)
        yield Trap(folder, secret, listener)
