"""Print the exact configuration that an MCP client needs."""

# ruff: noqa: T201 - printing is this module's job

from __future__ import annotations

import argparse
import json
import os
import shlex
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from ros2_mcp.guard.entrance import entrance_of
from ros2_mcp.guard.state import state_home
from ros2_mcp.guard.tokens import own_token
from ros2_mcp.link.environment import find_ros, sourced, wheel_distro
from ros2_mcp.link.installation import search_of, without_ours
from ros2_mcp.link.provenance import launch_command, own_provenance
from ros2_mcp.model.errors import RobotError
from ros2_mcp.model.shell import typed
from ros2_mcp.settings import OPTIONS, Option, Settings
from ros2_mcp_common.start.finding import Found, path_entries
from ros2_mcp_common.start.nodes_here import OF_A_SOURCED_SHELL
from ros2_mcp_common.wire.limits import MAX_DURATION_S

NAME = "ros2"
# Clients end calls by themselves, some after 60 s. The longest call that a tool allows takes a little longer than its
# duration: discovery before it, the answer after it.
_CALL_S = MAX_DURATION_S + 60
# How long a client waits for the server's first answer: measured 0.7 s on an idle machine, 4 to 8 s on one with ten
# times the work that it can do. By default, Codex waits 10 s, opencode 5 s.
_START_S = 60
# Goose's own default for a call; the configuration needs a value.
_GOOSE_TIMEOUT_S = 300

# Not carried over: a client that starts the server uses stdio; with these it would wait for ever.
_OF_HTTP = frozenset(
    [
        "transport",
        "host",
        "port",
        "token_file",
        "no_login",
        "tls_cert",
        "tls_key",
        "behind_proxy",
        "public_url",
        "socket",
    ]
)

# Options whose paths are on the robot.
_OF_THE_ROBOT = frozenset(["workspaces", "bridge_python", "ros_root", "interface_prefixes"])

# Variables, besides those of our settings, that determine which robot is seen. Clients would not pass them on.
_OF_ROS = (
    "ROS_AUTOMATIC_DISCOVERY_RANGE",
    "ROS_STATIC_PEERS",
    "ROS_LOCALHOST_ONLY",
    "ROS_DISCOVERY_SERVER",
    "ROS_SUPER_CLIENT",
    "ROS_SECURITY_ENABLE",
    "ROS_SECURITY_STRATEGY",
    "ROS_SECURITY_ENCLAVE_OVERRIDE",
    "RMW_FASTRTPS_USE_QOS_FROM_XML",
    "RMW_FASTRTPS_PUBLICATION_MODE",
    "FASTDDS_BUILTIN_TRANSPORTS",
    "SKIP_DEFAULT_XML",
    "ZENOH_CONFIG_OVERRIDE",
    "ZENOH_ROUTER_CHECK_ATTEMPTS",
)
# The same, for variables that name files: a path, a file:// address, or a list of them separated by commas.
_FILES_OF_ROS = (
    "ROS_SECURITY_KEYSTORE",
    "FASTRTPS_DEFAULT_PROFILES_FILE",
    "FASTDDS_DEFAULT_PROFILES_FILE",
    "FASTDDS_ENVIRONMENT_FILE",
    "CYCLONEDDS_URI",
    "NDDS_QOS_PROFILES",
    "ZENOH_ROUTER_CONFIG_URI",
    "ZENOH_SESSION_CONFIG_URI",
)


@dataclass(frozen=True, slots=True)
class Entry:
    """The command with which a client starts the server: an absolute path, arguments and environment."""

    command: str
    args: Sequence[str]
    env: Mapping[str, str]

    @property
    def json(self) -> dict[str, object]:
        """The entry in the format of nearly all clients."""
        return {"command": self.command, "args": list(self.args), "env": dict(self.env)}


@dataclass(frozen=True, slots=True)
class Address:
    """The URL and headers with which a client reaches a running server over HTTP."""

    url: str
    headers: Mapping[str, str]


@dataclass(frozen=True, slots=True)
class Client:
    """The place of a client's configuration, and its text for a server that the client starts, or for one over HTTP."""

    place: str
    text: Callable[[Entry], str]
    http: Callable[[Address], str]
    notes: Sequence[str] = ()
    """Hints for the user about the printed settings, or about settings elsewhere; one line each."""


