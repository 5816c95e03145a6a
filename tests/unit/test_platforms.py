"""The server on another system than Linux: nothing that Windows lacks is needed to start and to serve."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from ros2_mcp.model.shell import typed, words_of
from support.hostile_bag import write_hostile_bag
from support.raw_server import MODERN, RawServer

TESTS = Path(__file__).parents[1]
PLATFORMS = (
    *("x86_64-manylinux_2_28", "aarch64-manylinux_2_28", "aarch64-apple-darwin", "x86_64-apple-darwin"),
    *("x86_64-pc-windows-msvc", "aarch64-pc-windows-msvc"),
)
PYTHONS = ("3.11", "3.12", "3.14")  # for 3.10 there is no pydantic-core for Windows on arm64
COMMAND = [sys.executable, "-m", "support.like_windows"]


def environment() -> dict[str, str]:
    return {**os.environ, "PYTHONPATH": str(TESTS)}


def said(*words: str) -> tuple[int, str]:
    done = subprocess.run([*COMMAND, *words], env=environment(), capture_output=True, text=True, check=False)
    return done.returncode, done.stdout + done.stderr


@pytest.fixture
def server(tmp_path: Path) -> Iterator[RawServer]:
    bag = write_hostile_bag(tmp_path / "bag")
    begun = RawServer(environment(), "--log-level", "error", "--bag", str(bag), command=COMMAND)
    yield begun
    begun.end()


def test_every_module_is_imported_without_what_windows_lacks() -> None:
    code, text = said("--import-all")
    assert code == 0, text
    assert int(text) > 200


def test_mcp_is_served_over_stdio_without_what_windows_lacks(server: RawServer) -> None:
    server.begin(MODERN)
    assert len(server.ask("tools/list")["result"]["tools"]) > 10
    assert not server.call("ros2_topic_list").get("isError")
    assert server.close() < 20.0


def test_a_unix_socket_is_refused_with_the_way_out_where_python_knows_none() -> None:
    code, text = said("connect", "/tmp/robot.sock")
    assert code == 1
    assert "Python does not support Unix sockets on Windows" in text
    assert "streamable-http" in text


def test_the_simulated_robot_says_where_it_runs() -> None:
    code, text = said("demo")
    assert code == 1
    assert "The simulated robot runs only on Linux." in text


def test_a_server_without_a_robot_says_how_to_name_one() -> None:
    code, text = said("call", "ros2_topic_list")
    assert code == 1
    assert "--robot ssh://user@host" in text


def test_a_command_is_read_and_written_as_one_types_it(monkeypatch: pytest.MonkeyPatch) -> None:
    assert words_of("kubectl exec -i 'my pod' --") == ("kubectl", "exec", "-i", "my pod", "--")
    assert words_of(r"a\ b #c") == ("a b", "#c")
    monkeypatch.setattr("sys.platform", "win32")
    windows = (r"C:\Program Files\ssh.exe", "-i", r"C:\keys\robot")
    assert words_of(typed(windows)) == windows


@pytest.mark.full
@pytest.mark.parametrize("python", PYTHONS)
@pytest.mark.parametrize("platform", PLATFORMS)
def test_everything_that_is_needed_is_there_as_wheels(platform: str, python: str) -> None:
    asked = ["uv", "pip", "compile", "-q", "--only-binary", ":all:", "--python-platform", platform]
    command = [*asked, "--python-version", python, str(TESTS.parent / "pyproject.toml")]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
