from __future__ import annotations

import inspect

from ros2_mcp.ops.results import Report
from ros2_mcp.robot import Robot
from ros2_mcp.tools.declare import ToolDeclaration


async def example(robot: Robot, report: Report, name: str, limit: int = 3) -> str:
    """First line.

    More.
    """
    return ""


DECLARATION = ToolDeclaration(example, "example", "Example", "read", "core")


def test_the_model_does_not_see_what_is_injected() -> None:
    assert list(DECLARATION.arguments().parameters) == ["name", "limit"]


def test_annotations_are_evaluated() -> None:
    assert DECLARATION.signature().return_annotation is str
    assert DECLARATION.arguments().parameters["limit"].annotation is int


def test_the_description_is_the_docstring_without_its_indentation() -> None:
    assert DECLARATION.description == "First line.\n\nMore."
    assert inspect.cleandoc(DECLARATION.description) == DECLARATION.description
