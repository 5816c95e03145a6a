"""The peers of the tests: processes of `commands_peer.py`."""

from __future__ import annotations

import contextlib
import itertools
import json
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

from agent import Agent

HERE = Path(__file__).parent
_NUMBERS = itertools.count(1)


class PeerProcess:
    """`commands_peer.py` under a namespace of its own; its commands are methods: `peer.count(name="switch")`."""

    def __init__(self, environment: dict[str, str], *roles: str, namespace: str = "") -> None:
        self.namespace = namespace or f"/peer{next(_NUMBERS)}"
        self.process = subprocess.Popen(
            [sys.executable, str(HERE / "commands_peer.py"), self.namespace, *roles],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
            env=environment,
        )

    def ready(self) -> PeerProcess:
        """Wait until it offers what it has to offer."""
        assert self._answer() == "ready"
        return self

    def name(self, relative: str) -> str:
        """The full name of something that it offers."""
        return f"{self.namespace}/{relative}"

    def __getattr__(self, command: str) -> Callable[..., Any]:
        def ask(**arguments: Any) -> Any:
            assert self.process.stdin
            self.process.stdin.write(json.dumps([command, arguments]) + "\n")
            self.process.stdin.flush()
            return self._answer()

        return ask

    def leave(self) -> None:
        """Let it end as a ROS node should."""
        if self.process.poll() is None:
            assert self.process.stdin
            self.process.stdin.close()
            self.process.wait(10)
        self._close()

    def kill(self) -> None:
        """End it without its saying goodbye to ROS."""
        self.process.send_signal(signal.SIGKILL)
        self.process.wait(5)
        self._close()

    def _close(self) -> None:
        for pipe in (self.process.stdin, self.process.stdout):
            assert pipe
            with contextlib.suppress(OSError):
                pipe.close()

    def _answer(self) -> Any:
        assert self.process.stdout
        line = self.process.stdout.readline()
        assert line, "the peer died"
        return json.loads(line)


def discovered(agent: Agent, peer: PeerProcess) -> PeerProcess:
    """The peer, as soon as the server under test knows all that it offers."""
    deadline = time.monotonic() + 10
    while not agent.call("ros2_service_list", pattern=peer.name("there"))["services"]:
        assert time.monotonic() < deadline, "not discovered"
        time.sleep(0.05)
    return peer
