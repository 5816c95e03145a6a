"""A declared tool as the SDK runs it: strict arguments in, text and structured content out, errors mapped once."""

from __future__ import annotations

import base64
import inspect
import json
from collections.abc import Mapping, Sequence
from typing import Any

from mcp.server.mcpserver import Context
from mcp.server.mcpserver.exceptions import ToolError
from mcp.server.mcpserver.tools.base import Tool
from mcp.server.mcpserver.utilities.func_metadata import ArgModelBase, FuncMetadata
from mcp.types import CallToolResult, ContentBlock, ImageContent, TextContent, ToolAnnotations
from pydantic import ConfigDict, PrivateAttr, ValidationError, create_model

from ros2_mcp.model.errors import RobotError
from ros2_mcp.model.names import did_you_mean
from ros2_mcp.model.text import visible
from ros2_mcp.ops.memory import Memory
from ros2_mcp.ops.results import Report, as_json, at_most_every
from ros2_mcp.robot import Robot
from ros2_mcp.tools import ToolDeclaration
from ros2_mcp.tools.injection import Call
from ros2_mcp.tools.schema import argument_schema, result_schema

_PLAIN_WORDS = {"dict_type": "an object is expected", "list_type": "a list is expected"}
_MAX_TEXT = 40_000
_PROGRESS_S = 0.5


class StrictArguments(ArgModelBase):
    """The arguments of a tool; an unknown one is an error."""

    model_config = ConfigDict(extra="forbid", arbitrary_types_allowed=True)


class RobotTool(Tool):
    """A declared tool as the SDK runs it: strict arguments in, text and structured content out."""

    _declaration: ToolDeclaration = PrivateAttr()
    _robot: Robot = PrivateAttr()
    _memory: Memory = PrivateAttr()

    async def run(self, arguments: dict[str, Any], context: Context[Any, Any], convert_result: bool = False) -> Any:  # noqa: ARG002
        """One call from a client; raises as `perform`."""

        async def report(done: float, whole: float, line: str) -> None:
            await context.report_progress(done, whole, line)

        return await self.perform(arguments, report)

    async def perform(self, arguments: Mapping[str, Any], report: Report) -> CallToolResult:
        """Validates the arguments, calls the function and renders its result.

        Raises:
            ToolError: with the text that the model reads.
        """
        try:
            values = self.fn_metadata.validate_arguments(self._renamed(arguments))
        except ValidationError as error:
            raise ToolError(_explain(self.name, error, self.parameters)) from error
        try:
            call = Call(self._robot, self._memory, at_most_every(_PROGRESS_S, report))
            result = await self._declaration.perform(call, values)
        except RobotError as error:
            raise ToolError(f"{type(error).__name__}: {error}") from error
        return answer(result)

    def _renamed(self, arguments: Mapping[str, Any]) -> dict[str, Any]:
        return {self._declaration.aliases.get(name, name): value for name, value in arguments.items()}


def bind(declaration: ToolDeclaration, robot: Robot, memory: Memory) -> RobotTool:
    """The tool that the SDK registers: plain closed schemas, annotations from the declared risk."""
    signature = declaration.arguments()
    arguments = create_model(declaration.name, __base__=StrictArguments, **_model_fields(signature))
    metadata = FuncMetadata(arg_model=arguments, output_schema=result_schema(signature.return_annotation))
    tool = RobotTool(
        fn=declaration.function,
        name=declaration.name,
        title=declaration.title,
        description=declaration.description,
        parameters=argument_schema(arguments.model_json_schema()),
        fn_metadata=metadata,
        is_async=True,
        context_kwarg=None,
        annotations=ToolAnnotations(
            title=declaration.title,
            read_only_hint=declaration.risk == "read",
            destructive_hint=declaration.risk == "actuate",
            idempotent_hint=declaration.risk == "read",
            open_world_hint=True,
        ),
    )
    tool._declaration = declaration  # pyright: ignore[reportPrivateUsage]
    tool._robot = robot  # pyright: ignore[reportPrivateUsage]
    tool._memory = memory  # pyright: ignore[reportPrivateUsage]
    return tool


def _model_fields(signature: inspect.Signature) -> dict[str, Any]:
    """Each argument as the pair of type and default that pydantic takes."""
    return {
        name: (parameter.annotation, ... if parameter.default is inspect.Parameter.empty else parameter.default)
        for name, parameter in signature.parameters.items()
    }


def answer(result: Any) -> CallToolResult:
    """A result as MCP content: one readable line, the values as JSON, pictures, and the same values structured."""
    structured = as_json(result)
    text = json.dumps(structured, ensure_ascii=False, separators=(",", ":"), allow_nan=False)
    content: list[ContentBlock] = [TextContent(type="text", text=_shown(f"{result.summary()}\n{text}"))]
    for image in getattr(result, "images", ()):
        data = base64.b64encode(image.data).decode()
        content.append(ImageContent(type="image", data=data, mime_type=image.mime))
    return CallToolResult(content=content, structured_content=structured)


def _shown(text: str) -> str:
    """Text with invisible characters made visible, within the limit of what clients take."""
    text = visible(text, keep="\n\t")
    if len(text) <= _MAX_TEXT:
        return text
    return text[:_MAX_TEXT] + f"… (cut after {_MAX_TEXT} characters: ask for less, with a pattern, a limit or fields)"


def _explain(tool: str, error: ValidationError, schema: Mapping[str, Any]) -> str:
    """What was wrong with a call's arguments and what would be right, a sentence for each."""
    return " ".join(_explain_one(tool, problem, schema) for problem in error.errors())


def _explain_one(tool: str, problem: Mapping[str, Any], schema: Mapping[str, Any]) -> str:
    path = ".".join(str(part) for part in problem["loc"])
    if problem["type"] == "extra_forbidden":
        known = _names_beside(schema, problem["loc"])
        hint = did_you_mean(str(problem["loc"][-1]), known, f"It takes: {', '.join(known)}.")
        return f"{tool} has no argument {path!r}. {hint}"
    if problem["type"] == "missing":
        return f"{tool} needs the argument {path!r}."
    message = _PLAIN_WORDS.get(problem["type"], str(problem["msg"]).removeprefix("Value error, "))
    return f"BadInput: {path}: {message}, not {json.dumps(problem['input'], default=str)[:100]}."


def _names_beside(schema: Mapping[str, Any], path: Sequence[str | int]) -> list[str]:
    """The names that are known where the path ends: arguments, or the fields of an element of one."""
    for part in path[:-1]:
        schema = schema["items"] if isinstance(part, int) else schema["properties"][part]
    return list(schema["properties"])
