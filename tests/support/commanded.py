"""An independent node that the tests command: one JSON list per line in, one JSON value per line out."""

from __future__ import annotations

import json
import subprocess
from collections.abc import Callable, Sequence
from contextlib import suppress
from typing import Any

from support.processes import peer_command

COLOUR = "\x1b["


class CommandedProcess:
    """The commands of a script, each a method: `peer.listen(topic="/said", kind="std_msgs/msg/String")`."""

    def __init__(self, script: str, environment: dict[str, str], before: Sequence[str] = ()) -> None:
        self._process = subprocess.Popen(
            [*before, *peer_command(script)],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
            env=environment,
        )
        assert self._answer() == "ready"

    def __getattr__(self, command: str) -> Callable[..., Any]:
        def ask(**arguments: Any) -> Any:
            assert self._process.stdin
            self._process.stdin.write(json.dumps([command, arguments]) + "\n")
            self._process.stdin.flush()
            return self._answer()

        return ask

    @property
    def pid(self) -> int:
        """Of its process."""
        return self._process.pid

    def end(self) -> None:
        """Let it go, and see that it went."""
        self._process.communicate(timeout=20)
        assert self._process.returncode == 0

    def end_or_kill(self) -> None:
        """Let it go if it lives, and end it if it does not go."""
        with suppress(subprocess.TimeoutExpired, BrokenPipeError):
            self._process.communicate(timeout=10)
        self.kill()

    def kill(self) -> None:
        """End it without its saying goodbye to ROS."""
        self._process.kill()
        self._process.communicate(timeout=20)

    def _answer(self) -> Any:
        assert self._process.stdout
        line = self._process.stdout.readline()
        while line.startswith(COLOUR):  # what Fast DDS complains about stands there, too
            line = self._process.stdout.readline()
        assert line, "the peer died"
        return json.loads(line)
