"""The server introduces itself and lists its tools at once, wherever ROS 2 is, and then finds it or says what to do."""

from __future__ import annotations

import json
import os
import shlex
import subprocess
import sys
import time
import venv
from collections.abc import Callable
from pathlib import Path

import pytest

from support.agent import FULL
from support.raw_server import RawServer
from support.standstill import undisturbed

SITE_PACKAGES = Path(next(entry for entry in sys.path if entry.endswith("site-packages")))
SLOW_S = 3.0
WAIT_FOR_GATE = "for _ in {1..600}; do [ -e %s ] && break; sleep 0.05; done"


@pytest.fixture(scope="session")
def bare_python(tmp_path_factory) -> str:
    """A Python environment with what the server needs, and without ROS 2."""
    root = tmp_path_factory.mktemp("bare")
    venv.create(root, symlinks=True)
    site_packages = next(root.glob("lib/python3*/site-packages"))
    for entry in SITE_PACKAGES.iterdir():
        if "ros_jazzy" not in entry.name and "rclpy" not in entry.name and entry.suffix != ".pth":
            (site_packages / entry.name).symlink_to(entry)
    return str(root / "bin" / "python")


def sourced() -> dict[str, str]:
    """What a sourced shell has, for the ROS 2 wheels of the tests' own environment."""
    libraries = [sys.prefix + "/lib", *map(str, SITE_PACKAGES.glob("ros_*.libs"))]
    return {
        "AMENT_PREFIX_PATH": sys.prefix,
        "LD_LIBRARY_PATH": os.pathsep.join(libraries),
        "ROS_DISTRO": "jazzy",
    }


def opened(start: Callable[[], RawServer]) -> RawServer:
    """A server that has introduced itself and listed its tools: in full, within three seconds."""

    def timed() -> tuple[RawServer, float]:
        started = time.monotonic()
        server = start()
        assert server.begin("2025-11-25")["serverInfo"]["name"] == "ros2-mcp"
        assert len(server.ask("tools/list")["result"]["tools"]) > 20
        return server, time.monotonic() - started

    server, took_s = undisturbed(timed) if FULL else timed()
    if FULL:
        assert took_s < SLOW_S
    return server


def found(server) -> str:
    result = server.call("ros2_status")
    assert not result.get("isError"), result
    return result["structuredContent"]["ros_found"]


@pytest.mark.promise("README", "ROS 2 wheels in the server's own environment")
def test_wheels(start_raw, tmp_path: Path) -> None:
    server = opened(lambda: start_raw(ROS2_MCP_ROS_ROOT=str(tmp_path)))
    assert "wheels" in found(server)


@pytest.mark.promise("README", "a sourced shell")
def test_a_sourced_shell(start_raw, ros_environment, bare_python: str) -> None:
    shell = sourced()
    path = os.pathsep.join([ros_environment["PYTHONPATH"], str(SITE_PACKAGES)])
    server = opened(lambda: start_raw(command=[bare_python, "-m", "ros2_mcp"], **{**shell, "PYTHONPATH": path}))
    assert "This shell is sourced" in found(server)


