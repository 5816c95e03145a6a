"""Runs a real client: with a home of its own, the configuration that `ros2-mcp config` prints, and a scripted model."""

from __future__ import annotations

import json
import os
import shlex
import signal
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

from support.agent import until
from support.clients.model import ScriptedModel, Turn, serving
from support.clients.script import Call
from support.processes import peer_command
from support.raw_server import lives

ENDS_S = 10.0
"""Both clients and our server leave within a second of SIGTERM; a busy machine stretches that."""


@dataclass(frozen=True)
class Workplace:
    """Where one run of a client happens: nothing in it is of the machine's user."""

    folder: Path
    environment: Mapping[str, str]
    """Of the client's process."""
    server: str
    """The command that the configuration is to name: our server's, watched."""

    @property
    def home(self) -> Path:
        return self.folder / "home"

    @property
    def project(self) -> Path:
        """The folder in which the client is started."""
        return self.folder / "project"

    @property
    def log(self) -> Path:
        """What `mcp_tap` has written."""
        return self.folder / "mcp.jsonl"

    def run(self, *command: str | Path) -> str:
        """What a command of the client's says; it must succeed."""
        run = subprocess.run(
            command, cwd=self.project, env=self.environment, capture_output=True, text=True, timeout=120, check=False
        )
        assert run.returncode == 0, (command, run.stdout, run.stderr)
        return run.stdout + run.stderr


class Configured(Protocol):
    """A client in one version, as far as it takes a configuration."""

    name: str
    """As `ros2-mcp config` and the tests' names have it."""

    def environment(self, home: Path, /) -> dict[str, str]:
        """What it needs beside HOME and PATH: no telemetry, no updates."""
        ...

    def configure(self, place: Workplace, printed: str, model: str, /) -> None:
        """Do with what `ros2-mcp config` printed what its user would do; the model's address is `model`."""
        ...

    def servers(self, place: Workplace) -> str:
        """What it says of the servers that are configured."""
        ...


class Client(Configured, Protocol):
    """A client that a scripted model can drive."""

    allow_all: Sequence[str]
    """Options with which it asks nobody before it calls a tool."""

    def command(self, place: Workplace, prompt: str) -> list[str]:
        """Let it carry out a prompt without a human."""
        ...

    def waiting(self, tools: list[str], /) -> Call:
        """A call of its own that the model makes while these tools are not offered yet."""
        ...


class Session:
    """A running client."""

    def __init__(self, place: Workplace, model: ScriptedModel, process: subprocess.Popen[bytes]) -> None:
        self.place, self.model, self.process = place, model, process

    def ends(self, within_s: float) -> None:
        """Wait until it has carried out its prompt."""
        try:
            code = self.process.wait(within_s)
        except subprocess.TimeoutExpired:
            raise AssertionError(f"it did not end within {within_s} s\n{self.said()}") from None
        assert code == 0, self.said()

    def interrupt(self, *, with_its_server: bool = False) -> None:
        """SIGINT to the client; `with_its_server` to its whole group, as Ctrl+C does in a terminal."""
        if with_its_server:
            os.killpg(self.process.pid, signal.SIGINT)
        else:
            self.process.send_signal(signal.SIGINT)

    def said(self) -> str:
        """The end of what it has written."""
        return "\n".join((self.place.folder / name).read_text(errors="replace")[-3000:] for name in ("out", "err"))

    def messages(self) -> list[dict[str, Any]]:
        """What passed between it and the server so far; see `mcp_tap`."""
        if not self.place.log.exists():
            return []
        lines = self.place.log.read_text(encoding="utf-8").splitlines(keepends=True)
        return [json.loads(line) for line in lines if line.endswith("\n")]

    @property
    def begun(self) -> float:
        """When the client started the server: monotonic, in s."""
        return self.messages()[0]["message"]["begun"]

    def answers(self, method: str) -> list[dict[str, Any]]:
        """The results that the server gave to requests of a method, in the order in which they were asked."""
        passed = [(entry["from"], entry["message"]) for entry in self.messages() if isinstance(entry["message"], dict)]
        answers = [message for side, message in passed if side == "server" and "result" in message]
        results = {message["id"]: message["result"] for message in answers}
        return [results[request["id"]] for request in self.asked(method) if request["id"] in results]

    def asked(self, method: str) -> list[dict[str, Any]]:
        """The client's requests of a method."""
        sent = [entry["message"] for entry in self.messages() if entry["from"] == "client" and _method(entry) == method]
        return [message for message in sent if "id" in message]

    def time_of(self, method: str) -> tuple[float, float]:
        """When the first request of a method reached the server, and when its answer came back: monotonic, in s."""
        entries = self.messages()
        asked = next(entry for entry in entries if entry["from"] == "client" and _method(entry) == method)
        identity = asked["message"]["id"]
        answer = next(
            entry
            for entry in entries
            if entry["from"] == "server" and isinstance(entry["message"], dict)
            if entry["message"].get("id") == identity and "method" not in entry["message"]
        )
        return asked["at"], answer["at"]