def print_config(client: str, arguments: argparse.Namespace, settings: Settings) -> int:
    """Print the configuration on stdout, and on stderr where to put it and other hints.

    It contains the options of this command line and the settings of this environment.
    """
    if arguments.http:
        return _print_http(client, settings)
    words = {name: word for name, word in vars(arguments).items() if name in CARRIED and word is not None}
    provenance = own_provenance()
    command, *args = launch_command(provenance, wheel_distro() or "")
    variables = environment(os.environ, words, is_here=settings.is_here)
    if settings.is_here:
        variables = {**of_sourced_shell(settings, os.environ), **variables}
    if settings.socket:  # a server runs there, with its own settings
        entry = Entry(command, [*args, "connect", str(settings.socket.expanduser().absolute())], {})
    else:
        entry = Entry(command, [*args, *options(words, is_here=settings.is_here)], variables)
    _print_place(CLIENTS[client])
    local = settings.workspaces if settings.is_here else ()
    for missing in (folder for folder in local if not folder.expanduser().is_dir()):
        print(f"# warning: --workspace {missing} is not there: the server will not find its packages.", file=sys.stderr)
    if settings.transport != "stdio":
        print(
            "# The client starts the server and speaks stdio with it; what was set for HTTP is left out (see --http).",
            file=sys.stderr,
        )
    if not provenance.lasts:
        print(
            f"# This runs from a cache ({provenance.way}), where a client would not find it later: the configuration\n"
            "# lets it be fetched again. What is installed to stay starts faster: uv tool install, or pipx install.",
            file=sys.stderr,
        )
    print(CLIENTS[client].text(entry))
    return 0


def _print_http(client: str, settings: Settings) -> int:
    """Print the configuration with which a client reaches a server with these settings over HTTP.

    Raises:
        BadInput: for settings with which no server would start.
    """
    entrance = entrance_of(settings)
    if not entrance.tokens:
        headers: dict[str, str] = {}
    elif settings.token_file:
        headers = {"Authorization": "Bearer TOKEN"}
        print(
            f"# Put a token of {settings.token_file} where TOKEN stands: the file has none in the open.",
            file=sys.stderr,
        )
    else:
        headers = {"Authorization": f"Bearer {own_token(state_home())[0]}"}
    _print_place(CLIENTS[client])
    print(CLIENTS[client].http(Address(entrance.url.replace("//0.0.0.0", "//127.0.0.1"), headers)))
    return 0


def _print_place(client: Client) -> None:
    for line in (client.place, *client.notes):
        print(f"# {line}", file=sys.stderr)


# ── formats of the clients ─────────────────────────────────────────────────────────────────────────────────────


def _mcp_servers(entry: Entry) -> str:
    return _json({"mcpServers": {NAME: entry.json}})


def _mcp_servers_with(more: Mapping[str, object]) -> Callable[[Entry], str]:
    """Return the format of nearly all clients, with additional settings for one client."""
    return lambda entry: _json({"mcpServers": {NAME: {**entry.json, **more}}})


def _vscode(entry: Entry) -> str:
    return _json({"servers": {NAME: {"type": "stdio", **entry.json}}})


def _zed(entry: Entry) -> str:
    # Older versions read only entries with a source; newer ones ignore it.
    return _json({"context_servers": {NAME: {"source": "custom", **entry.json}}})


def _claude_code(entry: Entry) -> str:
    # `--env` takes all words that follow, so another option must stand between the last one and the name.
    variables = [word for name, value in entry.env.items() for word in ("--env", f"{name}={value}")]
    return typed(["claude", "mcp", "add", *variables, "--scope", "user", NAME, "--", entry.command, *entry.args])


# Where Codex cannot ask (`codex exec`), it refuses every tool that it would ask about. It must never refuse the stop.
_CODEX_SETTINGS = (
    "required = true",
    f"startup_timeout_sec = {_START_S}",
    f"tool_timeout_sec = {_CALL_S}",
    'tools = { ros2_stop = { approval_mode = "approve" } }',
)


