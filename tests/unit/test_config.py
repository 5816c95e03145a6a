"""What `ros2-mcp config CLIENT` prints is read back as the client reads it."""

from __future__ import annotations

import json
import os
import shlex
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from ruamel.yaml import YAML

from ros2_mcp import cli
from ros2_mcp.cli import parser, run, settings_from
from ros2_mcp.commands import config
from ros2_mcp.commands.config import CARRIED, CLIENTS, Entry, environment, of_sourced_shell, options
from ros2_mcp.link.environment import find_ros
from ros2_mcp.link.provenance import Provenance
from ros2_mcp.settings import OPTIONS, Settings

COMMAND = "/opt/my tools/bin/ros2-mcp"
ARGS = ["--read-only", "--workspace", '/a "quoted"\\place: {ö} # 🤖', "--distro", "no"]
VARIABLES = {"ROS_DOMAIN_ID": "42", "CYCLONEDDS_URI": '<CycloneDDS><Domain Id="any"/></CycloneDDS>'}
ENTRY = {"command": COMMAND, "args": ARGS, "env": VARIABLES}


def printed(client: str, variables: dict[str, str] = VARIABLES) -> str:
    return CLIENTS[client].text(Entry(COMMAND, ARGS, variables))


@pytest.mark.promise("README", "config prints the exact configuration for your client")
@pytest.mark.parametrize(
    "client",
    [
        *("claude-desktop", "cursor", "antigravity", "warp", "windsurf", "lm-studio", "jetbrains"),
    ],
)
def test_most_clients_read_it_as_json(client: str) -> None:
    assert json.loads(printed(client)) == {"mcpServers": {"ros2": ENTRY}}


@pytest.mark.parametrize(("client", "timeout"), [("gemini", 3_660_000), ("cline", 3600)])
def test_clients_that_end_a_long_call_are_told_how_long_one_may_take(client: str, timeout: int) -> None:
    """Gemini CLI counts in ms; Cline in s, and takes an hour at most."""
    assert json.loads(printed(client)) == {"mcpServers": {"ros2": {**ENTRY, "timeout": timeout}}}


def test_opencode_reads_it_as_json_of_its_own_form() -> None:
    server = json.loads(printed("opencode"))["mcp"]["ros2"]
    assert server == {
        "type": "local",
        "command": [COMMAND, *ARGS],
        "environment": VARIABLES,
        "enabled": True,
        "timeout": 60_000,
    }


def test_vscode_reads_it_as_json_of_its_own_form() -> None:
    assert json.loads(printed("vscode")) == {"servers": {"ros2": {"type": "stdio", **ENTRY}}}


def test_zed_reads_it_as_a_context_server_of_its_settings() -> None:
    assert json.loads(printed("zed")) == {"context_servers": {"ros2": {"source": "custom", **ENTRY}}}


@pytest.mark.parametrize("variables", [VARIABLES, {}])
def test_goose_reads_it_as_an_extension_in_yaml(variables: dict[str, str]) -> None:
    read: dict[str, Any] = YAML(typ="safe", pure=True).load(printed("goose", variables))
    extension = read["extensions"]["ros2"]
    assert {name: extension[name] for name in ("cmd", "args", "envs")} == {
        "cmd": COMMAND,
        "args": ARGS,
        "envs": variables,
    }
    assert (extension["type"], extension["enabled"], extension["name"]) == ("stdio", True, "ros2")
    assert (extension["env_keys"], extension["timeout"]) == ([], 300)


def test_claude_code_takes_one_command_for_all_projects() -> None:
    words = shlex.split(printed("claude-code"))
    assert words[: words.index("--")] == [
        *(
            "claude",
            "mcp",
            "add",
            "--env",
            "ROS_DOMAIN_ID=42",
            "--env",
            f"CYCLONEDDS_URI={VARIABLES['CYCLONEDDS_URI']}",
        ),
        *("--scope", "user", "ros2"),
    ]
    assert words[words.index("--") + 1 :] == [COMMAND, *ARGS]


@pytest.mark.skipif(sys.version_info < (3, 11), reason="Python 3.10 cannot read TOML")
@pytest.mark.parametrize("variables", [VARIABLES, {}])
def test_codex_reads_it_as_toml(variables: dict[str, str]) -> None:
    import tomllib

    read: dict[str, Any] = tomllib.loads(printed("codex", variables))
    server = read["mcp_servers"]["ros2"]
    assert {name: server.get(name, {}) for name in ENTRY} == {**ENTRY, "env": variables}
    assert {name: value for name, value in server.items() if name not in ENTRY} == {
        "required": True,
        "startup_timeout_sec": 60,
        "tool_timeout_sec": 3660,
        "tools": {"ros2_stop": {"approval_mode": "approve"}},
    }


