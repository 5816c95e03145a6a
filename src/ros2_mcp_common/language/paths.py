"""Paths to fields: `pose.pose.position`, `ranges[0:10]`, `name[-1]`, `transforms[*].header.frame_id`.

`transforms[child_frame_id == "base_link"]` selects the elements with that value, `data[100:200]` of a text these
characters. Server and bridge share the paths, which read messages of rosbags as well as of rclpy. Needs no ROS.
"""

from __future__ import annotations

import difflib
import keyword
import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import lru_cache, reduce
from operator import attrgetter
from typing import Any, cast

from ros2_mcp_common.language.field_types import TEXTS, FieldType, TypedField, Types

_PART = re.compile(r"(?P<name>[A-Za-z]\w*)(?P<brackets>(?:\[[^\[\]]*\])?)", re.ASCII)
_AFTER = re.compile(r"(?P<brackets>(?:\[[^\[\]]*\])?)(?:\.(?P<rest>.+))?", re.DOTALL)
_DOT = re.compile(r"\.(?![^\[]*\])")  # not within brackets
_WHERE = re.compile(r"""\s*(?P<path>[\w.]+)\s*==\s*(?:"(?P<text>[^"]*)"|'(?P<other>[^']*)'|(?P<number>-?\d+))\s*""")
_INDEX = re.compile(r"-?\d+", re.ASCII)
_SLICE = re.compile(r"(-?\d+)?:(-?\d+)?(?::([1-9]\d*))?", re.ASCII)
_ABSENT = "this message has no such value."
_NOT_AN_INDEX = 'Write [3], [-1], [0:10], [::5], [*] or [name == "x"].'


class PathError(ValueError):
    """Raised for a path that does not exist, or has no value in a message; the hint says what would be right."""

    def __init__(self, path: str, message: str, hint: str = "") -> None:
        super().__init__(f"{path}: {message}" if path else message)
        self.path = path
        self.message = message
        self.hint = hint


@dataclass(frozen=True)
class Where:
    """Selects the elements of a list of messages whose value at `path` equals `value`."""

    path: FieldPath
    value: str | int

    def among(self, elements: Sequence[object]) -> list[object]:
        """Return the selected elements."""
        return [element for element in elements if self.path.value_in(element) == self.value]


Pick = int | slice | Where | None


@dataclass(frozen=True)
class Step:
    """One field of a path, and the selection from it: one element, a slice, elements by value, or
    None for the whole field.
    """

    field: TypedField
    pick: Pick = None

    @property
    def type(self) -> FieldType:
        """The type of the field, or of one element if elements are selected."""
        return self.field.type if self.pick is None else self.field.type.element

    @property
    def is_several(self) -> bool:
        """Whether the step selects several values; a part of a text counts as one value."""
        return isinstance(self.pick, (slice, Where)) and self.field.type.arity != "single"


@dataclass(frozen=True)
class FieldPath:
    """A path that fits the definition of a type; made by `parse`."""

    path: str
    steps: tuple[Step, ...]

    @property
    def type(self) -> FieldType:
        """The type at the end of the path; that of one element if several are selected."""
        return self.steps[-1].type

    @property
    def is_list(self) -> bool:
        """Whether the path leads to several values."""
        return self.type.arity != "single" or any(step.is_several for step in self.steps)

    def finds_none_in(self, message: object) -> bool:
        """Return whether the path selects elements by value and the message has none."""
        return any(isinstance(step.pick, Where) for step in self.steps) and not len(self.value_in(message))

    def element(self, number: int) -> int | None:
        """Return the index, in the message's own list, of the value with this number.

        Return None if it cannot be known: several lists lead there, elements are selected by value, or the slice counts
        from the end of a list of variable length.
        """
        lists = [step for step in self.steps if step.is_several]
        if self.type.arity != "single":
            lists.append(self.steps[-1])
        if len(lists) != 1 or isinstance(lists[0].pick, Where):
            return None
        field, pick = lists[0].field, lists[0].pick
        if not isinstance(pick, slice):
            return number
        start = pick.start or 0
        if start < 0:
            if field.type.arity != "array":
                return None
            start = max(start + field.type.size, 0)
        return start + number * (pick.step or 1)

    def value_in(self, message: object) -> Any:
        """Return the value in a message. If elements of a list are selected before the last field, it is
        a flat list of all values.

        Raises:
            PathError: if a list has no such element, or a JSON message has no such field, or null.
        """
        try:
            if all(step.pick is None for step in self.steps):
                value = _getter(tuple(step.field.name for step in self.steps))(message)
                value = _integers(value) if self.type.base == "byte" else value
            else:
                value = _follow(self.path, self.steps, message)
        except (AttributeError, TypeError) as error:
            raise PathError(self.path, _ABSENT) from error
        if value is None:
            raise PathError(self.path, _ABSENT)
        return value


def parse(types: Types, type_name: str, path: str) -> FieldPath:
    """Parse a path and check it against the definition.

    Raises:
        PathError: for a path that does not exist; names the nearest that does.
    """
    steps: list[Step] = []
    inside = FieldType(type_name)
    rest: str | None = path.strip()
    while rest is not None:
        name, brackets, following = _first_of(types, inside, rest)
        if not name:
            part = _DOT.split(rest, 1)[0]
            raise PathError(
                path, f"{part!r} is not a field.", f"A path is like pose.position or ranges[0:10]. {_NOT_AN_INDEX}"
            )
        steps.append(_step(types, path, inside, name, brackets))
        inside, rest = steps[-1].type, following
    return FieldPath(path.strip(), tuple(steps))


