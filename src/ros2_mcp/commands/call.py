"""Call one tool from the command line, for people without a client at hand."""

# ruff: noqa: T201 - printing is this module's job

from __future__ import annotations

import asyncio
import base64
import json
import sys
import tempfile
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ros2_mcp.commands.serve import launch
from ros2_mcp.model.errors import BadInput
from ros2_mcp.model.names import did_you_mean
from ros2_mcp.settings import Settings

if TYPE_CHECKING:
    from ros2_mcp.server import RobotTool


def call(settings: Settings, tool: str | None, assignments: Sequence[str], *, as_json: bool) -> int:
    """Calls the tool and prints its answer; pictures are saved beside and named. Without a tool, lists the tools."""
    arguments = parse_assignments(assignments)
    bridge = launch(settings)
    from ros2_mcp.guard.policy import Policy
    from ros2_mcp.ops.memory import Memory
    from ros2_mcp.robot import Robot
    from ros2_mcp.server import build_tools

    async def once() -> int:
        await bridge.attach()
        try:
            robot = Robot(bridge, Policy(settings.read_only), settings.result_bytes)
            memory = Memory(settings.record_dir, settings.bag_dir)
            tools = {tool.name: tool for tool in build_tools(robot, settings.tools or ("all",), memory)}
            if tool is None:
                return _print_tools(tools)
            if tool not in tools:
                raise BadInput(f"There is no tool {tool}.", did_you_mean(tool, list(tools), "See: ros2-mcp call"))
            return await _print_answer(tools[tool], arguments, as_json)
        finally:
            await bridge.close()

    return asyncio.run(once())


def parse_assignments(assignments: Sequence[str]) -> dict[str, Any]:
    """`key=value` pairs as arguments: a value that is JSON is taken as JSON, any other as text.

    Raises:
        BadInput: for a word without `=`.
    """
    arguments: dict[str, Any] = {}
    for word in assignments:
        key, equals, value = word.partition("=")
        if not equals:
            raise BadInput(f"{word!r} is not an assignment.", "Write key=value, such as topic_name=/scan.")
        try:
            arguments[key] = json.loads(value)
        except ValueError:
            arguments[key] = value
    return arguments


def first_sentence(text: str) -> str:
    """The first sentence of a description, on one line."""
    return " ".join(text.split()).partition(". ")[0].rstrip(".") + "."


def _print_tools(tools: Mapping[str, RobotTool]) -> int:
    for tool in tools.values():
        print(f"{tool.name:36} {first_sentence(tool.description)}")
    return 0


async def _print_answer(tool: RobotTool, arguments: dict[str, Any], as_json: bool) -> int:
    from mcp.server.mcpserver.exceptions import ToolError

    try:
        result = await tool.perform(arguments, _print_progress)
    except ToolError as error:
        print(error, file=sys.stderr)
        return 1
    summary = getattr(result.content[0], "text", "").partition("\n{")[0]
    if not as_json:
        print(summary)
    print(json.dumps(result.structured_content, indent=None if as_json else 2, ensure_ascii=False))
    for block in result.content[1:]:
        if block.type == "image":
            print(f"picture saved: {_save(block.data, block.mime_type)}", file=sys.stderr)
    return 0


async def _print_progress(done: float, whole: float, line: str) -> None:
    print(f"{done:.0f}/{whole:.0f} s  {line}", file=sys.stderr)


def _save(data: str, mime: str) -> Path:
    with tempfile.NamedTemporaryFile(prefix="ros2-mcp-", suffix=f".{mime.split('/')[1]}", delete=False) as file:
        file.write(base64.b64decode(data))
    return Path(file.name)
