"""One composition: a recording or a robot, from the command line, as a server and as a library."""

from __future__ import annotations

import json
import re
import textwrap
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from mcp import Client
from starlette.requests import Request

import ros2_mcp
from ros2_mcp.bags.stored import StoredTopic
from ros2_mcp.bags.writer import BagWriter
from ros2_mcp.cli import run
from ros2_mcp.compose.server import assemble
from ros2_mcp.mcp.leases import principal_of, principal_of_session
from ros2_mcp.model.commands import LOCAL
from ros2_mcp.model.errors import BadInput
from ros2_mcp.model.samples import Sample
from ros2_mcp.settings import Settings
from support.made_windows import encoded
from support.structured import META


@pytest.fixture
def bag(tmp_path: Path) -> Path:
    """A recording with one message on /count."""
    folder = tmp_path / "run"
    folder.mkdir()
    writer = BagWriter(folder, folder.name)
    writer.add_topic(StoredTopic("/count", "std_msgs/msg/Int32", None, "ros2msg", "int32 data\n"))
    writer.write("/count", Sample(1_700_000_000_000_000_000, 0, 1, encoded("std_msgs/msg/Int32", {"data": 41})))
    writer.close()
    return folder


def test_a_tool_is_called_on_a_recording_from_the_command_line(bag: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run(["--bag", str(bag), "call", "ros2_topic_echo_wait", "topic_name=/count", "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["message"] == {"data": 41}


def test_the_command_line_lists_what_can_be_asked_of_a_recording(bag: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run(["--bag", str(bag), "call"]) == 0
    listed = [line.split()[0] for line in capsys.readouterr().out.splitlines() if line]
    assert "ros2_topic_subscribe" in listed and "ros2_topic_publish" not in listed


@pytest.mark.parametrize("mode", ["legacy", "auto"])
async def test_a_client_of_either_era_reads_a_recording(bag: Path, mode: str) -> None:
    assembly = assemble(Settings(bag=bag))
    async with assembly.running(), Client(assembly.server, mode=mode) as client:
        assert (await client.list_resources()).resources == []
        result = await client.call_tool("ros2_topic_echo_wait", {"topic_name": "/count"}, meta=META)
        assert result.structured_content and result.structured_content["message"] == {"data": 41}
        refused = await client.call_tool("ros2_topic_publish", {})
        assert refused.is_error and "is a recording" in refused.content[0].text


def test_a_group_that_does_not_exist_is_refused() -> None:
    with pytest.raises(BadInput, match="no group of tools 'measures'"):
        assemble(Settings(tools=("measures",)))


def test_the_example_of_the_library_does_what_it_says(bag: Path, capsys: pytest.CaptureFixture[str]) -> None:
    example = re.search(r"::\n\n((?: {4}.*\n|\n)+)", ros2_mcp.__doc__ or "")
    assert example
    program = textwrap.dedent(example[1]).replace("read_only=True", f"bag={bag!r}").replace("scan", "count")
    exec(compile(f"from pathlib import PosixPath\n{program}", "example", "exec"), {})
    assert capsys.readouterr().out == "['/count']\n"


@pytest.mark.parametrize("name", ros2_mcp.__all__)
def test_what_the_library_offers_is_there(name: str) -> None:
    assert getattr(ros2_mcp, name).__doc__


@pytest.mark.promise(
    "stopping", "In the modern era of MCP, clients of the same name and version at one address count as one"
)
def test_who_asks_is_one_over_stdio_and_one_for_each_session_or_program_over_http() -> None:
    def principal(headers: dict[str, str], program: str = "a", address: str = "10.0.0.1") -> str:
        raw = [(name.encode(), value.encode()) for name, value in headers.items()]
        scope = {"type": "http", "path": "/mcp", "headers": raw, "query_string": b"", "client": (address, 4711)}
        params = SimpleNamespace(client_info=SimpleNamespace(name=program, version="1"))
        asked: Any = SimpleNamespace(request=Request(scope), session=SimpleNamespace(client_params=params))
        return principal_of(asked).name

    asked: Any = SimpleNamespace(request=None)
    assert principal_of(asked) == LOCAL
    mine, yours = principal({"mcp-session-id": "a"}), principal({"mcp-session-id": "b"})
    programs = principal({}), principal({}, program="b"), principal({}, address="10.0.0.2")
    assert len({mine, yours, *programs}) == 5
    assert principal({"mcp-session-id": "a"}) == mine == principal_of_session("a").name
    assert principal({"mcp-session-id": "a", "mcp-protocol-version": "2025-11-25"}) == mine
    assert principal({"mcp-session-id": "a", "mcp-protocol-version": "2026-07-28"}) == programs[0]  # has no sessions


@pytest.mark.parametrize("group", ["memory", "relay", "actions", "services", "parameters", "lifecycle"])
def test_whatever_can_act_comes_with_what_stops_it(group: str) -> None:
    offered = assemble(Settings(tools=(group,))).toolset.by_name
    assert offered["ros2_stop"].listed.annotations
    assert not offered["ros2_stop"].listed.annotations.destructive_hint  # clients must not ask before they stop


@pytest.mark.parametrize("settings", [Settings(tools=("pictures",)), Settings(tools=("all",), read_only=True)])
def test_where_nothing_acts_nothing_has_to_be_stopped(settings: Settings) -> None:
    toolset = assemble(settings).toolset
    assert "ros2_stop" not in toolset.by_name and "ros2_stop" in toolset.missing
