"""A declared tool as an MCP tool: strict arguments in, text and structured content out, errors mapped in one place."""

from __future__ import annotations

import base64
import json
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from inspect import Parameter
from typing import Any, cast, get_args

from mcp.types import CallToolResult, ContentBlock, ImageContent, TextContent, Tool, ToolAnnotations
from pydantic import BaseModel, ConfigDict, ValidationError, create_model

from ros2_mcp.model.aside import aside, extent
from ros2_mcp.model.errors import BadInput, RobotError
from ros2_mcp.model.finite import finite
from ros2_mcp.model.system_limits import system_limit
from ros2_mcp.model.text import as_sent, quoted, visible, visible_json
from ros2_mcp.ops.memory.bag_store import BagStore
from ros2_mcp.ops.results.results import Report, answer_bytes, as_json, at_most_every, lines_of, structured
from ros2_mcp.ops.results.text import MOST_CHARACTERS, as_text
from ros2_mcp.ops.sources.kinds import OWN_KINDS
from ros2_mcp.ops.sources.source import SourceKind
from ros2_mcp.programs.declare import Function
from ros2_mcp.robot import Robot
from ros2_mcp.robot.session import Session
from ros2_mcp.tools import ToolDeclaration
from ros2_mcp.tools.arguments import WHOLE_SENTENCE, TimeArgument
from ros2_mcp.tools.declare import ForPage
from ros2_mcp.tools.injection import Call
from ros2_mcp.tools.leniency import as_meant
from ros2_mcp.tools.misnamed import hint_for, taken_for
from ros2_mcp.tools.schema import argument_schema, expected_kind, node_at, result_schema, text_for_number
from ros2_mcp.view.viewing import Viewing

_OUR_WORDS = frozenset({"value_error", "assertion_error"})
"""The types of validation errors whose message is of a validator of ours; of others it is a library's text."""
# Damaged or missing parts of recordings, in every answer read from them; results with `problems` report them there.
_DAMAGE = "damage"
SUMMARY = "summary"
"""The field of structured content that holds the summary's lines."""
# Notes on an answer, and on corrected arguments, in results without a note of their own.
_NOTE = "note"
_MOST_NAMED = 5
_NARROWING = (
    *("pattern", "fields", "max_array", "every_n", "message_limit", "number_of_messages", "limit", "start", "end"),
    *("since", "node", "node_name", "node_names", "names", "topic_names", "kind", "package"),
)
# Two updates per second look alive, and do not fill the client's log during a wait of a minute.
_PROGRESS_S = 0.5


class CallFailed(Exception):
    """A call that failed. Its text is what the model reads: one line, with all hidden characters escaped."""

    def __init__(self, text: str) -> None:
        super().__init__(_cut(visible(text)))


class StrictArguments(BaseModel):
    """The arguments of a tool; an unknown argument is an error."""

    model_config = ConfigDict(extra="forbid", arbitrary_types_allowed=True)


