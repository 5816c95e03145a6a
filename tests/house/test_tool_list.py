"""What clients and users rely on: the tools' list and its documentation are never out of date."""

from __future__ import annotations

import asyncio

import pytest
from generate import REFERENCE, SETTINGS, SNAPSHOT, reference, served_tools, settings_reference, snapshot

from ros2_mcp.assembly import Assembly, assemble
from ros2_mcp.binding import CallFailed
from ros2_mcp.ops.results import silent
from ros2_mcp.settings import Settings
from ros2_mcp.tools import TOOLS

LESS = ("measure", "pictures", "services", "actions", "parameters", "memory")
OUT_OF_DATE = "run: python docs/generate.py, look at the difference, and commit it"


def made(*groups: str, read_only: bool = False) -> Assembly:
    return assemble(Settings(tools=groups, read_only=read_only))


def listed(*groups: str, read_only: bool = False) -> list[str]:
    return list(made(*groups, read_only=read_only).toolset.by_name)


def test_the_list_of_tools_is_as_its_snapshot() -> None:
    assert SNAPSHOT.read_text(encoding="utf-8") == snapshot(served_tools()), OUT_OF_DATE


def test_the_reference_describes_the_tools_as_they_are() -> None:
    assert REFERENCE.read_text(encoding="utf-8") == reference(served_tools()), OUT_OF_DATE


def test_the_reference_describes_the_settings_as_they_are() -> None:
    assert SETTINGS.read_text(encoding="utf-8") == settings_reference(), OUT_OF_DATE


def test_every_tool_is_described_in_the_reference() -> None:
    text = REFERENCE.read_text(encoding="utf-8")
    assert [tool.name for tool in TOOLS if f"\n## {tool.name}\n" not in text] == []


def test_the_order_of_tools_is_the_order_of_their_declaration() -> None:
    assert listed("all") == [tool.name for tool in TOOLS]


def test_a_read_only_server_has_no_tool_that_writes() -> None:
    assert listed("all", read_only=True) == [tool.name for tool in TOOLS if tool.risk == "read"]


def test_a_server_without_chosen_groups_has_the_default_tools() -> None:
    assert listed(*Settings().tools) == [tool.name for tool in TOOLS if tool.by_default]


def test_a_group_can_be_added_to_the_default_tools() -> None:
    chosen = [tool.name for tool in TOOLS if tool.by_default or tool.group == "lifecycle"]
    assert listed("default", "lifecycle") == chosen


def test_a_server_has_only_the_groups_that_were_chosen() -> None:
    assert listed("core") == [tool.name for tool in TOOLS if tool.group == "core"]


def test_a_server_says_which_groups_have_tools_that_are_left_out() -> None:
    assert "(lifecycle, relay)" in str(made("core", *LESS).server.instructions)
    assert "left out" not in str(made("all", read_only=True).server.instructions)


def test_a_tool_that_there_is_not_is_refused_with_the_nearest_name() -> None:
    with pytest.raises(CallFailed, match=r"There is no tool ros2_topic_lists\. Did you mean ros2_topic_list\?"):
        asyncio.run(made().toolset.call("ros2_topic_lists", {}, silent))
