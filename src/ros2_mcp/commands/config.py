"""Print the exact configuration that an MCP client needs."""

# ruff: noqa: T201 - printing is this module's job

from __future__ import annotations

import json
import os
import shlex
import shutil
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path

from ros2_mcp.settings import OPTIONS

NAME = "ros2"
_PASSED_ON = ("ROS_DOMAIN_ID", "RMW_IMPLEMENTATION", "ROS_AUTOMATIC_DISCOVERY_RANGE", "ROS_STATIC_PEERS")
_PLACES = {
    "claude-desktop": "claude_desktop_config.json (Settings > Developer > Edit Config)",
    "claude-code": "run this command",
    "vscode": ".vscode/mcp.json in the project",
    "cursor": "~/.cursor/mcp.json",
    "codex": "~/.codex/config.toml",
    "gemini": "~/.gemini/settings.json",
}


def print_config(client: str, argv: Sequence[str]) -> int:
    """Prints the configuration on stdout and where it goes on stderr; options before `config` are carried over."""
    options = absolute_paths(argv[: argv.index("config")])
    print(f"# {_PLACES[client]}", file=sys.stderr)
    print(configuration(client, executable(), options, environment(os.environ)))
    return 0


def configuration(client: str, command: str, options: Sequence[str], variables: Mapping[str, str]) -> str:
    """The text of the configuration for one client."""
    entry = {"command": command, "args": list(options), "env": dict(variables)}
    if client == "claude-code":
        set_variables = [word for name, value in variables.items() for word in ("-e", f"{name}={value}")]
        return shlex.join(["claude", "mcp", "add", NAME, *set_variables, "--", command, *options])
    if client == "codex":
        return _toml(entry)
    if client == "vscode":
        return json.dumps({"servers": {NAME: {"type": "stdio", **entry}}}, indent=2)
    return json.dumps({"mcpServers": {NAME: entry}}, indent=2)


def absolute_paths(options: Sequence[str]) -> list[str]:
    """The options with absolute paths: a client starts the server in a folder of its own."""
    with_paths = {option.flag: option.kind.several for option in OPTIONS.values() if option.kind.is_path}

    def absolute(flag: str, word: str) -> str:
        paths = word.split(os.pathsep) if with_paths[flag] else [word]
        # Links are kept: the Python of a virtual environment is one.
        return os.pathsep.join(str(Path(path).expanduser().absolute()) for path in paths if path)

    return [
        absolute(before, word) if before in with_paths else word
        for before, word in zip(("", *options), options, strict=False)
    ]


def executable() -> str:
    """The absolute path of this command: a client starts it with a bare environment."""
    started_as = Path(sys.argv[0])
    beside = Path(sys.executable).with_name("ros2-mcp")
    found = started_as.resolve() if started_as.name == "ros2-mcp" else shutil.which("ros2-mcp") or beside
    return str(found)


def environment(variables: Mapping[str, str]) -> dict[str, str]:
    """The variables of this shell that decide which robot is seen; a client would not pass them on."""
    return {name: variables[name] for name in _PASSED_ON if variables.get(name)}


def _toml(entry: Mapping[str, object]) -> str:
    lines = [
        f"[mcp_servers.{NAME}]",
        f"command = {json.dumps(entry['command'])}",
        f"args = {json.dumps(entry['args'])}",
    ]
    variables = entry["env"]
    if isinstance(variables, dict) and variables:
        lines.append(f"[mcp_servers.{NAME}.env]")
        lines += [f"{name} = {json.dumps(value)}" for name, value in variables.items()]  # pyright: ignore[reportUnknownVariableType]
    return "\n".join(lines)
