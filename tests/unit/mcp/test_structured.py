"""Structured content is for who asks for it: a model gets text and pictures, whatever its client does with JSON."""

from __future__ import annotations

from pathlib import Path

import pytest
from mcp import Client
from mcp.types import ImageContent

from ros2_mcp.compose.server import assemble
from ros2_mcp.settings import Settings
from support.room_bag import room_bag
from support.structured import META

READS = {"bag": "room", "topic_name": "/odom", "limit": 2}


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("bags")
    room_bag(folder / "room")
    return folder


def server(folder: Path, *, structured: bool = False):
    return assemble(Settings(bag=folder / "room", structured=structured)).server


async def test_without_being_asked_a_server_sends_text_and_pictures_alone(folder: Path) -> None:
    async with Client(server(folder)) as client:
        assert all(tool.output_schema is None for tool in (await client.list_tools()).tools)
        scene = await client.call_tool("ros2_scene", {})
        assert scene.structured_content is None
        assert any(isinstance(part, ImageContent) for part in scene.content)


async def test_who_asks_gets_structured_content_beside_the_same_text(folder: Path) -> None:
    async with Client(server(folder)) as client:
        plain = await client.call_tool("ros2_bag_read", READS)
        assert all(tool.output_schema for tool in (await client.list_tools(meta=META)).tools)
        both = await client.call_tool("ros2_bag_read", READS, meta=META)
        assert both.content == plain.content
        assert both.structured_content
        assert next(iter(both.structured_content)) == "summary"
        assert both.content[0].text.startswith(both.structured_content["summary"])  # type: ignore[union-attr]
        assert len(both.structured_content["messages"]) == 2
        assert not [name for name, value in both.structured_content.items() if value in ("", [], None)]


async def test_a_server_that_was_told_to_sends_structured_content_to_everybody(folder: Path) -> None:
    async with Client(server(folder, structured=True)) as client:
        assert all(tool.output_schema for tool in (await client.list_tools()).tools)
        assert (await client.call_tool("ros2_bag_read", READS)).structured_content
