"""The robot to which things happen, as the tests command it."""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any


class EventsPeer:
    """The commands of `events_peer.py`, each a method: `events.say(text="hello")`."""

    def __init__(self, environment: dict[str, str]) -> None:
        script = Path(__file__).parent / "events_peer.py"
        self._process = subprocess.Popen(
            [sys.executable, str(script)], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, env=environment
        )
        assert self._answer() == "ready"

    def __getattr__(self, command: str) -> Callable[..., Any]:
        def ask(**arguments: Any) -> Any:
            assert self._process.stdin
            self._process.stdin.write(json.dumps([command, arguments]) + "\n")
            self._process.stdin.flush()
            return self._answer()

        return ask

    def end(self) -> None:
        """Let it go."""
        self._process.kill()
        self._process.communicate(timeout=5)

    def _answer(self) -> Any:
        assert self._process.stdout
        line = self._process.stdout.readline()
        assert line, "the peer died"
        return json.loads(line)
