from __future__ import annotations

import inspect
from dataclasses import replace

import pytest

from ros2_mcp.compose.server import assemble
from ros2_mcp.ops.results.results import Report, silent
from ros2_mcp.robot import Robot
from ros2_mcp.settings import Settings
from ros2_mcp.tools import in_order
from ros2_mcp.tools.declare import ToolDeclaration
from ros2_mcp.tools.graph import PLACE, ros2_status
from ros2_mcp.tools.injection import Call, values_for


async def example(robot: Robot, report: Report, name: str, limit: int = 3) -> str:
    """First line.

    More.
    """
    return ""


DECLARATION = ToolDeclaration(function=example, name="example", title="Example", risk="read", group="core")


def test_the_model_does_not_see_what_is_injected() -> None:
    assert list(DECLARATION.arguments().parameters) == ["name", "limit"]


def test_annotations_are_evaluated() -> None:
    assert DECLARATION.signature().return_annotation is str
    assert DECLARATION.arguments().parameters["limit"].annotation is int


def test_the_description_is_the_docstring_without_its_indentation() -> None:
    assert DECLARATION.description == "First line.\n\nMore."
    assert inspect.cleandoc(DECLARATION.description) == DECLARATION.description


def test_a_tool_stands_at_the_place_of_its_module_or_at_its_own() -> None:
    last = DECLARATION
    of_its_module = replace(DECLARATION, function=ros2_status)
    before = replace(DECLARATION, place=PLACE - 1)
    after = replace(of_its_module, place=PLACE + 1)
    assert in_order([last, after, of_its_module, before]) == [before, of_its_module, after, last]


@pytest.mark.promise("ros2_status", "what it cannot do")
async def test_the_status_gets_what_the_server_does_not_offer() -> None:
    made = assemble(Settings(tools=("core",)))
    tool = made.toolset.by_name["ros2_status"]
    assert any("ros2_plot" in limitation for limitation in tool.limitations)
    call = Call(
        robot=made.robot, session=made.robot.session(), store=made.store, report=silent, limitations=tool.limitations
    )
    values = await values_for(tool.declaration.makers(), call, {})
    assert values["limitations"] == made.toolset.limitations
