"""A declared tool as clients meet it: strict arguments in, text and structured content out, errors mapped once."""

from __future__ import annotations

import base64
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from inspect import Parameter
from typing import Any, cast

from mcp.types import CallToolResult, ContentBlock, ImageContent, TextContent, Tool, ToolAnnotations
from pydantic import BaseModel, ConfigDict, ValidationError, create_model

from ros2_mcp.model.errors import RobotError
from ros2_mcp.model.names import did_you_mean
from ros2_mcp.model.text import as_sent, visible, visible_json
from ros2_mcp.ops.memory.bag_store import BagStore
from ros2_mcp.ops.results import Report, as_json, at_most_every, lines_of
from ros2_mcp.ops.sources.kinds import OWN_KINDS
from ros2_mcp.ops.sources.source import SourceKind
from ros2_mcp.robot import Robot
from ros2_mcp.tools import ToolDeclaration
from ros2_mcp.tools.injection import Call
from ros2_mcp.tools.schema import argument_schema, result_schema, text_for_number

_PLAIN_WORDS = {"dict_type": "an object is expected", "list_type": "a list is expected"}
# About 10,000 tokens: one terminal client refuses more than 25,000, and text costs the model's attention before that.
_MAX_TEXT = 40_000
# What of a recording is damaged or missing, in every answer made from it; results with `problems` say it there.
_DAMAGE = "damage"
# Twice a second looks alive, and does not fill the client's log during a minute's wait.
_PROGRESS_S = 0.5


class CallFailed(Exception):
    """A call that did not do what was asked; its text is what the model reads, on one line and with nothing hidden."""

    def __init__(self, text: str) -> None:
        super().__init__(_cut(visible(text)))


class StrictArguments(BaseModel):
    """The arguments of a tool; an unknown one is an error."""

    model_config = ConfigDict(extra="forbid", arbitrary_types_allowed=True)


@dataclass(frozen=True, slots=True, kw_only=True)
class BoundTool:
    """A declared tool with what it works on: `listed` is how clients see it, `arguments` checks what they send."""

    declaration: ToolDeclaration
    listed: Tool
    arguments: type[StrictArguments]
    robot: Robot
    store: BagStore
    kinds: Sequence[SourceKind]
    limitations: Sequence[str]

    @property
    def name(self) -> str:
        """The name under which it is listed."""
        return self.declaration.name

    async def call(self, arguments: Mapping[str, Any], report: Report, robot: Robot | None = None) -> CallToolResult:
        """Validates the arguments, calls the function and renders its result.

        Args:
            arguments: as the client sent them.
            report: is told of progress, at most twice a second.
            robot: the robot as it is for the client that asks; the robot of the server if nobody in particular does.

        Raises:
            CallFailed: with the text that the model reads.
        """
        try:
            meant = self._as_meant(arguments)
            self._refuse_texts(meant)
            checked = self.arguments.model_validate(meant)
        except ValidationError as error:
            raise CallFailed(_explain(self.name, error, self.listed.input_schema)) from error
        # One level only: an argument that is an object stays the model that the tool declared.
        values = {name: getattr(checked, name) for name in self.arguments.model_fields}
        with self.store.noting_damage() as damage:
            try:
                made_for = Call(
                    robot=robot or self.robot,
                    store=self.store,
                    report=at_most_every(_PROGRESS_S, _visibly(report)),
                    kinds=self.kinds,
                    limitations=self.limitations,
                )
                result = await self.declaration.perform(made_for, values)
            except RobotError as error:
                told = [f"{type(error).__name__}: {error}", *(f"Damage: {line}" for line in damage())]
                raise CallFailed(" ".join(told)) from error
            return answer(result, damage())

    def _as_meant(self, arguments: Mapping[str, Any]) -> dict[str, Any]:
        """The arguments under their own names, taken apart where they came as text, and with the robot's own texts.

        One desktop client sends a list or an object as a string of JSON, always. What the model was shown with its
        hidden characters escaped, and sends back, means those characters.
        """
        meant: dict[str, Any] = {}
        for name, value in arguments.items():
            own_name = self.declaration.aliases.get(name, name)
            field = self.arguments.model_fields.get(own_name)
            if isinstance(value, str) and field and field.annotation is not str:
                value = _parsed(value, acts=self.acts)  # noqa: PLW2901
            meant[own_name] = _as_sent(value)
        return meant

    @property
    def acts(self) -> bool:
        """Whether it can change or move something, or stop it."""
        return self.declaration.risk != "read"

    def _refuse_texts(self, arguments: Mapping[str, Any]) -> None:
        """Where the tool acts a text is no number: pydantic would take "1 " for one, and the robot would act on it."""
        if self.acts and (path := text_for_number(self.listed.input_schema, arguments)):
            raise CallFailed(f"BadInput: {path}: a text is given, a number is expected. Write it without quotes.")


