"""A server at a Unix socket: for its user and group alone, in both eras, through `ros2-mcp connect` as over stdio."""

from __future__ import annotations

import itertools
import json
import socket
import stat
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path
from typing import Any

import pytest
from mcp import Client, StdioServerParameters
from mcp.client.stdio import stdio_client

from support.agent import FULL, until
from support.observer import TWIST, Observer
from support.ports import serving
from support.standstill import undisturbed
from support.structured import META

END_S = 60.0
"""For what starts or ends a server, or `connect`: on a busy machine each start takes seconds."""
CLOSED_S, ARRIVES_S = 0.3, 0.05
"""As for a client over HTTP that closes its last open response."""
TALK = "/talk"
WAYS = ("ends its input", "is killed")
_numbers = itertools.count()


@pytest.fixture(scope="module")
def path(ros_environment: dict[str, str], tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    path = tmp_path_factory.mktemp("run") / "socket"
    with serving(ros_environment, path):
        yield path


class Connected:
    """A client that has started `ros2-mcp connect`, and speaks by hand."""

    def __init__(self, environment: dict[str, str], path: Path) -> None:
        command = [sys.executable, "-m", "ros2_mcp", "connect", str(path)]
        pipe = subprocess.PIPE
        self.process = subprocess.Popen(command, env=environment, stdin=pipe, stdout=pipe, stderr=pipe, text=True)
        self._id = 0
        hello = {"protocolVersion": "2025-11-25", "capabilities": {}, "clientInfo": {"name": "by hand", "version": "1"}}
        assert self.ask("initialize", hello)["serverInfo"]["name"] == "ros2-mcp"
        self.tell({"method": "notifications/initialized"})

    def kill(self) -> None:
        """Ends it, and closes its pipes."""
        self.process.kill()
        self.process.wait()
        for pipe in (self.process.stdin, self.process.stdout, self.process.stderr):
            assert pipe
            with suppress(OSError):  # it has ended with something still to be written to it
                pipe.close()

    def tell(self, message: dict[str, Any]) -> None:
        assert self.process.stdin
        self.process.stdin.write(json.dumps({"jsonrpc": "2.0", **message}) + "\n")
        self.process.stdin.flush()

    def ask(self, method: str, params: dict[str, Any]) -> dict[str, Any]:
        """The result of a request."""
        assert self.process.stdout
        self._id += 1
        self.tell({"id": self._id, "method": method, "params": params})
        while True:
            said = json.loads(self.process.stdout.readline())
            if said.get("id") == self._id and "method" not in said:
                return said["result"]

    def call(self, tool: str, **arguments: Any) -> dict[str, Any]:
        """The structured result of a call."""
        result = self.ask("tools/call", {"name": tool, "arguments": arguments, "_meta": META})
        assert not result.get("isError"), result
        return result["structuredContent"]


def test_it_belongs_to_its_user_and_group_alone(path: Path) -> None:
    assert stat.S_IMODE(path.stat().st_mode) == 0o660


@pytest.mark.parametrize("mode", ["legacy", "auto"])
async def test_clients_of_both_eras_speak_through_connect(
    ros_environment: dict[str, str], path: Path, mode: str
) -> None:
    command = StdioServerParameters(
        command=sys.executable, args=["-m", "ros2_mcp", "connect", str(path)], env=ros_environment
    )
    async with Client(stdio_client(command), mode=mode) as client:
        assert "ros2_topic_list" in {tool.name for tool in (await client.list_tools()).tools}
        result = await client.call_tool("ros2_status", {}, meta=META)
        assert result.structured_content and result.structured_content["bridge_node"]


class Field:
    """Clients that keep something moving, each on a topic of its own, and the observer that sees it."""

    def __init__(self, environment: dict[str, str], path: Path, observer: Observer) -> None:
        self.environment, self.path, self.observer = environment, path, observer
        observer.talk(topic=TALK, kind=TWIST, hz=20)

    def driver(self, name: str) -> tuple[Connected, str]:
        """A client that relays, and its topic, which has moved."""
        client, topic = Connected(self.environment, self.path), f"/connected/{name}/cmd_vel"
        self.observer.join(by=topic, topic=topic, kind=TWIST, best_effort=False)
        ends = {"source_topic": TALK, "destination_topic": topic, "message_type": TWIST}
        client.call("ros2_relay_start", **ends, duration_sec=0)
        self.observer.until_driven(topic, 5)
        return client, topic

    def goes_on(self, topic: str, messages: int = 5) -> None:
        """Wait until a topic has moved so many times more."""
        self.observer.until_driven(topic, self.observer.driven(topic=topic)[topic] + messages)


@pytest.fixture
def field(ros_environment: dict[str, str], path: Path, observer: Observer) -> Iterator[Field]:
    yield Field(ros_environment, path, observer)
    observer.hush(topic=TALK)


def goes(client: Connected, way: str) -> int:
    """It ends its input or is killed; when (CLOCK_MONOTONIC, ns)."""
    assert client.process.stdin
    went = time.monotonic_ns()
    if way == "is killed":
        client.process.kill()
    else:
        client.process.stdin.close()
    return went


def test_what_a_client_keeps_moving_stops_with_it_and_nothing_of_another_does(field: Field) -> None:
    stays, kept = field.driver("stays")
    going = {way: field.driver(way.replace(" ", "_")) for way in WAYS}
    for _, topic in going.values():
        field.goes_on(topic, 50)  # longer than a client lease: an open connection renews it
    for way, (client, topic) in going.items():
        goes(client, way)
        assert field.observer.comes_to_rest(topic, END_S) == []
        field.goes_on(kept)
        assert field.observer.moving(topic=topic) == []
        assert client.process.wait(END_S) == (-9 if way == "is killed" else 0)
        client.kill()
    stays.kill()
    assert field.observer.comes_to_rest(kept, 3.0 if FULL else END_S) == []


@pytest.mark.full
@pytest.mark.parametrize("way", WAYS)
def test_what_a_client_moves_stands_within_a_third_of_a_second_of_its_going(field: Field, way: str) -> None:
    def seconds() -> float:
        client, topic = field.driver(f"{way.replace(' ', '_')}_{next(_numbers)}")
        went = goes(client, way)
        assert field.observer.comes_to_rest(topic, 3.0) == []
        heard = field.observer.messages(by=topic, topic=topic)
        client.kill()
        return (next(one["at"] for one in heard if one["at"] > went and not any(one["values"])) - went) / 1e9

    assert undisturbed(seconds) < CLOSED_S + ARRIVES_S


def test_a_message_that_is_too_long_ends_its_connection_alone(ros_environment: dict[str, str], path: Path) -> None:
    other = Connected(ros_environment, path)
    with socket.socket(socket.AF_UNIX) as connection:
        connection.connect(str(path))
        connection.settimeout(END_S)
        with pytest.raises(OSError):
            for _ in range(200):
                connection.sendall(b" " * 100_000)
            assert connection.recv(1) == b""
            raise ConnectionResetError
    assert other.call("ros2_relay_list")["relays"] is not None
    other.kill()


def test_when_the_server_ends_connect_says_so(ros_environment: dict[str, str], tmp_path: Path) -> None:
    path = tmp_path / "socket"
    with serving(ros_environment, path) as server:
        client = Connected(ros_environment, path)
        refused = subprocess.run(
            [sys.executable, "-m", "ros2_mcp", "--socket", str(path)],
            env=ros_environment,
            capture_output=True,
            text=True,
            timeout=END_S,
            check=False,
        )
        assert refused.returncode == 1 and f"Another server listens at {path}." in refused.stderr
        server.kill()
    assert client.process.wait(END_S) == 1
    assert "has ended the connection" in client.process.communicate()[1]
    assert path.exists()  # the next server takes its place
    with serving(ros_environment, path):
        until(lambda: _accepts(path), END_S)
        Connected(ros_environment, path).kill()


def _accepts(path: Path) -> bool:
    with socket.socket(socket.AF_UNIX) as probe:
        return probe.connect_ex(str(path)) == 0


def test_a_server_that_ends_while_its_client_writes_is_told_from_a_client_that_has_ended(
    ros_environment: dict[str, str], tmp_path: Path
) -> None:
    path, pipe = tmp_path / "socket", subprocess.PIPE
    with socket.socket(socket.AF_UNIX) as listener:
        listener.bind(str(path))
        listener.listen()
        command = [sys.executable, "-m", "ros2_mcp", "connect", str(path)]
        client = subprocess.Popen(command, env=ros_environment, stdin=pipe, stdout=pipe, stderr=pipe, text=True)
        threads = Path(f"/proc/{client.pid}/task")
        with listener.accept()[0] as accepted:
            until(lambda: len(list(threads.iterdir())) == 2)
            accepted.shutdown(socket.SHUT_RD)
            assert client.stdin
            client.stdin.write("{}\n")
            client.stdin.flush()
            until(lambda: len(list(threads.iterdir())) == 1)  # what carries stdin could not write, and has ended
    said = client.communicate(timeout=END_S)[1]
    assert client.returncode == 1 and "has ended the connection" in said


def test_where_nobody_listens_connect_says_what_to_do(ros_environment: dict[str, str], tmp_path: Path) -> None:
    command = [sys.executable, "-m", "ros2_mcp", "connect", str(tmp_path / "nowhere")]
    ended = subprocess.run(
        command,
        env=ros_environment,
        capture_output=True,
        text=True,
        stdin=subprocess.DEVNULL,
        timeout=END_S,
        check=False,
    )
    assert ended.returncode == 1 and "ros2-mcp --socket" in ended.stderr and "Traceback" not in ended.stderr