@dataclass(frozen=True, slots=True, kw_only=True)
class BoundTool:
    """A declared tool with its robot and stores. `listed` is the tool as clients see it; `arguments` validates what
    they send.

    `only_offered` appends to a hint or a note which of the tools that it names are not offered.
    """

    declaration: ToolDeclaration
    listed: Tool
    arguments: type[StrictArguments]
    robot: Robot
    store: BagStore
    kinds: Sequence[SourceKind]
    limitations: Sequence[str]
    only_offered: Callable[[str], str]
    functions: Callable[[], Sequence[Function]]
    viewing: Viewing | None

    @property
    def name(self) -> str:
        """The name of the tool in `tools/list`."""
        return self.declaration.name

    async def call(
        self, arguments: Mapping[str, Any], report: Report, session: Session | None = None, *, shows_pages: bool = False
    ) -> CallToolResult:
        """Validate the arguments, call the function and render its result.

        Args:
            arguments: as the client sent them.
            report: receives the progress, at most twice a second.
            session: that of the client that asks; a new one if None.
            shows_pages: whether that client shows the page beside the chat.

        Raises:
            CallFailed: with the text that the model reads.
        """
        try:
            checked, told = await aside(extent(arguments), self._checked, arguments)
        except ValidationError as error:
            raise CallFailed(explained(self.name, error, self.listed.input_schema)) from error
        # One level only: an argument that is an object stays the model that the tool declared.
        values = {name: getattr(checked, name) for name in self.arguments.model_fields}
        told += [f"{name}: {said}." for name, kind in self._times() if (said := kind.taken_as(values[name]))]
        session = session or self.robot.session()
        with self.store.noting_damage() as damage:
            try:
                shown = at_most_every(_PROGRESS_S, _visibly(report))
                result = await self._perform(checked, values, shown, session, shows_pages=shows_pages)
                told += session.notes
            except RobotError as error:
                hint = self.only_offered(error.hint)
                lines = [f"{type(error).__name__}: {error.message} {hint}".rstrip(), *told]
                raise CallFailed(" ".join((*lines, *(f"Damage: {line}" for line in self._damage(damage()))))) from error
            if isinstance(result, ForPage):
                text = TextContent(type="text", text=visible(result.told))
                return CallToolResult(content=[text], structured_content=dict(finite(result.value)))
            noted = self._with_notes(result, told)
            made = partial(answer, most=answer_bytes(self.robot), narrowing=self._narrowing)
            return await aside(extent(as_json(noted)), made, noted, self._damage(damage()), told)

    async def perform(self, arguments: Mapping[str, Any], report: Report, session: Session) -> Any:
        """Return the result of the function itself, for a program. Arguments are checked as strictly as in a call.

        Raises:
            RobotError: as raised by the tool; `BadInput` for invalid arguments.
        """
        try:
            checked, _ = self._checked(arguments, are_exact=True)
        except ValidationError as error:
            raise BadInput(explained(self.name, error, self.listed.input_schema)) from error
        except CallFailed as error:
            raise BadInput(str(error)) from error
        values = {name: getattr(checked, name) for name in self.arguments.model_fields}
        return await self._perform(checked, values, report, session)

    async def _perform(
        self,
        checked: StrictArguments,
        values: Mapping[str, Any],
        report: Report,
        session: Session,
        *,
        shows_pages: bool = False,
    ) -> Any:
        made_for = Call(
            robot=self.robot,
            session=session,
            store=self.store,
            report=report,
            kinds=self.kinds,
            limitations=self.limitations,
            given=checked.model_fields_set,
            functions=self.functions,
            viewing=self.viewing,
            shows_pages=shows_pages,
        )
        try:
            return await self.declaration.perform(made_for, values)
        except Exception as error:
            if limit := system_limit(error):
                raise limit from error
            raise

    def _checked(self, arguments: Mapping[str, Any], *, are_exact: bool = False) -> tuple[StrictArguments, list[str]]:
        """Return the validated arguments, and notes on how they were corrected. Raises `ValidationError` or
        `CallFailed`.
        """
        meant, told = self._as_meant(arguments, are_exact=are_exact)
        self._refuse_texts(meant)
        return self.arguments.model_validate(meant), told

    def _damage(self, lines: Sequence[str]) -> list[str]:
        return [self.only_offered(line) for line in lines]

    def _with_notes(self, result: Any, told: Sequence[str]) -> Any:
        """Return the result with the notes added to its own `note`, where tools that are not offered are marked."""
        note = getattr(result, _NOTE, None)
        if not isinstance(note, str):
            return result
        shown = " ".join(filter(None, (*told, self.only_offered(note))))
        return result if shown == note else replace(result, note=shown)

    def _times(self) -> list[tuple[str, TimeArgument]]:
        """Return the arguments that are times, with their names."""
        fields = self.arguments.model_fields
        return [
            (name, item) for name, field in fields.items() for item in field.metadata if isinstance(item, TimeArgument)
        ]

    def _as_meant(self, arguments: Mapping[str, Any], *, are_exact: bool = False) -> tuple[dict[str, Any], list[str]]:
        """Return the arguments with evident slips corrected, and notes on the corrections.

        Names become the declared ones, JSON texts are parsed, and arguments that count as not given are dropped. One
        desktop client always sends lists and objects as a string of JSON. Escapes of hidden characters, which the model
        copies from what it was shown, become those characters again. Arguments that `are_exact` come from a program,
        which was not shown any escapes.
        """
        meant: dict[str, Any] = {}
        renamed: list[str] = []
        spelled: dict[str, str] = {}
        unknown: list[str] = []
        for name, value in arguments.items():
            own_name = self.declaration.aliases.get(name, name)
            if not own_name and name:  # an alias that is accepted and ignored
                continue
            if own_name == name and (own_name := taken_for(name, self.arguments.model_fields, acts=self.acts)) != name:
                renamed.append(f"{name} was taken as {own_name}.")
            if self.declaration.risk == "stop" and own_name not in self.arguments.model_fields:
                unknown.append(name)
                continue
            if (other := spelled.setdefault(own_name, name)) != name:
                raise CallFailed(
                    f"BadInput: {other!r} and {name!r} are two names of one argument: give only one of them."
                )
            field = self.arguments.model_fields.get(own_name)
            if isinstance(value, str) and field and field.annotation is not str:
                value = _parsed(value, acts=self.acts)  # noqa: PLW2901
            meant[own_name] = value if are_exact else _as_sent(value)
        taken, told = as_meant(self.listed.input_schema, meant, acts=self.acts)
        told[:0] = renamed
        if unknown:  # a stop is not refused because of unknown arguments
            told.append(f"{self.name} has no argument {', '.join(map(quoted, unknown[:_MOST_NAMED]))}: ignored.")
        fields = self.arguments.model_fields  # for some arguments null has a meaning, such as no time-out
        nulls = [name for name, value in meant.items() if value is None and name in fields]
        return {**{name: None for name in nulls if type(None) in get_args(fields[name].annotation)}, **taken}, told

    @property
    def _narrowing(self) -> Sequence[str]:
        """The names of the arguments by which a caller can ask for less, or for another part."""
        return [name for name in _NARROWING if name in self.arguments.model_fields]

    @property
    def acts(self) -> bool:
        """Whether the tool can change, move or stop something."""
        return self.declaration.risk != "read"

    def _refuse_texts(self, arguments: Mapping[str, Any]) -> None:
        """Refuse a text where a number is expected, if the tool acts: pydantic would read "1 " as 1, and the robot
        would act on it.
        """
        if self.acts and (path := text_for_number(self.listed.input_schema, arguments)):
            raise CallFailed(f"BadInput: {path}: a string is given, a number is expected. Write it without quotes.")