def bind(
    declaration: ToolDeclaration,
    robot: Robot,
    store: BagStore,
    kinds: Sequence[SourceKind] = OWN_KINDS,
    *,
    limitations: Sequence[str] = (),
) -> BoundTool:
    """The tool with plain closed schemas, and annotations from the declared risk."""
    signature = declaration.arguments()
    fields: dict[str, Any] = {
        name: (parameter.annotation, ... if parameter.default is Parameter.empty else parameter.default)
        for name, parameter in signature.parameters.items()
    }
    arguments = create_model(declaration.name, __base__=StrictArguments, **fields)
    listed = Tool(
        name=declaration.name,
        title=declaration.title,
        description=declaration.description,
        input_schema=argument_schema(arguments.model_json_schema()),
        output_schema=result_schema(signature.return_annotation),
        annotations=ToolAnnotations(
            title=declaration.title,
            read_only_hint=declaration.risk == "read",
            destructive_hint=declaration.risk == "actuate",
            idempotent_hint=declaration.risk in ("read", "stop"),
            open_world_hint=True,
        ),
    )
    results: Mapping[str, Any] = listed.output_schema or {}
    if declaration.recorded and "problems" not in results["properties"]:
        results["properties"][_DAMAGE] = {"type": "array", "items": {"type": "string"}}  # only where there is some
    return BoundTool(
        declaration=declaration,
        listed=listed,
        arguments=arguments,
        robot=robot,
        store=store,
        kinds=kinds,
        limitations=limitations,
    )


def answer(result: Any, damage: Sequence[str] = ()) -> CallToolResult:
    """A result as MCP content: readable lines, the values as JSON, pictures, and the same values structured.

    A summary is one line or a list of lines: a line break within one is shown as what it is, and begins no line.
    `damage` says of the bags that were read for it what of them is damaged or missing.
    """
    value: Any = as_json(result)
    lines = lines_of(result.summary())
    if damage and not hasattr(result, "problems"):  # those say it themselves
        value[_DAMAGE] = list(damage)
        lines = [*lines, *(f"Damage: {line}" for line in damage)]
    structured, text = visible_json(value)
    shown = "\n".join([*map(visible, lines), text])
    content: list[ContentBlock] = [TextContent(type="text", text=_cut(shown))]
    for image in getattr(result, "images", ()):
        data = base64.b64encode(image.data).decode()
        content.append(ImageContent(type="image", data=data, mime_type=image.mime))
    return CallToolResult(content=content, structured_content=structured)


def _parsed(text: str, *, acts: bool) -> Any:
    """What a text says in JSON, if that is a list, an object or null; the text itself otherwise.

    For a tool that acts only if there is something in it: "{}" would become a message of defaults, which moves a robot
    to places that nobody named.
    """
    try:
        value = json.loads(text)
    except (ValueError, RecursionError):
        return text
    return text if isinstance(value, (str, int, float)) or (acts and not value) else value


def _as_sent(value: Any) -> Any:
    """An argument as the client means it; see `as_sent`."""
    if isinstance(value, str):
        return as_sent(value)
    if isinstance(value, dict):
        return {as_sent(name): _as_sent(below) for name, below in cast("dict[str, Any]", value).items()}
    if isinstance(value, list):
        return [_as_sent(item) for item in cast("list[Any]", value)]
    return value


def _visibly(report: Report) -> Report:
    """A `Report` whose lines have nothing hidden."""

    async def shown(done: float, whole: float, line: str) -> None:
        await report(done, whole, visible(line))

    return shown


def _cut(text: str) -> str:
    """Text within the limit of what clients take."""
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
