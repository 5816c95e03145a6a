"""A far side without a network: a machine of bubblewrap's, in which nothing can be written, and an engine's client."""

from __future__ import annotations

import os
import shlex
import shutil
import signal
import subprocess
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path

import pytest

from ros2_mcp.link.bootstrap import Bootstrap
from support.bridge_client import PATIENCE_S, Client

OWN_PYTHON = sys.executable
"""Of the tests: the only one here that has rclpy; a far side is told its path, as a user would tell it."""


def read_only_machine(*more: str, home: Path | None = None) -> tuple[str, ...]:
    """A way in to a machine with this one's files, none of which can be written, and processes of its own."""
    bwrap = shutil.which("bwrap")
    if not bwrap:
        pytest.skip("needs bubblewrap")
    at_home = ("--bind", str(home), str(home), "--setenv", "HOME", str(home), "--chdir", str(home)) if home else ()
    words = (bwrap, "--ro-bind", "/", "/", "--dev", "/dev", "--proc", "/proc", "--unshare-pid", "--die-with-parent")
    if subprocess.run([*words, "--", "true"], capture_output=True, check=False).returncode != 0:
        pytest.skip("this user or machine may not make the namespaces of bubblewrap")
    return (*words, *at_home, *more, "--")


def bare(env: dict[str, str], **changed: str) -> dict[str, str]:
    """What a login over ssh has of an environment: nothing of a sourced shell, and of ROS only how far it is seen."""
    kept = ("ROS_AUTOMATIC_DISCOVERY_RANGE", "FASTRTPS_DEFAULT_PROFILES_FILE", "HOME")
    return {"PATH": os.defpath, **{name: env[name] for name in kept if name in env}, **changed}


@contextmanager
def begun(start: Bootstrap, env: dict[str, str]) -> Iterator[subprocess.Popen[bytes]]:
    """The way in as a process, which was sent everything; it has ended when this ends."""
    with subprocess.Popen(start.argv, env=env, stdin=subprocess.PIPE, stdout=subprocess.PIPE, bufsize=0) as process:
        assert process.stdin
        try:
            with suppress(BrokenPipeError):  # stage 1 has no use for the rest where it fails
                rest = memoryview(start.pack())
                while rest:
                    rest = rest[process.stdin.write(rest) or 0 :]
            yield process
        finally:
            process.stdin.close()
            try:
                process.wait(PATIENCE_S)
            except subprocess.TimeoutExpired:
                process.kill()


@contextmanager
def sent_bridge(start: Bootstrap, env: dict[str, str]) -> Iterator[Client]:
    """A client of the bridge that was sent."""
    with begun(start, env) as process:
        yield Client(process, start.arrival.feed)


def engine(folder: Path, enter: Sequence[str]) -> Path:
    """A folder with a `docker` that has the containers `ros` (entered by these words) and `idle`; returns it."""
    tools = folder / "tools"
    tools.mkdir()
    program = tools / "docker"
    program.write_text(DOCKER.replace("@ENTER@", shlex.join(enter)))
    program.chmod(0o755)
    return tools


DOCKER = """#!/bin/sh
case "$1 $6 $3" in
ps*) printf 'ros\\nother\\n' ;;
"inspect ros "*) echo true ;;
"inspect idle "*) echo false ;;
"inspect denied "*) echo "permission denied while trying to connect to the docker API" >&2; exit 1 ;;
"inspect gone "*) echo "Cannot connect to the Docker daemon?" >&2; exit 1 ;;
inspect*) echo "Error: No such container: $6" >&2; exit 1 ;;
exec*"ros") shift 3; exec @ENTER@ "$@" ;;
*) exit 125 ;;
esac
"""


class SurvivingEngine:
    """An engine whose `docker exec` starts what goes on without it, with an input whose end nobody sees."""

    def __init__(self, folder: Path, enter: Sequence[str]) -> None:
        folder.mkdir()
        self.program = folder / "docker"
        self._holder = folder / "holder"
        stream = shlex.quote(str(folder / "stream"))
        self.program.write_text(
            "\n".join(
                [
                    "#!/bin/sh",
                    "shift 3",
                    f"mkfifo {stream}",
                    f"setsid sleep 1000 3<>{stream} >/dev/null 2>&1 &",
                    f"echo $! >{shlex.quote(str(self._holder))}",
                    f'setsid {shlex.join(enter)} "$@" <{stream} &',
                    f"exec cat >{stream}",
                    "",
                ]
            )
        )
        self.program.chmod(0o755)

    def end(self) -> None:
        """Ends what would hold the stream open, as the end of the container would."""
        with suppress(FileNotFoundError, ProcessLookupError):
            os.kill(int(self._holder.read_text()), signal.SIGKILL)
