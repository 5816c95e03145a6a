"""Arguments of prompts. MCP passes them as text; this module converts text to checked values, and values to text."""

from __future__ import annotations

import ast
import json
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any, NamedTuple, cast

from ros2_mcp.model import names
from ros2_mcp.model.errors import BadInput, BadName

_TRUE = ("true", "1", "yes", "on")
_FALSE = ("false", "0", "no", "off")
_NOTHING = ("none", "null")
"""Words for a value that is not given, as programs write it."""


@dataclass(frozen=True, slots=True)
class Argument:
    """One argument of a prompt.

    `kind` is a key of `KINDS`. `default` is a value of that kind, or None if there is no default. `choices` are the
    allowed values; `other_choices` maps other spellings to them. `minimum` and `maximum` bound numbers. `type_of` names
    the argument whose topic has this message type.
    """

    name: str
    description: str
    kind: str = "string"
    required: bool = False
    default: Any = None
    choices: Sequence[Any] = ()
    other_choices: Mapping[str, str] | None = None
    minimum: float = -math.inf
    maximum: float = math.inf
    type_of: str = ""

    def value(self, text: str) -> Any:
        """Parse a client's text into a value.

        Raises:
            BadInput: naming the argument, the text and the allowed values.
        """
        reason = ""
        try:
            value = KINDS[self.kind].value(text.strip())
            if isinstance(value, (int, float)) and not self.minimum <= value <= self.maximum:
                raise ValueError
            value = (self.other_choices or {}).get(str(value), value)
        except (ValueError, KeyError):
            value = None
        except BadName as error:
            value, reason = None, error.message
        if value is None or (self.choices and value not in self.choices):
            raise BadInput(f"The argument {self.name} cannot be {text!r}.", f"{reason} Give {self.allowed()}.".strip())
        return value

    def allowed(self) -> str:
        """Describe the allowed values."""
        if self.choices:
            return f"one of {', '.join(shown(choice) for choice in self.choices)}"
        low, high = math.isfinite(self.minimum), math.isfinite(self.maximum)
        bounds = f" from {shown(self.minimum)} to {shown(self.maximum)}" if low and high else ""
        bounds = bounds or (f" of at least {shown(self.minimum)}" if low else "")
        return KINDS[self.kind].words + (bounds or (f" of at most {shown(self.maximum)}" if high else ""))

    def explained(self) -> str:
        """Return the description for the user, with the allowed values and the default."""
        notes = [self.allowed()] if self.choices or self.kind in ("number", "integer", "boolean") else []
        if self.default not in (None, "", []):
            notes.append(f"default: {shown(self.default)}")
        return f"{self.description} ({'; '.join(notes)})" if notes else self.description


def _number(text: str) -> float:
    value = float(text)
    if not math.isfinite(value):
        raise ValueError
    return value


def _boolean(text: str) -> bool:
    return {**dict.fromkeys(_TRUE, True), **dict.fromkeys(_FALSE, False)}[text.lower()]


def _list(text: str) -> list[str]:
    """Parse `a, b`, the JSON `["a", "b"]`, or Python's `['a', "b"]`, which prompts of other servers use."""
    if not text.startswith(("[", "(")):
        return [part.strip() for part in text.split(",") if part.strip()]
    try:
        parts = json.loads(text)
    except (ValueError, RecursionError):
        parts = _literal(text)
    if not isinstance(parts, (list, tuple)):
        raise ValueError
    found = list(cast("Sequence[Any]", parts))
    if not all(isinstance(part, str) for part in found):
        raise ValueError
    return found


def _json(text: str) -> Any:
    """Parse any JSON value but null, which means not given; NaN and infinities are rejected."""
    try:
        return json.loads(text, parse_constant=_no_number)
    except RecursionError:
        raise ValueError from None


def _no_number(_: str) -> None:
    raise ValueError


def _literal(text: str) -> Any:
    """Parse a Python literal; raises `ValueError` in place of Python's other errors."""
    try:
        return ast.literal_eval(text)
    except (SyntaxError, TypeError, MemoryError, RecursionError) as error:
        raise ValueError from error


def _name_of(what: str) -> Callable[[str], str]:
    return lambda text: names.absolute(text, what)


def _names_of(what: str) -> Callable[[str], list[str]]:
    return lambda text: [names.absolute(part, what) for part in _list(text)]


class Kind(NamedTuple):
    """A kind of argument: the function that parses a text (raising `ValueError` if it cannot), and a description."""

    value: Callable[[str], Any]
    words: str


KINDS: Mapping[str, Kind] = {
    "string": Kind(str, "a text"),
    "number": Kind(_number, "a number"),
    "integer": Kind(int, "a whole number"),
    "boolean": Kind(_boolean, "true or false"),
    "json": Kind(_json, "JSON, such as [[1, 2], [3, 4]]"),
    "list": Kind(_list, 'a list, such as a, b or ["a", "b"]'),
    "topic": Kind(_name_of("topic"), "the name of a topic, such as /scan"),
    "topics": Kind(_names_of("topic"), "names of topics, such as /scan, /odom"),
    "service": Kind(_name_of("service"), "the name of a service, such as /reset"),
    "services": Kind(_names_of("service"), "names of services, such as /reset, /save"),
    "node": Kind(_name_of("node"), "the name of a node, such as /driver"),
    "nodes": Kind(_names_of("node"), "names of nodes, such as /driver, /planner"),
    "action": Kind(_name_of("action"), "the name of an action, such as /navigate"),
    "message_type": Kind(partial(names.interface_type, kind="msg"), "a type, such as sensor_msgs/msg/LaserScan"),
}
"""The kinds of arguments."""


def values_of(
    arguments: Sequence[Argument], given: Mapping[str, str], whose: str = "This prompt", word: str = "argument"
) -> dict[str, Any]:
    """Return a checked value for every argument: the given value, else the default.

    Empty text counts as not given; so do None and null for an optional argument that is not a string.

    Raises:
        BadInput: for an unknown, missing or wrong argument.
    """
    declared = [argument.name for argument in arguments]
    for name in given:
        if name not in declared:
            takes = f"Its {word}s: {', '.join(declared)}." if declared else f"It has no {word}s."
            raise BadInput(f"{whose} has no {word} {name!r}.", names.did_you_mean(name, declared, takes))
    values: dict[str, Any] = {}
    for argument in arguments:
        text = given.get(argument.name, "")
        if not argument.required and argument.kind != "string" and text.strip().lower() in _NOTHING:
            text = ""
        if not text.strip() and argument.required and argument.default is None:
            problem = f"{whose} needs the {word} {argument.name}: {argument.description}."
            raise BadInput(problem, f"Give {argument.allowed()}.")
        values[argument.name] = argument.value(text) if text.strip() else argument.default
    return values


def shown(value: Any) -> str:
    """Return a value as text: `true`, `2.5`, `60`, `a, b`."""
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, float) and value.is_integer() and abs(value) < 1e15:
        return str(int(value))
    if isinstance(value, (list, tuple)):
        return ", ".join(shown(part) for part in cast("Sequence[Any]", value))
    return "" if value is None else str(value)