def bind(
    declaration: ToolDeclaration,
    robot: Robot,
    store: BagStore,
    kinds: Sequence[SourceKind] = OWN_KINDS,
    *,
    limitations: Sequence[str] = (),
    only_offered: Callable[[str], str] = lambda text: text,
    functions: Callable[[], Sequence[Function]] = tuple,
    viewing: Viewing | None = None,
) -> BoundTool:
    """Return the tool with plain closed schemas, and with annotations that follow from the declared risk."""
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
        output_schema=None if declaration.audience == "page" else answer_schema(signature.return_annotation),
        annotations=ToolAnnotations(
            read_only_hint=declaration.risk == "read",
            destructive_hint=declaration.risk == "actuate",
            idempotent_hint=declaration.risk in ("read", "stop"),
            # Where a client must not ask its user, it runs no tool with an open world. Neither tools that only read nor
            # the stop need to be asked about (decision 58).
            open_world_hint=declaration.risk in ("write", "actuate"),
        ),
        _meta=_hints_of(declaration),
    )
    results: Mapping[str, Any] = listed.output_schema or {}
    if results and declaration.recorded and "problems" not in results["properties"]:
        results["properties"][_DAMAGE] = {"type": "array", "items": {"type": "string"}}  # only if there is some
    if results:
        results["properties"].setdefault(_NOTE, {"type": "string"})  # only present if there is a note
    return BoundTool(
        declaration=declaration,
        listed=listed,
        arguments=arguments,
        robot=robot,
        store=store,
        kinds=kinds,
        limitations=limitations,
        only_offered=only_offered,
        functions=functions,
        viewing=viewing,
    )


def _hints_of(declaration: ToolDeclaration) -> dict[str, Any] | None:
    """Return hints for the tool search of one client; other clients ignore them."""
    hints: dict[str, Any] = {"anthropic/searchHint": declaration.finds} if declaration.finds else {}
    if declaration.always_loaded:
        hints["anthropic/alwaysLoad"] = True
    return hints or None


def answer_schema(kind: Any) -> dict[str, Any]:
    """Return the schema of an answer's structured content, for results of this kind."""
    schema = result_schema(kind)
    properties = {SUMMARY: {"type": "string"}, **schema["properties"]}
    return {**schema, "properties": properties, "required": [SUMMARY, *schema["required"]]}


