"""What the text of each tool's result looks like, with something in every field."""

from __future__ import annotations

import pytest

from ros2_mcp.ops.results.text import as_text
from ros2_mcp.tools import TOOLS, ToolDeclaration
from support.made_results import made
from support.snapshots import assert_as_snapshot


def room_of(tool: ToolDeclaration) -> str:
    return tool.function.__module__.rpartition(".")[2]


@pytest.mark.parametrize("room", sorted({room_of(tool) for tool in TOOLS}))
def test_the_texts_of_a_rooms_results_are_as_their_snapshot(room: str) -> None:
    tools = [tool for tool in TOOLS if room_of(tool) == room]
    assert_as_snapshot(room, {tool.name: as_text(made(tool.signature().return_annotation)) for tool in tools})