def _method(entry: Mapping[str, Any]) -> str:
    return entry["message"].get("method", "") if isinstance(entry["message"], dict) else ""


@contextmanager
def session(
    client: Client,
    environment: Mapping[str, str],
    turns: Sequence[Turn],
    *,
    prepare: Callable[[Workplace], None] = lambda _: None,
    options: Sequence[str] = (),
    server: Mapping[str, str] = {},
) -> Iterator[Session]:
    """The client with a model that takes these turns, for the time of a block; nothing that it started is left.

    Args:
        client: which one.
        environment: where the robot is: what a user's shell would say of ROS.
        turns: what the model does.
        prepare: changes to the client's own settings, made last.
        options: of the client's command line, before the prompt.
        server: more variables of the shell in which `ros2-mcp config` is run.
    """
    with workplace(client) as place:
        model = ScriptedModel(turns, client.waiting)
        with serving(model) as address:
            client.configure(place, printed_config(client.name, place, {**environment, **server}), address)
            prepare(place)
            command = client.command(place, "Begin.")
            with (place.folder / "out").open("wb") as out, (place.folder / "err").open("wb") as err:
                process = subprocess.Popen(
                    [*command[:-1], *options, command[-1]],
                    cwd=place.project,
                    env=place.environment,
                    stdin=subprocess.DEVNULL,
                    stdout=out,
                    stderr=err,
                    start_new_session=True,
                )
            running = Session(place, model, process)
            try:
                yield running
            finally:
                _end(running)


def printed_config(name: str, place: Workplace, environment: Mapping[str, str]) -> str:
    """What `ros2-mcp config` prints in a shell that says this of ROS; it names the watched server."""
    names = ("ROS_", "RMW_", "FAST", "ROS2_MCP_")
    shell = {variable: value for variable, value in environment.items() if variable.startswith(names)}
    command = [sys.executable, "-m", "ros2_mcp"]
    printed = subprocess.run(
        [*command, "config", name],
        env={**os.environ, **shell, "HOME": str(place.home)},
        capture_output=True,
        text=True,
        timeout=60,
        check=True,
    ).stdout
    ours = str(Path(sys.executable).with_name("ros2-mcp"))
    assert ours in printed, printed
    return printed.replace(ours, place.server)


@contextmanager
def workplace(client: Configured) -> Iterator[Workplace]:
    """An empty one for this client, for the time of a block."""
    with tempfile.TemporaryDirectory(prefix="ros2_mcp_client_", ignore_cleanup_errors=True) as made:
        yield _workplace(Path(made), client)


def _workplace(folder: Path, client: Configured) -> Workplace:
    watched = folder / "ros2-mcp"
    ours = str(Path(sys.executable).with_name("ros2-mcp"))
    tap = shlex.join([*peer_command("mcp_tap"), str(folder / "mcp.jsonl"), ours])
    watched.write_text(f'#!/bin/sh\nexec {tap} "$@"\n')
    watched.chmod(0o755)
    own = {
        "HOME": str(folder / "home"),
        "PATH": os.environ["PATH"],
        "TERM": "dumb",
        "LANG": "C.UTF-8",
        "NO_PROXY": "127.0.0.1,localhost",
        "DO_NOT_TRACK": "1",
        **client.environment(folder / "home"),
    }
    place = Workplace(folder, own, str(watched))
    place.home.mkdir()
    place.project.mkdir()
    return place


def _end(running: Session) -> None:
    """End the client, and what it leaves of the server."""
    with suppress(ProcessLookupError):
        os.killpg(running.process.pid, signal.SIGTERM)
    with suppress(subprocess.TimeoutExpired):
        running.process.wait(ENDS_S)
    with suppress(ProcessLookupError):
        os.killpg(running.process.pid, signal.SIGKILL)
    running.process.wait()
    started = [entry["message"]["pids"] for entry in running.messages() if entry["from"] == "tap"]
    servers = [pid for pids in started for pid in pids]
    try:
        until(lambda: not any(map(lives, servers)), ENDS_S)
    finally:
        for pid in servers:
            with suppress(ProcessLookupError):
                os.kill(pid, signal.SIGKILL)
