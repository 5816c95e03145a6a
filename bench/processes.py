"""The processes of a run: the servers that are measured, and the nodes that they are measured with."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path
from types import TracebackType

from . import slowed
from .stdio import StdioClient

HERE = Path(__file__).parent
FLOORS = ("floor", "drained", "recorder")
"""The peers that do the server's work in bare rclpy; they are slowed down like the server."""
ENVIRONMENT = {
    "ROS_DOMAIN_ID": str(100 + os.getpid() % 100),
    "ROS_LOG_DIR": tempfile.gettempdir(),
    **os.environ,
    "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST",
}
# Users' machines compile once; without bytecode files every start of a server takes 0.6 s longer.
ENVIRONMENT.pop("PYTHONDONTWRITEBYTECODE", None)


def ours(*options: str) -> StdioClient:
    """Return a client of this project's server."""
    return StdioClient(slowed.command([sys.executable, "-m", "ros2_mcp", *options]), ENVIRONMENT)


def trivial() -> StdioClient:
    """Return a client of a trivial tool on the bare SDK."""
    return StdioClient(slowed.command([sys.executable, str(HERE / "trivial.py")]), ENVIRONMENT)


class Peer:
    """A node of `peers.py` in a process of its own; use as a context manager."""

    def __init__(self, role: str, *arguments: object, prefixes: Sequence[Path] = ()) -> None:
        command = [sys.executable, str(HERE / "peers.py"), role, *map(str, arguments)]
        if role in FLOORS:
            command = slowed.command(command)
        packages = [str(prefix / "site-packages") for prefix in prefixes]
        known = {
            "PYTHONPATH": os.pathsep.join(filter(None, [*packages, os.environ.get("PYTHONPATH")])),
            "AMENT_PREFIX_PATH": os.pathsep.join([*map(str, prefixes), sys.prefix]),
        }
        environment = {**ENVIRONMENT, **(known if prefixes else {})}
        self._process = subprocess.Popen(
            command, env=environment, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
        )
        while (line := self.line()) != "ready":  # Fast DDS writes its warnings to stdout, too
            assert self._process.poll() is None, line
            print(line, file=sys.stderr)

    def __enter__(self) -> Peer:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._process.terminate()
        self._process.communicate(timeout=10)

    @property
    def pid(self) -> int:
        return self._process.pid

    def line(self) -> str:
        return self._process.stdout.readline().strip()  # type: ignore[union-attr]

    def tell(self, what: str) -> None:
        """Send a line that has no answer."""
        self._process.stdin.write(f"{what}\n")  # type: ignore[union-attr]
        self._process.stdin.flush()  # type: ignore[union-attr]

    def ask(self, what: str) -> str:
        """Send a line and return the answer."""
        self.tell(what)
        return self.line()

    def seconds(self, what: str, count: int) -> list[float]:
        """Let the node do something `count` times with bare rclpy; return the times in s."""
        return json.loads(self.ask(f"{what} {count}"))


def rss_bytes(pid: int) -> int:
    """Return the resident memory of a process."""
    return int(Path(f"/proc/{pid}/statm").read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE")


def cpu_seconds(pid: int) -> float:
    """Return the CPU time of a process so far, to the nanosecond: the sum over its threads."""
    total_ns = 0
    for task in Path(f"/proc/{pid}/task").iterdir():
        with suppress(FileNotFoundError):  # a thread that has just ended
            total_ns += int((task / "schedstat").read_text().split()[0])
    return total_ns / 1e9


def counts(pid: int) -> tuple[int, int]:
    """Return the numbers of threads and open files of a process."""
    return len(list(Path(f"/proc/{pid}/task").iterdir())), len(list(Path(f"/proc/{pid}/fd").iterdir()))