def _codex(entry: Entry) -> str:
    lines = [f"[mcp_servers.{NAME}]", f"command = {_scalar(entry.command)}", f"args = {_scalar(entry.args)}"]
    lines += _CODEX_SETTINGS
    if entry.env:
        lines.append(f"[mcp_servers.{NAME}.env]")
        lines += [f"{name} = {_scalar(value)}" for name, value in entry.env.items()]
    return "\n".join(lines)


def _goose(entry: Entry) -> str:
    # JSON texts and lists are also YAML.
    settings: dict[str, object] = {
        "name": NAME,
        "description": "Eyes and hands on a ROS 2 robot",
        "type": "stdio",
        "enabled": True,
        "cmd": entry.command,
        "args": entry.args,
        "envs": entry.env,
        "env_keys": [],
        "timeout": _GOOSE_TIMEOUT_S,
    }
    return _extensions(settings)


def _opencode(entry: Entry) -> str:
    command = [entry.command, *entry.args]
    return _opencode_server({"type": "local", "command": command, "environment": dict(entry.env)})


def _http_opencode(at: Address) -> str:
    return _opencode_server({"type": "remote", "url": at.url, **({"headers": at.headers} if at.headers else {})})


def _opencode_server(settings: Mapping[str, object]) -> str:
    # The server reports progress every second, which restarts this time-out of a call.
    server = {**settings, "enabled": True, "timeout": _START_S * 1000}
    return _json({"$schema": "https://opencode.ai/config.json", "mcp": {NAME: server}})


def _extensions(settings: Mapping[str, object]) -> str:
    return "\n".join(
        ["extensions:", f"  {NAME}:", *(f"    {key}: {_scalar(value)}" for key, value in settings.items())]
    )


def _http_servers(
    url: str = "url", kind: str = "", within: str = "mcpServers", more: Mapping[str, object] = {}
) -> Callable[[Address], str]:
    """Return the format of nearly all clients. They differ in the name of the URL and in whether they name its kind."""

    def text(at: Address) -> str:
        named = {"type": kind} if kind else {}
        headers = {"headers": at.headers} if at.headers else {}
        return _json({within: {NAME: {**named, url: at.url, **headers, **more}}})

    return text


def _http_through_npx(at: Address) -> str:
    """Return the format of a client that only speaks stdio, with `mcp-remote` between. No argument contains a blank,
    because Windows would lose it.
    """
    headers = [word for name in at.headers for word in ("--header", f"{name}:${{{name.upper()}}}")]
    values = {name.upper(): value for name, value in at.headers.items()}
    return _mcp_servers(Entry("npx", ["-y", "mcp-remote", at.url, "--allow-http", *headers], values))


def _http_claude_code(at: Address) -> str:
    headers = [word for name, value in at.headers.items() for word in ("--header", f"{name}: {value}")]
    return typed(["claude", "mcp", "add", "--transport", "http", "--scope", "user", NAME, at.url, *headers])


def _http_codex(at: Address) -> str:
    headers = ", ".join(f"{_scalar(name)} = {_scalar(value)}" for name, value in at.headers.items())
    lines = [f"[mcp_servers.{NAME}]", f"url = {_scalar(at.url)}", f"http_headers = {{ {headers} }}"]
    return "\n".join([*lines[: 3 if at.headers else 2], *_CODEX_SETTINGS])


def _http_goose(at: Address) -> str:
    settings: dict[str, object] = {
        "name": NAME,
        "description": "Eyes and hands on a ROS 2 robot",
        "type": "streamable_http",
        "enabled": True,
        "uri": at.url,
        "headers": dict(at.headers),
        "timeout": _GOOSE_TIMEOUT_S,
    }
    return _extensions(settings)


def _json(value: object) -> str:
    return json.dumps(value, indent=2, ensure_ascii=False)


def _scalar(value: object) -> str:
    # Not escaped: TOML and YAML do not have JSON's surrogate pairs for characters beyond U+FFFF.
    return json.dumps(value, ensure_ascii=False, default=list)


