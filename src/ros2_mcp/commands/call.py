"""Call one tool from the command line, for people without a client at hand."""

# ruff: noqa: T201 - printing is this module's job

from __future__ import annotations

import asyncio
import base64
import json
import signal
import sys
import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ros2_mcp.commands.serve import launch
from ros2_mcp.model.errors import BadInput
from ros2_mcp.model.names import did_you_mean
from ros2_mcp.settings import Settings

if TYPE_CHECKING:
    from ros2_mcp.binding import BoundTool


def call(settings: Settings, tool: str | None, assignments: Sequence[str], *, as_json: bool) -> int:
    """Calls the tool and prints its answer; pictures are saved beside and named. Without a tool, lists the tools."""
    arguments = parse_assignments(assignments)
    # Who calls by hand knows what is wanted: nothing is left out to keep a list short.
    settings = replace(settings, tools=settings.tools or ("all",))
    bridge = launch(settings)
    from ros2_mcp.assembly import assemble

    async def once() -> int:
        # Python 3.10 would cancel the bridge's supervisor together with this task: the bridge would be killed, and not
        # stop the robot.
        this_call = asyncio.current_task()
        assert this_call
        asyncio.get_running_loop().add_signal_handler(signal.SIGINT, this_call.cancel)
        assembly = assemble(settings, bridge)
        async with assembly.running():
            tools = assembly.toolset.by_name
            if tool is None:
                return _print_tools(tools)
            if tool not in tools:
                raise BadInput(f"There is no tool {tool}.", did_you_mean(tool, list(tools), "See: ros2-mcp call"))
            return await _print_answer(tools[tool], arguments, as_json)

    try:
        return asyncio.run(once())
    except asyncio.CancelledError:  # Ctrl-C
        return 130


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


def _print_tools(tools: Mapping[str, BoundTool]) -> int:
    for tool in tools.values():
        print(f"{tool.name:36} {first_sentence(tool.declaration.description)}")
    return 0


async def _print_answer(tool: BoundTool, arguments: dict[str, Any], as_json: bool) -> int:
    from ros2_mcp.binding import CallFailed

    try:
        result = await tool.call(arguments, _print_progress)
    except CallFailed as error:
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
