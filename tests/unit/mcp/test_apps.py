"""What a client gets that shows pages beside the chat (MCP Apps), and one that does not."""

from __future__ import annotations

from collections.abc import AsyncGenerator
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Any

import pytest
from mcp import Client
from mcp.types import TextResourceContents

from ros2_mcp.compose.server import Assembly, assemble
from ros2_mcp.mcp import apps
from ros2_mcp.settings import Settings
from ros2_mcp.tools import PAGE_TOOLS, TOOLS
from ros2_mcp.view.page import page
from support.chat_host import APPS
from support.room_bag import room_bag
from support.structured import META

BOTH_ERAS = pytest.mark.parametrize("mode", ["legacy", "auto"])


@asynccontextmanager
async def client_of(assembly: Assembly, *, shows_pages: bool, mode: Any = "auto") -> AsyncGenerator[Client]:
    extensions = [APPS] if shows_pages else []
    async with assembly.running(), Client(assembly.server, mode=mode, extensions=extensions) as client:
        yield client


@pytest.fixture(scope="module")
def bag(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return room_bag(tmp_path_factory.mktemp("bags") / "room")


@pytest.mark.promise("README", "In a chat that shows pages")
@BOTH_ERAS
async def test_who_shows_pages_is_offered_them_and_the_page_itself(bag: Path, mode: str) -> None:
    async with client_of(assemble(Settings(bag=bag)), shows_pages=True, mode=mode) as client:
        tools = {tool.name: tool for tool in (await client.list_tools()).tools}
        marks = {name: tool.meta or {} for name, tool in tools.items()}
        uri = marks["ros2_view"]["ui/resourceUri"]
        assert marks["ros2_view"]["ui"] == {"resourceUri": uri, "visibility": ["model"]}
        assert {name for name, mark in marks.items() if mark["ui"]["visibility"] == ["app"]} == {
            tool.name for tool in PAGE_TOOLS
        }
        assert [str(row.uri) for row in (await client.list_resources()).resources] == [uri]
        (content,) = (await client.read_resource(uri)).contents
        assert isinstance(content, TextResourceContents)
        assert (content.mime_type, content.text) == (apps.MIME_TYPE, page().html.decode())


@BOTH_ERAS
async def test_who_shows_no_pages_is_not_told_of_them(bag: Path, mode: str) -> None:
    async with client_of(assemble(Settings(bag=bag)), shows_pages=False, mode=mode) as client:
        tools = (await client.list_tools()).tools
        assert {tool.name for tool in tools}.isdisjoint({tool.name for tool in PAGE_TOOLS})
        assert not [tool.name for tool in tools if "ui" in (tool.meta or {})]
        assert (await client.list_resources()).resources == []


def test_a_page_may_call_nothing_that_acts_but_the_stop() -> None:
    for settings in (Settings(tools=("all",)), Settings(read_only=True), Settings()):
        listed = apps.marked(assemble(settings).fleet.listed_with_pages)
        risks = {tool.name: tool.risk for tool in (*TOOLS, *PAGE_TOOLS)}
        callable_by_pages = {tool.name for tool in listed if "app" in (tool.meta or {})["ui"]["visibility"]}
        assert {name for name in callable_by_pages if risks[name] != "read"} == {"ros2_view_stop"}
        assert callable_by_pages == {tool.name for tool in PAGE_TOOLS}


@pytest.mark.promise("README", "elsewhere the agent tells the command")
async def test_without_a_page_there_is_a_picture_and_the_command(bag: Path) -> None:
    async with client_of(assemble(Settings(bag_dir=bag.parent)), shows_pages=False) as client:
        answer = await client.call_tool("ros2_view", {"bag": "room"}, meta=META)
        assert not answer.is_error, answer.content
        assert "ros2-mcp view --bag room" in answer.content[0].text
        assert [block.type for block in answer.content] == ["text", "image"]


async def test_the_names_of_the_existing_viewer_lead_to_the_page(bag: Path) -> None:
    asked = {
        "auto_start": True,
        "preferred_kind": "plot",
        "topic_name": "/odom",
        "plot_fields": ["twist.twist.linear.x"],
    }
    async with client_of(assemble(Settings(bag=bag)), shows_pages=True) as client:
        answer = await client.call_tool("ros2_viewer_app", asked)
        assert not answer.is_error, answer.content
        assert answer.structured_content
        assert answer.structured_content["panels"] == {"plot": "/odom:twist.twist.linear.x"}


WHEN = {"at_s": 1_700_000_000, "now_s": 1_700_000_001.5}
POINT = {
    "kind": "point",
    "topic": "/cloud",
    "frame": "laser",
    "xyz": [1, 2, 0.5],
    "in_frame": "map",
    "in": [3, 2, 1],
    **WHEN,
}
BOX = {"kind": "box", "topic": "/camera", "frame": "eye", "box": [10, 20, 29, 39], "size": [640, 480], **WHEN}
SPEED = {"name": "twist.linear.x", "value": 0.25, "unit": "m/s"}
AT_TIME = {"kind": "time", "topic": "/odom", "values": [SPEED], **WHEN}
TIME = "2023-11-14T22:13:20.000000Z (1.5 s old then)"
PICKED = [
    f"Picked in 3D: a point of /cloud of {TIME}, at (1.00, 2.00, 0.50) m in laser, (3.00, 2.00, 1.00) m in map.",
    f"Picked in the picture /camera of {TIME}: pixels x 10 to 29, y 20 to 39 of 640 × 480, frame eye.",
    f"Picked in the plot of /odom: {TIME}: twist.linear.x = 0.25 m/s.",
]


async def test_the_page_asks_and_what_it_shows_is_told_to_the_model(bag: Path) -> None:
    async with client_of(assemble(Settings(bag=bag)), shows_pages=True) as client:
        asked: dict[str, Any] = {"panels": {"map": "", "robot": ""}, "wait_ms": 1000, "view": ""}
        found: dict[str, Any] = {}
        while "map" not in found:
            update = (await client.call_tool("ros2_view_frame", {"asked": asked})).structured_content or {}
            asked["view"], found = update["view"], {**found, **update["panels"]}
            asked["seen"] = {name: shown["number"] for name, shown in found.items()}  # else it is told again at once
        assert found["robot"]["live"] is False
        key = found["map"]["grid"]["key"]
        part = await client.call_tool("ros2_view_ask", {"asked": {"view": asked["view"], "key": key}})
        assert (part.structured_content or {})["next"] is None
        await client.call_tool("ros2_view_ask", {"asked": {"view": asked["view"], "picked": [POINT, BOX, AT_TIME]}})
        answer = await client.call_tool("ros2_view_state", {}, meta=META)
        assert [line for line in answer.content[0].text.splitlines() if line.startswith("Picked")] == PICKED
        (seen,) = (answer.structured_content or {})["pages"]
        point, box, time = seen["picked"]
        assert (point["z_m"], point["view_xyz_m"], box["box_px"], time["values"][0]["value"]) == (
            0.5,
            [3, 2, 1],
            BOX["box"],
            0.25,
        )
        pick = {"x": 1.5, "y": -0.25, "frame": "map", "at_s": 1_700_000_000, "grid": "/map", "cell": 0}
        await client.call_tool("ros2_view_ask", {"asked": {"view": asked["view"], "picked": [pick]}})
        answer = await client.call_tool("ros2_view_state", {}, meta=META)
        (seen,) = (answer.structured_content or {})["pages"]
        assert [(one["x_m"], one["y_m"], one["frame"], one["about"]) for one in seen["picked"]] == [
            (1.5, -0.25, "map", "free on /map")
        ]
        assert "Picked on the map at 2023-11-14T22:13:20" in answer.content[0].text
        assert any(line.startswith("map: /map, the robot at (") for line in seen["panels"])


@pytest.mark.parametrize(
    "picked",
    [
        *("", {}, [1], [{}], [{"x": 1, "y": 2, "at_s": 3}], [{"x": "1", "y": 2, "at_s": 3, "frame": "map"}]),
        *([{"x": 1e300, "y": 2, "at_s": 3, "frame": "map"}], [{"x": True, "y": 2, "at_s": 3, "frame": "map"}]),
        *([{"kind": ["place"]}], [{"kind": "goal", "x": 1, "y": 2, "at_s": 3, "frame": "map"}]),
        *([{**POINT, "xyz": [1, 2]}], [{**POINT, "in": [1, 2, "x"]}], [{**POINT, "frame": 5}], [{**POINT, "xyz": {}}]),
        *([{**BOX, "box": [5, 5, 640, 9]}], [{**BOX, "box": [9, 5, 8, 9]}], [{**BOX, "box": [-1, 0, 1, 1]}]),
        *([{**BOX, "size": [0, 0]}], [{**BOX, "at_s": None}]),
        *([{**AT_TIME, "values": 5}], [{**AT_TIME, "values": ["x"]}], [{**AT_TIME, "now_s": 1e300}]),
    ],
)
async def test_what_is_no_pick_is_refused(bag: Path, picked: Any) -> None:
    async with client_of(assemble(Settings(bag=bag)), shows_pages=True) as client:
        update = await client.call_tool("ros2_view_frame", {"asked": {"panels": {}}})
        view = (update.structured_content or {})["view"]
        answer = await client.call_tool("ros2_view_ask", {"asked": {"view": view, "picked": picked}})
        assert answer.is_error


async def test_a_page_that_asks_no_more_gives_way_to_a_new_one(bag: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("ros2_mcp.view.views._UNWANTED_S", 600.0)
    async with client_of(assemble(Settings(bag=bag)), shows_pages=True) as client:

        async def open_one() -> bool:
            return (await client.call_tool("ros2_view_frame", {"asked": {"panels": {}}})).is_error or False

        assert [await open_one() for _ in range(5)] == [False, False, False, False, True]
        monkeypatch.setattr("ros2_mcp.view.views._UNWANTED_S", 0.0)
        assert not await open_one()