def _first_of(types: Types, inside: FieldType, rest: str) -> tuple[str, str, str | None]:
    """Return name and brackets of the first field of a path ("" if there is none), and the rest of the path or None.

    Names in JSON may be unlike those of ROS (`front light`, `v.x`): such a name is written in a path as it is.
    """
    if inside.is_message and inside.arity == "single":
        odd = [name for name in types.fields(inside.base) if not _PART.fullmatch(name) and rest.startswith(name)]
        for name in sorted(odd, key=len, reverse=True):
            if match := _AFTER.fullmatch(rest, len(name)):
                return name, match["brackets"], match["rest"]
    part, *following = _DOT.split(rest, 1)
    if match := _PART.fullmatch(part):
        return match["name"], match["brackets"], following[0] if following else None
    return "", "", None


def value_at(message: object, path: str) -> Any:
    """Return the value at a path of names and dots only."""
    return _getter(tuple(path.split(".")))(message)


def attribute(name: str) -> str:
    """Return the Python attribute of a field: with a `_` appended to a Python keyword, as rosbags does."""
    return f"{name}_" if keyword.iskeyword(name) else name


@lru_cache(maxsize=4096)
def _getter(path: tuple[str, ...]) -> Callable[[object], Any]:
    if all(map(str.isidentifier, path)):
        return attrgetter(".".join(map(attribute, path)))
    return lambda message: reduce(getattr, path, message)  # a name in JSON may contain dots and spaces


def _step(types: Types, path: str, inside: FieldType, name: str, brackets: str) -> Step:
    if inside.arity != "single":
        raise PathError(path, f"{inside} is a list; {name!r} is a field of its elements.", _NOT_AN_INDEX)
    if not inside.is_message:
        raise PathError(path, f"{inside} has no fields, so {name!r} cannot be one.")
    fields = types.fields(inside.base)
    if name not in fields:
        near = _nearest(name, list(fields))
        hint = f"Did you mean {near}? " if near else ""
        raise PathError(path, f"{inside.base} has no field {name!r}.", f"{hint}Its fields are {', '.join(fields)}.")
    field, index = fields[name], brackets[1:-1]
    if not brackets:
        return Step(field)
    if field.type.arity == "single":
        if field.type.base in TEXTS and (match := _SLICE.fullmatch(index)):
            return Step(field, _slice(match))
        hint = f"{name}[0:100] are characters of it." if field.type.base in TEXTS else ""
        raise PathError(path, f"{name} is a single {field.type}, not a list.", hint)
    if index == "*":
        return Step(field, slice(None))
    if _INDEX.fullmatch(index):
        size = field.type.size
        if field.type.arity == "array" and size and not -size <= int(index) < size:
            raise no_element(path, int(index), size)
        return Step(field, int(index))
    if found := _WHERE.fullmatch(index):
        return Step(field, _where(types, path, field, found))
    match = _SLICE.fullmatch(index)
    if match is None:
        raise PathError(path, f"[{index}] is not an index.", _NOT_AN_INDEX)
    return Step(field, _slice(match))


def _slice(match: re.Match[str]) -> slice:
    return slice(*(int(bound) if bound else None for bound in match.groups()))


def _where(types: Types, path: str, field: TypedField, found: re.Match[str]) -> Where:
    """Return the selection that `[name == "x"]` means. Raise `PathError` if the elements cannot have such a value."""
    below = parse(types, field.type.base, found["path"]) if field.type.is_message else None
    value = int(found["number"]) if found["number"] else found["text"] or found["other"] or ""
    kind = below.type if below and not below.is_list else None
    if below is None or kind is None or not (kind.base in TEXTS if isinstance(value, str) else kind.is_number):
        raise PathError(path, f"{found[0].strip()} cannot be applied to {field.type}.", _NOT_AN_INDEX)
    return Where(below, value)


def several_of(values: Any, pick: slice | Where) -> Any:
    """Return the selected elements of a list or an array."""
    return values[pick] if isinstance(pick, slice) else pick.among(values)


def no_element(path: str, index: int, length: int) -> PathError:
    """Return the error for an index that a list of that length does not have."""
    there = f"only [0] to [{length - 1}]" if length else "it is empty"
    return PathError(path, f"there is no element [{index}], {there}.")


def element_at(values: Any, index: int, path: str) -> Any:
    """Return one element of a list or array. Raise `PathError` if it is too short."""
    if not -len(values) <= index < len(values):
        raise no_element(path, index, len(values))
    element = values[index]
    return element.item() if type(element).__module__ == "numpy" else element  # NumPy numbers as Python's


def _follow(path: str, steps: Sequence[Step], value: Any) -> Any:
    for index, step in enumerate(steps, 1):
        value = getattr(value, attribute(step.field.name))
        if step.field.type.base == "byte":
            value = _integers(value)
        if isinstance(step.pick, int):
            value = element_at(value, step.pick, path)
        elif step.pick is not None:
            value = several_of(value, step.pick)
            if index < len(steps):
                return [leaf for element in value for leaf in _leaves(_follow(path, steps[index:], element))]
    return value


def _leaves(value: Any) -> Sequence[Any]:
    return cast("Sequence[Any]", value) if hasattr(value, "__len__") and not isinstance(value, str) else [value]


def _integers(value: Any) -> Any:
    """Return a `byte`, or a list of them, as integers: in rclpy each is a bytes object of length
    1, in rosbags an integer.
    """
    if isinstance(value, bytes):
        return value[0]
    if isinstance(value, list):
        return [_integers(each) for each in cast("list[object]", value)]
    return value


def _nearest(name: str, known: Sequence[str]) -> str:
    """Return the known name most similar to this name, or ""."""
    by_folded = {candidate.lower(): candidate for candidate in known}
    # 0.6 is the default of difflib.
    close = difflib.get_close_matches(name.lower(), list(by_folded), n=1, cutoff=0.6)
    return by_folded[close[0]] if close else ""
