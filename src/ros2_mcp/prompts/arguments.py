"""Arguments of prompts. MCP hands them over as text; here they become checked values, and values become text again."""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, cast

from ros2_mcp.model import names
from ros2_mcp.model.errors import BadInput, BadName

_TRUE = ("true", "1", "yes", "on")
_FALSE = ("false", "0", "no", "off")


@dataclass(frozen=True, slots=True)
class Argument:
    """One argument of a prompt.

    `kind` is a word of `KINDS`. `default` is a value of that kind, or None where leaving it out means nothing.
    `choices` are the values allowed; `other_choices` maps further spellings to them. `minimum` and `maximum` bound
    numbers. `type_of` names the argument whose topic has this message type.
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
        """The value that a client's text means.

        Raises:
            BadInput: naming the argument, what was given and what is allowed.
        """
        try:
            value = KINDS[self.kind](text.strip())
        except (ValueError, BadName) as error:
            reason = error.message if isinstance(error, BadName) else ""
            raise self._wrong(text, reason) from None
        if isinstance(value, (int, float)) and not self.minimum <= value <= self.maximum:
            raise self._wrong(text)
        value = (self.other_choices or {}).get(str(value), value)
        if self.choices and value not in self.choices:
            raise self._wrong(text)
        return value

    def allowed(self) -> str:
        """What may be given, in words."""
        if self.choices:
            return f"one of {', '.join(shown(choice) for choice in self.choices)}"
        return _IN_WORDS[self.kind] + self._bounds()

    def explained(self) -> str:
        """The description as the user sees it, with what is allowed and the default."""
        notes = [self.allowed()] if self.choices or self.kind in ("number", "integer", "boolean") else []
        if self.default not in (None, "", []):
            notes.append(f"default: {shown(self.default)}")
        return f"{self.description} ({'; '.join(notes)})" if notes else self.description

    def _bounds(self) -> str:
        if math.isfinite(self.minimum) and math.isfinite(self.maximum):
            return f" from {shown(self.minimum)} to {shown(self.maximum)}"
        if math.isfinite(self.minimum):
            return f" of at least {shown(self.minimum)}"
        return f" of at most {shown(self.maximum)}" if math.isfinite(self.maximum) else ""

    def _wrong(self, text: str, reason: str = "") -> BadInput:
        return BadInput(f"Argument {self.name} is {text!r}.", f"{reason} Give {self.allowed()}.".strip())


def _string(text: str) -> str:
    return text


def _number(text: str) -> float:
    value = float(text)
    if not math.isfinite(value):
        raise ValueError
    return value


def _integer(text: str) -> int:
    return int(text)


def _boolean(text: str) -> bool:
    if text.lower() not in _TRUE + _FALSE:
        raise ValueError
    return text.lower() in _TRUE


def _one_name(what: str) -> Callable[[str], str]:
    return lambda text: names.absolute(text, what)


def _message_type(text: str) -> str:
    return names.interface_type(text, "msg")


def _list(text: str) -> list[str]:
    """`a, b` or the JSON `["a", "b"]`."""
    if not text.startswith("["):
        return [part.strip() for part in text.split(",") if part.strip()]
    parts = json.loads(text)
    if not all(isinstance(part, str) for part in parts):
        raise ValueError
    return parts


def _many_names(what: str) -> Callable[[str], list[str]]:
    return lambda text: [names.absolute(part, what) for part in _list(text)]


KINDS: Mapping[str, Callable[[str], Any]] = {
    "string": _string,
    "number": _number,
    "integer": _integer,
    "boolean": _boolean,
    "list": _list,
    "topic": _one_name("topic"),
    "topics": _many_names("topic"),
    "service": _one_name("service"),
    "services": _many_names("service"),
    "node": _one_name("node"),
    "nodes": _many_names("node"),
    "action": _one_name("action"),
    "message_type": _message_type,
}
"""What an argument can be, with what makes its value out of text."""

_IN_WORDS: Mapping[str, str] = {
    "string": "a text",
    "number": "a number",
    "integer": "a whole number",
    "boolean": "true or false",
    "list": 'a list, such as a, b or ["a", "b"]',
    "topic": "the name of a topic, such as /scan",
    "topics": "names of topics, such as /scan, /odom",
    "service": "the name of a service, such as /reset",
    "services": "names of services, such as /reset, /save",
    "node": "the name of a node, such as /driver",
    "nodes": "names of nodes, such as /driver, /planner",
    "action": "the name of an action, such as /navigate",
    "message_type": "a type, such as sensor_msgs/msg/LaserScan",
}


def values_of(arguments: Sequence[Argument], given: Mapping[str, str]) -> dict[str, Any]:
    """A checked value for every argument: the given one, else the default. Empty text counts as not given.

    Raises:
        BadInput: for an unknown, missing or wrong argument.
    """
    known = [argument.name for argument in arguments]
    for name in given:
        if name not in known:
            takes = f"It takes: {', '.join(known)}." if known else "It takes none."
            raise BadInput(f"This prompt has no argument {name!r}.", names.did_you_mean(name, known, takes))
    return {argument.name: _value(argument, given.get(argument.name, "")) for argument in arguments}


def _value(argument: Argument, text: str) -> Any:
    if text.strip():
        return argument.value(text)
    if argument.required and argument.default is None:
        raise BadInput(
            f"This prompt needs the argument {argument.name}: {argument.description}.", f"Give {argument.allowed()}."
        )
    return argument.default


def shown(value: Any) -> str:
    """A value as text: `true`, `2.5`, `60`, `a, b`."""
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, float) and value.is_integer() and abs(value) < 1e15:
        return str(int(value))
    if isinstance(value, (list, tuple)):
        return ", ".join(shown(part) for part in cast("Sequence[Any]", value))
    return "" if value is None else str(value)