CLIENTS: Mapping[str, Client] = {
    "claude-desktop": Client(
        "claude_desktop_config.json (Settings > Developer > Edit Config)", _mcp_servers, _http_through_npx
    ),
    "claude-code": Client(
        "Run this command. It holds for all your projects; with --scope local instead of user only for the project in\n"
        "# this folder, with --scope project for all who share it (.mcp.json)",
        _claude_code,
        _http_claude_code,
        (
            'To let the model stop the robot without asking you, add "mcp__ros2__ros2_stop" to permissions.allow in',
            "~/.claude/settings.json.",
        ),
    ),
    "vscode": Client(
        ".vscode/mcp.json in the project, or for all: Ctrl+Shift+P > MCP: Open User Configuration",
        _vscode,
        _http_servers(kind="http", within="servers"),
    ),
    "cursor": Client("~/.cursor/mcp.json, or .cursor/mcp.json in the project", _mcp_servers, _http_servers()),
    "codex": Client(
        "~/.codex/config.toml",
        _codex,
        _http_codex,
        (
            "required: Codex waits until the server has started, and does not start without it. Without this setting",
            "the model begins before it has the tools. approval_mode: the model may always stop the robot; Codex asks",
            "you before every other tool that acts, and refuses it in codex exec, where it cannot ask.",
        ),
    ),
    "gemini": Client(
        "~/.gemini/settings.json",
        _mcp_servers_with({"timeout": _CALL_S * 1000}),
        _http_servers("httpUrl", more={"timeout": _CALL_S * 1000}),
        (
            "Gemini CLI starts no server in a folder that you do not trust: /permissions shows and changes that; in a",
            "script, set GEMINI_CLI_TRUST_WORKSPACE=true. timeout: the longest call, in ms.",
        ),
    ),
    "opencode": Client(
        "~/.config/opencode/opencode.json, or opencode.json in the project",
        _opencode,
        _http_opencode,
        ("timeout: how long opencode waits for the server's start and for the progress of a call, in ms.",),
    ),
    "antigravity": Client(
        "mcp_config.json (... of the agent's panel > MCP Servers > Manage MCP Servers > View raw config);\n"
        "# ~/.gemini/config/mcp_config.json, in older versions ~/.gemini/antigravity/mcp_config.json",
        _mcp_servers,
        _http_servers("serverUrl"),
    ),
    "warp": Client(
        "Paste it at Settings > Agents > MCP servers > + Add, or into ~/.warp/.mcp.json", _mcp_servers, _http_servers()
    ),
    "windsurf": Client("~/.codeium/windsurf/mcp_config.json", _mcp_servers, _http_servers("serverUrl")),
    "cline": Client(
        "cline_mcp_settings.json (MCP Servers > Configure > Configure MCP Servers)",
        _mcp_servers_with({"timeout": MAX_DURATION_S}),
        _http_servers(kind="streamableHttp", more={"timeout": MAX_DURATION_S}),
        ("timeout: the longest call, in s. Cline ends a call after 60 s by default, and takes 3600 s at most.",),
    ),
    "zed": Client("settings.json (Ctrl+Shift+P > zed: open settings)", _zed, _http_servers(within="context_servers")),
    "goose": Client("~/.config/goose/config.yaml, below the extensions that are there", _goose, _http_goose),
    "lm-studio": Client("mcp.json (tab Program at the right > Install > Edit mcp.json)", _mcp_servers, _http_servers()),
    "jetbrains": Client(
        "Paste it at Settings > Tools > AI Assistant > Model Context Protocol (MCP) > Add, as JSON",
        _mcp_servers,
        _http_servers(),
    ),
}
"""All known clients, by their names on the command line."""


# ── settings that are carried over ─────────────────────────────────────────────────────────────────────────────


CARRIED: Mapping[str, Option] = {name: option for name, option in OPTIONS.items() if name not in _OF_HTTP}
"""The settings that a configuration carries over."""


def options(words: Mapping[str, str | Sequence[str]], *, is_here: bool = True) -> list[str]:
    """Return the given options as they are written, with absolute paths, because a client starts in its own folder.

    If the robot is not on this machine (`is_here` false), paths on the robot stay as they are.
    """
    return [word for name, given in words.items() for word in _written(OPTIONS[name], given, is_here)]


def _written(option: Option, given: str | Sequence[str], is_here: bool) -> Iterator[str]:
    for text in [given] if isinstance(given, str) else given:
        value = text if not is_here and option.name in _OF_THE_ROBOT else _absolute(option, text)
        if not option.takes_value or value == option.alone:
            yield option.flag
        elif value.startswith("-"):
            yield f"{option.flag}={value}"
        else:
            yield from (option.flag, value)


