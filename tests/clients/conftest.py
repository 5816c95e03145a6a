"""The simulated robot and real clients from npm; marked `full`, since the clients are hundreds of megabytes."""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
from collections.abc import Iterator

import pytest

from support.clients.claude_code import ClaudeCode
from support.clients.client import Client
from support.clients.codex import Codex
from support.clients.opencode import OpenCode
from support.clients.table import COLUMNS, table
from support.demo_robot import build_interfaces, with_interfaces
from support.domains import reserved_domains
from support.processes import TESTS, python_path, running

CLIENTS = {"claude-code": ClaudeCode, "codex": Codex, "opencode": OpenCode}


@pytest.fixture(scope="module", params=list(CLIENTS))
def client(request: pytest.FixtureRequest) -> Client:
    return CLIENTS[request.param]()


@pytest.fixture(scope="module")
def ros_environment() -> Iterator[dict[str, str]]:
    """What a user's shell says of ROS, in a domain that no other process uses."""
    pytest.importorskip("rclpy", reason="needs the ROS 2 wheels, or a sourced ROS 2")
    prefixes = build_interfaces(later=True)
    with reserved_domains() as domain, tempfile.TemporaryDirectory() as state:
        yield {
            **os.environ,
            "ROS_DOMAIN_ID": str(domain),
            "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST",
            "ROS_LOG_DIR": tempfile.gettempdir(),
            "FASTRTPS_DEFAULT_PROFILES_FILE": str(TESTS / "ros" / "quiet_fast_dds.xml"),
            "XDG_STATE_HOME": state,
            "PYTHONPATH": python_path(),
            "PYTHONUNBUFFERED": "1",
            "ROS2_MCP_INTERFACES": os.pathsep.join(map(str, prefixes)),
        }


@pytest.fixture(scope="module")
def robot(ros_environment: dict[str, str]) -> Iterator[subprocess.Popen[str]]:
    """The simulated robot of a file of tests."""
    environment = with_interfaces(ros_environment, build_interfaces(later=True))
    with running(environment, sys.executable, "-m", "ros2_mcp_demo") as process:
        yield process


def pytest_terminal_summary(terminalreporter: pytest.TerminalReporter, config: pytest.Config) -> None:
    """The table of what was read, which the documentation has."""
    if columns := config.stash.get(COLUMNS, {}):
        terminalreporter.section("what the model reads of each call")
        for line in table(columns):
            terminalreporter.write_line(line)
