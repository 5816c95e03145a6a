"""What `ros2-mcp config CLIENT` prints is read back as the client reads it."""

from __future__ import annotations

import json
import os
import shlex
import sys
from pathlib import Path
from typing import Any

import pytest

from ros2_mcp.cli import CLIENTS
from ros2_mcp.commands.config import absolute_paths, configuration, environment, print_config

COMMAND = "/opt/my tools/bin/ros2-mcp"
OPTIONS = ["--read-only", "--workspace", '/a "quoted"\\place']
VARIABLES = {"ROS_DOMAIN_ID": "42", "RMW_IMPLEMENTATION": "rmw_cyclonedds_cpp"}
ENTRY = {"command": COMMAND, "args": OPTIONS, "env": VARIABLES}


def printed(client: str, variables: dict[str, str] = VARIABLES) -> str:
    return configuration(client, COMMAND, OPTIONS, variables)


@pytest.mark.parametrize("client", ["claude-desktop", "cursor", "gemini"])
def test_most_clients_read_it_as_json(client: str) -> None:
    assert json.loads(printed(client)) == {"mcpServers": {"ros2": ENTRY}}


def test_vscode_reads_it_as_json_of_its_own_form() -> None:
    assert json.loads(printed("vscode")) == {"servers": {"ros2": {"type": "stdio", **ENTRY}}}


def test_claude_code_takes_one_command() -> None:
    words = shlex.split(printed("claude-code"))
    assert words[: words.index("--")] == [
        *("claude", "mcp", "add", "ros2"),
        *("-e", "ROS_DOMAIN_ID=42", "-e", "RMW_IMPLEMENTATION=rmw_cyclonedds_cpp"),
    ]
    assert words[words.index("--") + 1 :] == [COMMAND, *OPTIONS]


@pytest.mark.skipif(sys.version_info < (3, 11), reason="Python 3.10 cannot read TOML")
@pytest.mark.parametrize("variables", [VARIABLES, {}])
def test_codex_reads_it_as_toml(variables: dict[str, str]) -> None:
    import tomllib

    read: dict[str, Any] = tomllib.loads(printed("codex", variables))
    assert {"env": {}, **read["mcp_servers"]["ros2"]} == {**ENTRY, "env": variables}


def test_only_variables_that_decide_which_robot_is_seen_are_passed_on() -> None:
    shell = {"ROS_DOMAIN_ID": "7", "HOME": "/somewhere", "RMW_IMPLEMENTATION": "", "SECRET": "x"}
    assert environment(shell) == {"ROS_DOMAIN_ID": "7"}


@pytest.mark.parametrize("client", CLIENTS)
def test_stdout_is_the_configuration_and_stderr_says_where_it_goes(
    client: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert print_config(client, ["--read-only", "config", client]) == 0
    out, err = capsys.readouterr()
    assert "--read-only" in out
    assert f"config {client}" not in out
    assert err.startswith("# ")


def test_paths_become_absolute_each_of_several_too_and_links_stay(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "python").symlink_to(sys.executable)
    given = ["--bridge-python", "python", "--workspace", f"a{os.pathsep}/b", "--domain-id", "7"]
    assert absolute_paths(given) == [
        *("--bridge-python", f"{tmp_path}/python"),
        *("--workspace", f"{tmp_path}/a{os.pathsep}/b"),
        *("--domain-id", "7"),
    ]