def _absolute(option: Option, text: str) -> str:
    if not option.kind.is_path:
        return text
    paths = text.split(os.pathsep) if option.kind.several else [text]
    # Symbolic links are kept: the Python of a virtual environment is one.
    return os.pathsep.join(str(Path(path).expanduser().absolute()) for path in paths if path)


def environment(
    variables: Mapping[str, str], words: Mapping[str, object] = {}, *, is_here: bool = True
) -> dict[str, str]:
    """Return the variables of this shell that are settings or determine which robot is seen, unless an option replaces
    them.

    For a remote robot (`is_here` false), the ROS variables of this machine have no effect, and are not included.
    """
    taken = {name: option for name, option in CARRIED.items() if name not in words and variables.get(option.variable)}
    if not is_here:
        return {
            option.variable: value if name in _OF_THE_ROBOT else _absolute(option, value)
            for name, option in taken.items()
            if option.variable.startswith(("ROS2_MCP_", "MCP_")) and (value := variables[option.variable])
        }
    ours = {option.variable: _absolute(option, variables[option.variable]) for option in taken.values()}
    of_ros = {name: variables[name] for name in _OF_ROS if variables.get(name)}
    files = {name: _absolute_files(variables[name]) for name in _FILES_OF_ROS if variables.get(name)}
    return {**ours, **of_ros, **files}


def _absolute_files(text: str) -> str:
    """Return the files in a variable of the middleware as absolute paths. A text that is XML itself stays as it is."""
    if "<" in text:
        return text
    address = "file://"
    return ",".join(
        (address if place.startswith(address) else "") + str(Path(place.removeprefix(address)).expanduser().absolute())
        for place in text.split(",")
        if place
    )


def of_sourced_shell(settings: Settings, variables: Mapping[str, str]) -> dict[str, str]:
    """Return variables with which a server in a client's bare environment finds the ROS 2 that is sourced in this
    shell.

    The first of these that works, tried as the server would: the distribution with the workspaces on top; the folder in
    which ROS 2 itself was built or unpacked; the variables of this shell, which become outdated when packages are
    added.
    """
    shell = without_ours(variables)
    here = sourced(search_of(settings), shell)
    if not here:
        return {}
    # colcon's setup files put the newest overlay first; overlays have to be sourced last. Other tools set only the
    # other variable.
    overlays = [path for path in reversed(path_entries(shell, "COLCON_PREFIX_PATH")) if (path / "setup.bash").is_file()]
    whole = next((path for path in (here.prefix, *here.prefix.parents) if (path / "setup.bash").is_file()), here.prefix)
    above = [path for path in overlays if path != whole]
    for distro, folders in ((here.distro, above), (None, [whole, *above])):
        added = {
            **({OPTIONS["distro"].variable: distro} if distro and not settings.distro else {}),
            **({OPTIONS["workspaces"].variable: os.pathsep.join(map(str, folders))} if folders else {}),
        }
        tried = replace(settings, distro=settings.distro or distro, workspaces=(*settings.workspaces, *folders))
        if (not settings.workspaces or not folders) and _finds(tried, here, path_entries(shell, "AMENT_PREFIX_PATH")):
            return added
    kept = {name: shell[name] for name in (*OF_A_SOURCED_SHELL, "LD_LIBRARY_PATH") if shell.get(name)}
    words = [*settings.robot_env, *(f"{name}={value}" for name, value in kept.items())]
    return {
        OPTIONS["robot_env"].variable: shlex.join(words),
        **({} if settings.bridge_python else {OPTIONS["bridge_python"].variable: here.python}),
    }


def _finds(settings: Settings, wanted: Found, prefixes: Sequence[Path]) -> bool:
    """Return whether the server finds this installation and all these prefixes with these settings alone."""
    try:
        found = find_ros(settings, {name: os.environ[name] for name in ("HOME",) if name in os.environ})
    except RobotError:
        return False
    folders = [found.prefix, *(script.parent for script in found.scripts)]
    return wanted.prefix.is_relative_to(found.prefix) and all(
        any(prefix.is_relative_to(folder) for folder in folders) for prefix in prefixes
    )
