"""A server at a Unix socket: for its user and group alone, in both eras, through `ros2-mcp connect` as over stdio."""

from __future__ import annotations

import json
import socket
import stat
import subprocess
import sys
import time
from collections.abc import Generator, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

import pytest
from mcp import Client, StdioServerParameters
from mcp.client.stdio import stdio_client

from support.agent import until
from support.observer import TWIST, Observer
from support.structured import META

END_S = 30.0
CLOSED_S, ARRIVES_S = 0.3, 0.05
"""As for a client over HTTP that closes its last open response."""
TOPIC = "/connected/cmd_vel"


@contextmanager
def serving(environment: dict[str, str], path: Path, *options: str) -> Generator[subprocess.Popen[bytes]]:
    """A server at a socket for the time of a block."""
    command = [sys.executable, "-m", "ros2_mcp", "--socket", str(path), "--tools", "all", *options]
    process = subprocess.Popen(command, env=environment)
    try:
        until(path.exists)
        yield process
    finally:
        process.terminate()
        process.wait(END_S)


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


@pytest.mark.parametrize("way", ["ends its input", "is killed"])
def test_what_a_client_keeps_moving_stops_with_it_and_nothing_of_another_does(
    ros_environment: dict[str, str], path: Path, observer: Observer, way: str
) -> None:
    topic, kept = (f"{TOPIC}_{way.replace(' ', '_')}{what}" for what in ("", "_kept"))
    goes, stays = Connected(ros_environment, path), Connected(ros_environment, path)
    for name in (topic, kept):
        observer.join(by=name, topic=name, kind=TWIST, best_effort=False)
    observer.talk(topic="/talk", kind=TWIST, hz=20)
    for client, name in ((goes, topic), (stays, kept)):
        ends = {"source_topic": "/talk", "destination_topic": name, "message_type": TWIST}
        client.call("ros2_relay_start", **ends, duration_sec=0)
        observer.until_driven(name, 5)
    time.sleep(2.5)  # longer than a client lease: an open connection renews it
    assert observer.moved(sent_after=time.monotonic_ns() - 200_000_000, topic=topic)
    assert goes.process.stdin
    went = time.monotonic_ns()
    if way == "is killed":
        goes.process.kill()
    else:
        goes.process.stdin.close()
    assert observer.comes_to_rest(topic, 3.0) == []
    heard = observer.messages(by=topic, topic=topic)
    zero = next(one["at"] for one in heard if one["at"] > went and not any(one["values"]))
    assert (zero - went) / 1e9 < CLOSED_S + ARRIVES_S
    assert observer.moved(sent_after=time.monotonic_ns() - 200_000_000, topic=kept)
    assert goes.process.wait(END_S) == (-9 if way == "is killed" else 0)
    goes.kill()
    stays.kill()
    assert observer.comes_to_rest(kept, 3.0) == []


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
        until(lambda: _accepts(path))
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