@pytest.mark.promise("README", "the clients are claude-desktop")
def test_the_command_line_offers_every_client() -> None:
    assert list(cli.CLIENTS) == list(CLIENTS)


@pytest.mark.promise("README", "and says where it goes")
@pytest.mark.parametrize("client", CLIENTS)
def test_stdout_is_the_configuration_and_stderr_says_where_it_goes(
    client: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run(["--read-only", "config", client]) == 0
    out, err = capsys.readouterr()
    assert "--read-only" in out
    assert f"config {client}" not in out
    assert all(line.startswith("# ") for line in err.splitlines()) and err


def carried(*argv: str) -> list[str]:
    words = vars(parser().parse_args(argv))
    return options({name: word for name, word in words.items() if name in OPTIONS and word is not None})


@pytest.mark.promise("README", "it needs the absolute path of the command, as ros2-mcp config prints it")
def test_paths_become_absolute_each_of_several_too_and_links_stay(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "python").symlink_to(sys.executable)
    given = ["--bridge-python", "python", "--workspace", f"a{os.pathsep}/b", "--domain-id", "7"]
    assert sorted(carried(*given)) == sorted(
        [
            *("--bridge-python", f"{tmp_path}/python"),
            *("--workspace", f"{tmp_path}/a{os.pathsep}/b"),
            *("--domain-id", "7"),
        ]
    )


@pytest.mark.parametrize("name", [name for name, option in OPTIONS.items() if option.kind.is_path])
@pytest.mark.parametrize("form", ["{flag} x/y", "{flag}=x/y", "{short} x/y"])
def test_the_path_of_every_option_becomes_absolute_however_it_is_written(
    name: str, form: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    flag = OPTIONS[name].flag
    flags = [option.flag for option in OPTIONS.values()]
    # argparse takes the shortest beginning that no other option has.
    lengths = (n for n in range(3, len(flag) + 1) if sum(other.startswith(flag[:n]) for other in flags) == 1)
    argv = form.format(flag=flag, short=flag[: next(lengths, len(flag))]).split()
    assert carried(*argv) == [flag, f"{tmp_path}/x/y"]


def test_a_path_of_a_variable_becomes_absolute_too(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("HOME", "/var/me")
    shell = {
        "ROS2_MCP_PROMPTS": "p",
        "ROS2_MCP_WORKSPACE": "~/ws:b",
        "FASTRTPS_DEFAULT_PROFILES_FILE": "fast.xml",
        "CYCLONEDDS_URI": "file://cyclone.xml,file:///etc/more.xml",
        "ZENOH_SESSION_CONFIG_URI": "zenoh.json5",
        "ROS_SECURITY_KEYSTORE": "keys",
    }
    assert environment(shell) == {
        "ROS2_MCP_PROMPTS": f"{tmp_path}/p",
        "ROS2_MCP_WORKSPACE": f"/var/me/ws:{tmp_path}/b",
        "FASTRTPS_DEFAULT_PROFILES_FILE": f"{tmp_path}/fast.xml",
        "CYCLONEDDS_URI": f"file://{tmp_path}/cyclone.xml,file:///etc/more.xml",
        "ZENOH_SESSION_CONFIG_URI": f"{tmp_path}/zenoh.json5",
        "ROS_SECURITY_KEYSTORE": f"{tmp_path}/keys",
    }


def test_options_with_an_optional_value_and_those_given_again_are_kept_as_they_were() -> None:
    assert carried("--black-box") == ["--black-box"]
    assert carried("--black-box", "/odom,/scan") == ["--black-box", "/odom,/scan"]
    assert carried("--workspace", "/a", "--workspace", "/b") == ["--workspace", "/a", "--workspace", "/b"]
    assert carried("--custom-prompts", "false", "--read-only") == ["--read-only", "--custom-prompts", "false"]


@pytest.mark.promise("README", "Options before the word config are carried over into it")
@pytest.mark.parametrize(
    "argv",
    [
        ["--black-box", "--workspace", "/a", "--workspace", "/b", "--rmw=-odd"],
        ["--read-only", "--tools", "all", "--prompts", "/p", "--custom-prompts", "--domain-id", "7"],
    ],
)
def test_the_server_that_the_client_starts_has_the_settings_that_were_given(argv: list[str]) -> None:
    assert settings_from(parser().parse_args(carried(*argv))) == settings_from(parser().parse_args(argv))


@pytest.mark.promise("README", "so is what your shell says of ROS: domain, middleware, discovery, security")
def test_only_variables_that_decide_which_robot_is_seen_and_how_are_passed_on() -> None:
    shell = {"ROS_DOMAIN_ID": "7", "HOME": "/somewhere", "RMW_IMPLEMENTATION": "", "SECRET": "x", "PATH": "/bin"}
    assert environment(shell) == {"ROS_DOMAIN_ID": "7"}
    matters = {
        "ROS2_MCP_READONLY": "1",
        "ROS_DISCOVERY_SERVER": "10.0.0.1:11811",
        "ROS_SUPER_CLIENT": "TRUE",
        "ROS_STATIC_PEERS": "10.0.0.2",
        "ROS_SECURITY_ENABLE": "true",
        "ROS_SECURITY_STRATEGY": "Enforce",
        "ZENOH_CONFIG_OVERRIDE": 'connect/endpoints=["tcp/10.0.0.1:7447"]',
        "CYCLONEDDS_URI": VARIABLES["CYCLONEDDS_URI"],
    }
    assert environment(matters) == matters


def test_every_variable_of_this_server_is_passed_on_but_those_of_http() -> None:
    shell = {option.variable: "/1" for option in CARRIED.values()}
    assert environment({**shell, "ROS2_MCP_TRANSPORT": "streamable-http", "ROS2_MCP_PORT": "1"}) == shell


def test_what_was_set_for_http_is_left_out_and_said_so(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("ROS2_MCP_PORT", "9000")
    assert run(["--transport", "streamable-http", "--read-only", "config", "cursor"]) == 0
    out, err = capsys.readouterr()
    entry = json.loads(out)["mcpServers"]["ros2"]
    assert entry["args"][-1] == "--read-only" and "--transport" not in entry["args"]
    assert "ROS2_MCP_PORT" not in entry["env"]
    assert "speaks stdio" in err


def test_a_variable_that_an_option_overrides_is_not_passed_on() -> None:
    assert environment({"ROS_DOMAIN_ID": "7", "ROS2_MCP_TOOLS": "all"}, {"domain_id": "9"}) == {"ROS2_MCP_TOOLS": "all"}


@pytest.mark.promise("README", "sourced workspaces")
def test_what_is_sourced_in_the_shell_is_sourced_for_the_client(tmp_path: Path) -> None:
    for folder in ("ros/humble", "ros/jazzy", "under/install", "over/install"):
        (tmp_path / folder).mkdir(parents=True)
        (tmp_path / folder / "setup.bash").touch()
    package = with_rclpy(tmp_path / "ros/humble")
    shell = {
        "ROS_DISTRO": "humble",
        "AMENT_PREFIX_PATH": f"{tmp_path}/over/install/own:{tmp_path}/ros/humble",
        "PYTHONPATH": str(package.parent),
        "COLCON_PREFIX_PATH": f"{tmp_path}/over/install:{tmp_path}/gone:{tmp_path}/under/install",
    }
    assert of_sourced_shell(Settings(ros_root=tmp_path / "ros"), shell) == {
        "ROS2_MCP_DISTRO": "humble",
        "ROS2_MCP_WORKSPACE": f"{tmp_path}/under/install:{tmp_path}/over/install",
    }
    given = Settings(ros_root=tmp_path / "ros", distro="jazzy", workspaces=(Path("/ws"),))
    assert of_sourced_shell(given, shell) == {}
    assert of_sourced_shell(Settings(ros_root=tmp_path / "elsewhere"), {"ROS_DISTRO": "humble"}) == {}


def with_rclpy(prefix: Path) -> Path:
    package = prefix / "lib" / "python3" / "site-packages" / "rclpy"
    package.mkdir(parents=True)
    return package


def merged(root: Path) -> tuple[Path, str, Path]:
    """Built from source with --merge-install."""
    prefix = root / "ros2_jazzy" / "install"
    package = with_rclpy(prefix)
    (prefix / "setup.bash").touch()
    told = prefix / "share" / "ros_environment" / "environment" / "1.ros_distro.sh"
    told.parent.mkdir(parents=True)
    told.write_text("export ROS_DISTRO=jazzy\n")
    return prefix, str(prefix), package


def isolated(root: Path) -> tuple[Path, str, Path]:
    """Built from source, a folder for each package."""
    prefix = root / "src" / "install"
    package = with_rclpy(prefix / "rclpy")
    (prefix / "setup.bash").touch()
    return prefix, f"{prefix}/rclpy:{prefix}/std_msgs", package


def robostack(root: Path) -> tuple[Path, str, Path]:
    """An environment of conda that is where nobody looks."""
    prefix = root / "envs" / "ros"
    package = with_rclpy(prefix)
    (prefix / "conda-meta").mkdir()
    (prefix / "conda-meta" / "ros-jazzy-rclpy-7.1.4-py312h2ed9cc7_13.json").touch()
    (prefix / "setup.bash").touch()
    return prefix, str(prefix), package


def nix(root: Path) -> tuple[Path, str, Path]:
    """Packages each in the store, with nothing to source."""
    package = with_rclpy(root / "store" / "abc-rclpy")
    return root / "store" / "abc-rclpy", f"{root}/store/abc-rclpy:{root}/store/def-std-msgs", package


@pytest.mark.parametrize("colcon", [True, False])
@pytest.mark.parametrize("layout", [merged, isolated, robostack, nix])
def test_a_ros_anywhere_that_is_sourced_is_found_with_what_is_printed_and_nothing_else(
    tmp_path: Path, layout: Callable[[Path], tuple[Path, str, Path]], colcon: bool
) -> None:
    prefix, ament, package = layout(tmp_path)
    bare = {"HOME": str(tmp_path / "home"), "ROS2_MCP_ROS_ROOT": str(tmp_path / "none")}
    shell = {**bare, "ROS_DISTRO": "jazzy", "AMENT_PREFIX_PATH": ament, "PYTHONPATH": str(package.parent)}
    if colcon:
        shell["COLCON_PREFIX_PATH"] = str(prefix)
    printed = of_sourced_shell(Settings.from_environment(shell), shell)
    found = find_ros(Settings.from_environment({**bare, **printed}), bare)
    assert found.prefix == prefix
    if layout is nix:  # nothing to source: its variables are printed
        assert (found.kind, found.environment["AMENT_PREFIX_PATH"], found.environment["ROS_DISTRO"]) == (
            *("sourced", ament, "jazzy"),
        )
    else:
        assert (found.kind, found.scripts) == ("built", (prefix / "setup.bash",))
        assert set(printed) == {"ROS2_MCP_WORKSPACE"}


def test_a_path_in_a_cache_is_never_printed_and_why_is_said(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    cache = Path("/var/me/.cache/uv/archive-v0/x1")
    thrown_away = Provenance(way="uvx", prefix=cache, python=f"{cache}/bin/python", source="/src/ros2-mcp")
    monkeypatch.setattr(config, "own_provenance", lambda: thrown_away)
    monkeypatch.setenv("UV", "/opt/bin/uv")
    assert run(["config", "cursor"]) == 0
    out, err = capsys.readouterr()
    entry = json.loads(out)["mcpServers"]["ros2"]
    assert entry["command"] == "/opt/bin/uv"
    assert entry["args"][:2] == ["tool", "run"] and entry["args"][-1] == "ros2-mcp"
    assert ".cache" not in out
    assert "cache (uvx)" in err


def test_a_workspace_that_is_not_there_is_warned_of(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    gone = tmp_path / "gone"
    assert run(["--workspace", str(tmp_path), "--workspace", str(gone), "config", "cursor"]) == 0
    out, err = capsys.readouterr()
    assert str(gone) in out and err.count("warning") == 1
    assert f"# warning: --workspace {gone} is not there" in err


def test_for_a_robot_elsewhere_its_paths_stay_as_they_are_and_variables_of_this_ros_stay_here(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("ROS_DOMAIN_ID", "5")
    monkeypatch.setenv("ROS_STATIC_PEERS", "a")
    monkeypatch.setenv("ROS_DISTRO", "jazzy")
    monkeypatch.setenv("ROS2_MCP_BRIDGE_PYTHON", "venv/bin/python")
    assert run(["config", "cursor", "--robot", "ssh://me@robot", "--workspace", "ws"]) == 0
    printed = capsys.readouterr()
    entry = json.loads(printed.out)["mcpServers"]["ros2"]
    assert entry["args"][-4:] == ["--robot", "ssh://me@robot", "--workspace", "ws"]
    assert entry["env"] == {"ROS2_MCP_BRIDGE_PYTHON": "venv/bin/python"}
    assert "warning" not in printed.err
