"""What the how-tos tell people to paste is tried: the client's files, the unit, what manifests start."""

from __future__ import annotations

import json
import re
import shlex
import subprocess
import sys
from collections.abc import Callable, Iterator
from http.client import HTTPConnection
from pathlib import Path

import pytest

from ros2_mcp.guard.tokens import add_token
from ros2_mcp.settings import OPTIONS
from support.containers import WHERE_NONE, there_are_containers
from support.ports import free_port, until_listening
from support.processes import peer_command
from support.raw_server import MODERN, RawServer
from support.source import ROOT

PAGES = ROOT / "docs/how-to"
UNIT = ROOT / "deploy/systemd/ros2-mcp.service"
DOCKER = peer_command("docker_run")
END_S = 40.0
"""An answer, or the end of a server, on a machine that is busy with other tests."""


def blocks(page: str, language: str) -> list[str]:
    return re.findall(rf"```{language}\n(.*?)```", (PAGES / page).read_text("utf-8"), re.DOTALL)


def docker_commands() -> list[list[str]]:
    """Every way in which the page has a client start docker: its words behind `docker`."""
    of_files = [json.loads(block)["mcpServers"]["ros2"] for block in blocks("docker.md", "json")]
    assert {entry["command"] for entry in of_files} == {"docker"}
    lines = [shlex.split(line) for block in blocks("docker.md", "sh") for line in block.splitlines()]
    of_clients = [line[line.index("docker") + 1 :] for line in lines if line[:2] == ["claude", "mcp"]]
    assert len(of_files) == 2 and len(of_clients) == 1
    return [*(entry["args"] for entry in of_files), *of_clients]


@pytest.fixture
def start_raw(ros_environment: dict[str, str]) -> Iterator[Callable[..., RawServer]]:
    """Start a command that is to be a server, whose lines the test writes and reads itself."""
    servers: list[RawServer] = []

    def begin(command: list[str]) -> RawServer:
        servers.append(RawServer(ros_environment, command=command))
        return servers[-1]

    yield begin
    for server in servers:
        server.end()


@pytest.fixture
def robot_folder(tmp_path: Path) -> Path:
    """What the page calls /opt/robot: a workspace that has been built, and prompts."""
    (tmp_path / "ws/install").mkdir(parents=True)
    (tmp_path / "ws/install/setup.bash").write_text("", encoding="utf-8")
    (tmp_path / "prompts").mkdir()
    (tmp_path / "prompts/look.md").write_text("---\nname: look-around\n---\nLook around.\n", encoding="utf-8")
    return tmp_path


@pytest.mark.skipif(not there_are_containers(), reason=WHERE_NONE)
@pytest.mark.parametrize("number", range(3))
def test_what_a_client_pastes_starts_the_server_in_docker(
    start_raw: Callable[..., RawServer], robot_folder: Path, domain_id: int, number: int
) -> None:
    words = [
        word.replace("/opt/robot", str(robot_folder)).replace("ROS_DOMAIN_ID=0", f"ROS_DOMAIN_ID={domain_id}")
        for word in docker_commands()[number]
    ]
    server = start_raw(command=[*DOCKER, *words])
    server.begin(MODERN)
    tools = {tool["name"] for tool in server.ask("tools/list")["result"]["tools"]}
    assert ("ros2_topic_publish" in tools) == ("--read-only" not in words)
    assert server.call("ros2_status")["structuredContent"]["domain_id"] == domain_id
    prompts = {prompt["name"] for prompt in server.ask("prompts/list")["result"]["prompts"]}
    assert ("look-around" in prompts) == ("--prompts" in words)
    server.close()


def exec_start(folder: Path) -> list[str]:
    """The unit's command as systemd would run it, with this Python and credentials in that folder."""
    [line] = re.findall(r"^ExecStart=(.*)$", UNIT.read_text("utf-8"), re.MULTILINE)
    command, *words = shlex.split(line.replace("${CREDENTIALS_DIRECTORY}", str(folder)))
    assert command == "/opt/ros2-mcp/bin/ros2-mcp"
    return [sys.executable, "-m", "ros2_mcp", *words]


@pytest.fixture
def service(ros_environment: dict[str, str], tmp_path: Path) -> Iterator[tuple[int, str]]:
    """The port of a server that the unit's command has started, and the token of the how-to."""
    token = add_token(tmp_path / "tokens", "laptop", ["observe", "act", "stop"])
    port = free_port()
    words = [
        word
        for line in re.findall(r"^Environment=(.*)$", UNIT.read_text("utf-8"), re.MULTILINE)
        for word in line.split()
    ]
    variables = dict(word.replace("/var/lib", str(tmp_path)).split("=") for word in words)
    assert {"XDG_STATE_HOME", "XDG_CACHE_HOME", "ROS2_MCP_RECORD_DIR"} <= set(variables)
    process = subprocess.Popen(
        exec_start(tmp_path), env={**ros_environment, **variables, "ROS2_MCP_PORT": str(port)}, cwd="/"
    )
    try:
        until_listening("127.0.0.1", port)
        yield port, token
    finally:
        process.terminate()
        assert process.wait(END_S) == 0


def test_the_unit_serves_what_the_how_to_has_a_client_ask_for(service: tuple[int, str]) -> None:
    port, token = service
    [entry] = [json.loads(block)["mcpServers"]["ros2"] for block in blocks("service.md", "json")]
    path = entry["url"].removeprefix("http://127.0.0.1:8123")
    hello = {"protocolVersion": "2025-11-25", "capabilities": {}, "clientInfo": {"name": "pasted", "version": "1"}}
    body = json.dumps({"jsonrpc": "2.0", "id": 1, "method": "initialize", "params": hello})
    usual = {"Accept": "application/json, text/event-stream", "Content-Type": "application/json"}
    statuses: dict[str, int] = {}
    for what, header in (("with", entry["headers"]["Authorization"].replace("TOKEN", token)), ("without", "Bearer no")):
        connection = HTTPConnection("127.0.0.1", port, timeout=END_S)
        connection.request("POST", path, body, {**usual, "Authorization": header})
        statuses[what] = connection.getresponse().status
        connection.close()
    assert statuses == {"with": 200, "without": 401}


def test_the_environment_file_of_the_how_to_has_only_variables_that_there_are() -> None:
    [file] = [block for block in blocks("service.md", "sh") if block.startswith("ROS_DOMAIN_ID=")]
    names = {line.partition("=")[0] for line in file.splitlines() if not line.startswith("#")}
    known = {option.variable for option in OPTIONS.values()}
    assert names - known == {"FASTDDS_BUILTIN_TRANSPORTS"}  # Fast DDS's own


def test_the_files_that_the_how_tos_name_are_there() -> None:
    text = "".join((PAGES / page).read_text("utf-8") for page in ("docker.md", "service.md"))
    named = set(re.findall(r"(?<![\w/-])(deploy/[\w./-]+\w|compose\.yaml|Dockerfile)", text))
    assert {"deploy/systemd/ros2-mcp.service", "compose.yaml", "Dockerfile"} <= named
    assert {path for path in named if not (ROOT / path).is_file()} == set()