@pytest.mark.parametrize("has_setup_file", [True, False])
def test_a_ros_outside_opt_is_found_by_what_config_printed_in_its_sourced_shell(
    start_raw, ros_environment, bare_python: str, tmp_path: Path, has_setup_file: bool
) -> None:
    """A prefix like that of RoboStack or of a merged build, without COLCON_PREFIX_PATH; or with nothing to source."""
    prefix = tmp_path / "ros"
    (prefix / "lib").mkdir(parents=True)
    (prefix / "lib" / SITE_PACKAGES.parent.name).symlink_to(SITE_PACKAGES.parent)
    (prefix / "share").symlink_to(Path(sys.prefix) / "share")
    shell = {**sourced(), "AMENT_PREFIX_PATH": str(prefix), "PYTHONPATH": str(SITE_PACKAGES), "HOME": str(tmp_path)}
    bare = {"ROS2_MCP_ROS_ROOT": str(tmp_path / "none"), "PATH": os.environ["PATH"]}
    if has_setup_file:
        lines = (f"export {name}={shlex.quote(value)}" for name, value in shell.items())
        (prefix / "setup.bash").write_text("\n".join(lines) + "\n")
    path = os.pathsep.join([f"{prefix}/lib/{SITE_PACKAGES.parent.name}/site-packages", ros_environment["PYTHONPATH"]])
    printed = subprocess.run(
        [bare_python, "-m", "ros2_mcp", "config", "cursor"],
        env={**bare, **shell, "PYTHONPATH": path},
        capture_output=True,
        text=True,
        check=True,
    )
    entry = json.loads(printed.stdout)["mcpServers"]["ros2"]
    server = opened(lambda: start_raw(command=[bare_python, "-m", "ros2_mcp"], **entry["env"], HOME=str(tmp_path)))
    assert str(prefix) in found(server)


@pytest.mark.promise("README", "is sourced for the bridge")
def test_an_installation_that_is_slow_to_source(start_raw, bare_python: str, tmp_path: Path) -> None:
    (tmp_path / "jazzy").mkdir()
    gate = tmp_path / "gate"
    exports = {**sourced(), "PYTHONPATH": str(SITE_PACKAGES), "PATH": f"{sys.prefix}/bin:{os.environ['PATH']}"}
    lines = [WAIT_FOR_GATE % gate, *(f"export {name}={shlex.quote(value)}" for name, value in exports.items())]
    (tmp_path / "jazzy" / "setup.bash").write_text("\n".join(lines) + "\n")
    try:
        server = opened(lambda: start_raw(command=[bare_python, "-m", "ros2_mcp"], ROS2_MCP_ROS_ROOT=str(tmp_path)))
    finally:
        gate.touch()  # only now may the sourcing end
    assert "setup.bash is sourced for the bridge" in found(server)


@pytest.mark.promise(
    "README", "the server starts all the same, and every answer says what is missing and how to get it"
)
def test_none(start_raw, bare_python: str, tmp_path: Path) -> None:
    server = opened(lambda: start_raw(command=[bare_python, "-m", "ros2_mcp"], ROS2_MCP_ROS_ROOT=str(tmp_path)))
    for _ in range(2):
        seconds_of_the_refusal(server)


@pytest.mark.full
def test_where_there_is_none_that_is_said_within_a_second(start_raw, bare_python: str, tmp_path: Path) -> None:
    def slowest_of_two_calls() -> float:
        server = opened(lambda: start_raw(command=[bare_python, "-m", "ros2_mcp"], ROS2_MCP_ROS_ROOT=str(tmp_path)))
        return max(seconds_of_the_refusal(server) for _ in range(2))

    assert undisturbed(slowest_of_two_calls) < 1


def seconds_of_the_refusal(server: RawServer) -> float:
    started = time.monotonic()
    result = server.call("ros2_topic_list")
    assert result["isError"]
    text = result["content"][0]["text"]
    assert "No ROS 2 found" in text
    assert "-m pip install " in text and "[jazzy]" in text
    return time.monotonic() - started


@pytest.mark.parametrize(
    ("options", "clear"),
    [
        (["--distro", "foxy"], "ROS 2 foxy was requested (--distro) but not found; found: jazzy"),
        (["--workspace", "/nowhere"], "The workspace /nowhere has no install/setup.bash. Build it"),
        (["--rmw", "rmw_none"], "rmw_none"),
    ],
)
def test_what_cannot_be_used_is_named_by_every_call(start_raw, tmp_path: Path, options: list[str], clear: str) -> None:
    server = opened(lambda: start_raw(*options, ROS2_MCP_ROS_ROOT=str(tmp_path)))
    result = server.call("ros2_topic_list")
    assert result["isError"]
    assert clear in result["content"][0]["text"]
