"""The server as bytes: JSON-RPC lines written by hand, and every byte of stdout kept."""

from __future__ import annotations

import contextlib
import json
import os
import select
import subprocess
import sys
import tempfile
import time
from contextlib import suppress
from pathlib import Path
from typing import Any

from support.structured import META, result_of

MODERN = "2026-07-28"
CLIENT = {"name": "lines by hand", "version": "1"}
ANSWER_S = 60.0


class RawServer:
    """A server process, and what it has said."""

    def __init__(self, environment: dict[str, str], *options: str, command: list[str] | None = None) -> None:
        self.said = b""
        self.version = ""
        self.last_id = 0
        self._read = 0
        self.errors = tempfile.TemporaryFile()  # noqa: SIM115 - closed with the process
        self.process = subprocess.Popen(
            [*(command or [sys.executable, "-m", "ros2_mcp"]), *options],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=self.errors,
            env=environment,
        )

    def begin(self, version: str) -> dict[str, Any]:
        """Open the connection as the version of the protocol wants it; returns the server's introduction."""
        self.version = version
        if version == MODERN:
            return self.ask("server/discover")["result"]
        asked = {"protocolVersion": version, "capabilities": {}, "clientInfo": CLIENT}
        introduction = self.ask("initialize", **asked)["result"]
        self.tell("notifications/initialized")
        return introduction

    def ask(self, method: str, **params: Any) -> dict[str, Any]:
        """A request and its answer: the whole line."""
        return self.answer(self.send(method, **params))

    def send(self, method: str, **params: Any) -> int:
        """A request; returns its id."""
        if self.version == MODERN:
            prefix = "io.modelcontextprotocol/"
            stamp = {"protocolVersion": MODERN, "clientInfo": CLIENT, "clientCapabilities": {}}
            params["_meta"] = {prefix + name: value for name, value in stamp.items()}
        if method == "tools/call":
            params["_meta"] = {**params.get("_meta", {}), **META}
        return self.send_params(method, params)

    def send_params(self, method: str, params: Any) -> int:
        """A request with these parameters, whatever they are; returns its id."""
        self.last_id += 1
        self._write({"jsonrpc": "2.0", "id": self.last_id, "method": method, "params": params})
        return self.last_id

    def tell(self, method: str, **params: Any) -> None:
        """A notification."""
        self._write({"jsonrpc": "2.0", "method": method, "params": params})

    def answer(self, request: int, within_s: float = ANSWER_S) -> dict[str, Any]:
        """Wait for the answer to a request."""
        deadline = time.monotonic() + within_s
        while (left := deadline - time.monotonic()) > 0:
            for line in self.lines():
                if line.get("id") == request and "method" not in line:
                    return line
            self._listen(left)
        raise AssertionError(f"no answer to request {request} within {within_s} s; stdout was {self.said[-500:]!r}")

    def call(self, tool: str, **arguments: Any) -> dict[str, Any]:
        """The result of a tool, error or not; empty fields of structured content can be read, too."""
        result = self.ask("tools/call", name=tool, arguments=arguments)["result"]
        return {**result, "structuredContent": result_of(tool, result)} if "structuredContent" in result else result

    def write(self, data: bytes) -> None:
        """Bytes, as they are."""
        assert self.process.stdin
        self.process.stdin.write(data)
        self.process.stdin.flush()

    def wait_for_answers(self, number: int, within_s: float = ANSWER_S) -> None:
        """Wait until so many answers are there, or for so long."""
        deadline = time.monotonic() + within_s
        while (left := deadline - time.monotonic()) > 0:
            if self.said.count(b"\n") >= number and len(self.answers()) >= number:
                return
            self._listen(left)

    def answers(self) -> list[dict[str, Any]]:
        """Every answer so far."""
        return [line for line in self.lines() if "method" not in line]

    def forget(self) -> None:
        """Forget what it has said: whole lines, since nothing is on its way."""
        self.said = b""

    def lines(self) -> list[dict[str, Any]]:
        """Every whole line of stdout as JSON."""
        return [json.loads(line) for line in self.said.splitlines(keepends=True) if line.endswith(b"\n")]

    def close(self, within_s: float = 20.0) -> float:
        """Close stdin, read stdout to its end; returns how many seconds the process took to leave."""
        assert self.process.stdin
        started = time.monotonic()
        self.process.stdin.close()
        while self._listen(within_s) and time.monotonic() - started < within_s:
            pass
        self.process.wait(within_s)
        return time.monotonic() - started

    def end(self) -> None:
        """Whatever it does, end it."""
        self.process.kill()
        self.process.wait(20)
        for pipe in (self.process.stdin, self.process.stdout, self.errors):
            with contextlib.suppress(BrokenPipeError):
                pipe.close()

    def _listen(self, seconds: float) -> bool:
        assert self.process.stdout
        if not select.select([self.process.stdout], [], [], seconds)[0]:
            return False
        data = os.read(self.process.stdout.fileno(), 1 << 20)
        self.said += data
        return bool(data)

    def _write(self, message: dict[str, Any]) -> None:
        self.write(json.dumps(message).encode() + b"\n")


def children(pid: int) -> list[int]:
    """The processes that a process has started, and theirs."""
    own: list[int] = []
    with suppress(FileNotFoundError, ProcessLookupError):  # it is gone
        own += map(int, Path(f"/proc/{pid}/task/{pid}/children").read_text().split())
    return [*own, *(below for child in own for below in children(child))]


def lives(pid: int) -> bool:
    """Whether the process runs; one that nobody has waited for does not."""
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except (FileNotFoundError, ProcessLookupError):  # it ended before the file was opened, or before it was read
        return False
