"""Message objects → JSON, bounded: what is too long is summarised, never cut in the middle."""

from __future__ import annotations

import json
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

from ros2_mcp.codec.definitions import Definitions
from ros2_mcp.codec.scalars import SUMMARY
from ros2_mcp.codec.select import Selection, Step, element_at, parse_fields
from ros2_mcp.codec.store import attribute
from ros2_mcp.codec.summary import (
    json_number,
    json_numbers,
    list_summary,
    numbers_summary,
    text_problem,
    text_summary,
)
from ros2_mcp.codec.text import is_unicode
from ros2_mcp.model.interfaces import TEXTS, FieldType

_ARRAY_STEPS = (16, 4, 0)
_STRING_STEPS = (256, 64)
_DEPTH_STEPS = (4, 3, 2, 1, 0)
_UNLIMITED = 2**31


@dataclass(frozen=True, slots=True)
class RenderOptions:
    """How much to show.

    Longer arrays than `max_array` and longer texts than `max_string` (characters) become summaries. If the JSON text
    is longer than `max_bytes` all the same, both are lowered step by step, then deep messages are left out.
    `fields` selects paths; a slice or a text that it names is given in full as long as it fits. `exact` shows
    everything whole, whatever the size.
    """

    max_array: int = 64
    max_string: int = 2048
    max_bytes: int = 32_768
    fields: Sequence[str] | None = None
    exact: bool = False


@dataclass(frozen=True, slots=True)
class Rendered:
    """A message as JSON: its fields, or path → value where fields were selected.

    `truncated` are the paths of what is summarised (`poses[*].name` stands for every index); `bytes` is the length
    of the compact JSON text.
    """

    value: dict[str, Any]
    truncated: list[str]
    bytes: int

    @property
    def hint(self) -> str:
        """How to get what is not shown; empty where everything is."""
        if not self.truncated:
            return ""
        paths = ", ".join(path or "the whole message" for path in self.truncated[:8])
        return (
            f"Summarised: {paths}. For more, select parts with fields (such as poses[3].position, or a slice such as "
            "ranges[0:100]), or raise max_array."
        )


class _Limits(NamedTuple):
    array: int
    string: int
    depth: int
    slice: int


def render(definitions: Definitions, type_name: str, message: object, *, options: RenderOptions) -> Rendered:
    """The message as JSON within the bounds.

    NaN and the infinities are the strings `"nan"`, `"inf"`, `"-inf"`; integers beyond 2^53 are decimal strings; bytes
    are a list up to 64, else base64. All of that, `check` takes back and gives the same message.

    Raises:
        BadValue: for a path in `fields` that does not exist, or an index beyond the list.
    """
    selections = parse_fields(definitions, type_name, options.fields) if options.fields else None
    result = Rendered({}, [], 2)
    for limits in _attempts(options):
        result = _Render(definitions, limits).whole(type_name, message, selections)
        if options.exact or result.bytes <= options.max_bytes:
            break
    return result


def _attempts(options: RenderOptions) -> Iterator[_Limits]:
    """Limits to try, each tighter than the one before."""
    if options.exact:
        yield _Limits(_UNLIMITED, _UNLIMITED, _UNLIMITED, _UNLIMITED)
        return
    most = max(options.max_bytes // 2, 1)  # an element takes two characters at least
    array, string = min(max(options.max_array, 0), most), min(max(options.max_string, 0), most)
    yield _Limits(array, string, _UNLIMITED, most)
    for lower, shorter in zip(_ARRAY_STEPS, (*_STRING_STEPS, _STRING_STEPS[-1]), strict=True):
        array, string = min(array, lower), min(string, shorter)
        yield _Limits(array, string, _UNLIMITED, array)
    for depth in _DEPTH_STEPS:
        yield _Limits(array, string, depth, array)


class _Render:
    def __init__(self, definitions: Definitions, limits: _Limits) -> None:
        self._definitions = definitions
        self._limits = limits
        self._truncated: dict[str, None] = {}

    def whole(self, type_name: str, message: object, selections: Sequence[Selection] | None) -> Rendered:
        if selections is None:
            value = self._message(type_name, message, "", self._limits.depth)
        else:
            value = {each.path: self._follow(each.path, each.steps, message) for each in selections}
        text = json.dumps(value, ensure_ascii=False, allow_nan=False, separators=(",", ":"))
        return Rendered(value, list(self._truncated), len(text.encode()))

    def _message(self, type_name: str, message: object, path: str, depth: int) -> dict[str, Any]:
        if depth <= 0:
            self._cut(path)
            return {SUMMARY: type_name}
        result: dict[str, Any] = {}
        for field in self._definitions.structure(type_name).fields:
            below = f"{path}.{field.name}" if path else field.name
            result[field.name] = self._value(field.type, getattr(message, attribute(field.name)), below, depth - 1)
        return result

    def _value(self, field_type: FieldType, value: Any, path: str, depth: int) -> Any:
        if field_type.arity != "single":
            return self._several(field_type, value, path, depth, self._limits.array)
        if field_type.is_message:
            return self._message(field_type.base, value, path, depth)
        if field_type.base in TEXTS:
            return self._text(value, path, self._limits.string)
        return json_number(field_type.base, value)

    def _several(self, field_type: FieldType, values: Any, path: str, depth: int, most: int) -> Any:
        if field_type.is_message or field_type.base in TEXTS:
            return self._list(field_type, values, path, depth, most)
        if len(values) <= most:
            return json_numbers(field_type, values)
        self._cut(path)
        return numbers_summary(field_type, values, most)

    def _list(self, field_type: FieldType, values: list[Any], path: str, depth: int, most: int) -> Any:
        element = field_type.element
        first = [self._value(element, value, f"{path}[*]", depth) for value in values[:most]]
        if len(values) <= most:
            return first
        self._cut(path)
        return list_summary(field_type, len(values), first)

    def _text(self, text: str, path: str, most: int) -> Any:
        if len(text) > most:
            self._cut(path)
            return text_summary(text, most)
        if text.isascii() or is_unicode(text):
            return text
        self._cut(path)
        return text_problem(text)

    def _follow(self, path: str, steps: tuple[Step, ...], value: Any) -> Any:
        """What a selected path leads to; beyond a slice, a list with what the rest of the path leads to in each."""
        step, rest = steps[0], steps[1:]
        field_type, value = step.field.type, getattr(value, attribute(step.field.name))
        if isinstance(step.pick, int):
            field_type, value = field_type.element, element_at(value, step.pick, path)
        elif step.pick is not None:
            value = value[step.pick]
            if rest:
                return self._follow_each(path, rest, value)
            return self._several(_part_of(field_type), value, path, self._limits.depth, self._limits.slice)
        if rest:
            return self._follow(path, rest, value)
        if field_type.arity == "single" and field_type.base in TEXTS:
            return self._text(value, path, self._limits.slice)
        return self._value(field_type, value, path, self._limits.depth)

    def _follow_each(self, path: str, rest: tuple[Step, ...], values: Sequence[Any]) -> Any:
        most = self._limits.slice
        first = [self._follow(path, rest, value) for value in values[:most]]
        if len(values) <= most:
            return first
        self._cut(path)
        return list_summary(FieldType(rest[-1].field.type.base, "sequence"), len(values), first)

    def _cut(self, path: str) -> None:
        self._truncated[path] = None


def _part_of(field_type: FieldType) -> FieldType:
    return FieldType(field_type.base, "sequence", 0, field_type.text_bound)