def answer(
    result: Any,
    damage: Sequence[str] = (),
    told: Sequence[str] = (),
    *,
    most: int = MOST_CHARACTERS,
    narrowing: Sequence[str] = (),
) -> CallToolResult:
    """Return a result as MCP content: a text of at most `most` characters, pictures, and structured content.

    A summary is one line or a list of lines: a line break within a line is escaped. `damage` are lines on damaged or
    missing parts of the bags that were read, `told` are notes on corrected arguments, and `narrowing` names the
    arguments with which a caller gets less.
    """
    beside: dict[str, Any] = {}
    if told and not hasattr(result, _NOTE):
        beside[_NOTE] = " ".join(told)
    lines = [*told]
    if damage and not hasattr(result, "problems"):  # results with `problems` report the damage there
        beside[_DAMAGE] = list(damage)
        lines += [f"Damage: {line}" for line in damage]
    content: list[ContentBlock] = [
        TextContent(type="text", text=as_text(result, lines, most=most, narrowing=narrowing))
    ]
    for image in getattr(result, "images", ()):
        data = base64.b64encode(image.data).decode()
        content.append(ImageContent(type="image", data=data, mime_type=image.mime))
    structure, _ = visible_json({**structured(result), **beside})
    summary = "\n".join(map(visible, lines_of(result.summary())))
    return CallToolResult(
        content=content,
        structured_content={SUMMARY: summary, **structure},
        is_error=getattr(result, "has_failed", False),
    )


def _parsed(text: str, *, acts: bool) -> Any:
    """Return the list, object or null that a JSON text contains; the text itself otherwise.

    For a tool that acts, an empty object or list and null stay text, too: "{}" would become a message of default
    values, which moves a robot to a place that the caller did not name.
    """
    try:
        value = json.loads(text)
    except (ValueError, RecursionError):
        return text
    return text if isinstance(value, (str, int, float)) or (acts and not value) else value


def _as_sent(value: Any) -> Any:
    """Return an argument with the escapes of hidden characters reversed in all its texts; see `as_sent`."""
    if isinstance(value, str):
        return as_sent(value)
    if isinstance(value, dict):
        return {as_sent(name): _as_sent(below) for name, below in cast("dict[str, Any]", value).items()}
    if isinstance(value, list):
        return [_as_sent(item) for item in cast("list[Any]", value)]
    return value


def _visibly(report: Report) -> Report:
    """Return a `Report` that escapes hidden characters in its lines."""

    async def shown(done: float, whole: float, line: str) -> None:
        await report(done, whole, visible(line))

    return shown


def _cut(text: str) -> str:
    """Return a text cut to the longest that clients accept."""
    if len(text) <= MOST_CHARACTERS:
        return text
    return f"{text[:MOST_CHARACTERS]}… (cut after {MOST_CHARACTERS} characters)"


def explained(tool: str, error: ValidationError, schema: Mapping[str, Any]) -> str:
    """Return a sentence for each error in a call's arguments: what is wrong and what is expected."""
    return " ".join(_explain_one(tool, problem, schema) for problem in error.errors())


def _explain_one(tool: str, problem: Mapping[str, Any], schema: Mapping[str, Any]) -> str:
    path = ".".join(str(part) for part in problem["loc"])
    if problem["type"] == "extra_forbidden":
        known = _names_beside(schema, problem["loc"])
        hint = hint_for(str(problem["loc"][-1]), known)
        return f"{tool} has no argument {path!r}. {hint}"
    if problem["type"] == "missing":
        return f"{tool} needs the argument {path!r}."
    if problem["type"] == WHOLE_SENTENCE:
        return f"BadInput: {path}: {problem['msg']}"
    kind = expected_kind(node_at(schema, problem["loc"]))
    if problem["type"] in _OUR_WORDS and not (kind and problem["input"] is None):
        message = re.sub("^(Value|Assertion) error, ", "", str(problem["msg"]))
    else:
        message = f"{kind or 'something else'} is expected"
    path = path or "the name of an argument"  # no text, such as an unpaired surrogate
    return f"BadInput: {path}: {message}, not {json.dumps(problem['input'], default=str)[:100]}."


def _names_beside(schema: Mapping[str, Any], path: Sequence[str | int]) -> list[str]:
    """Return the names that are known at this path: arguments, or the fields of an argument's elements."""
    for part in path[:-1]:
        schema = schema["items"] if isinstance(part, int) else schema["properties"][part]
    return list(schema["properties"])
