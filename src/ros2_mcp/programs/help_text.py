"""The text of `help()` in a program: a list of the functions of the module `robot`, or all about one function."""

from __future__ import annotations

import inspect
import types
from collections.abc import Sequence
from dataclasses import fields, is_dataclass
from typing import Any, Literal, Union, get_args, get_origin, get_type_hints

from ros2_mcp.model.names import did_you_mean
from ros2_mcp.programs.declare import Function
from ros2_mcp.programs.stub import Stream, short_arguments

_PLAIN = {int: "int", float: "float", str: "str", bool: "bool", bytes: "bytes", type(None): "None"}
_HEAD = "The functions of the module robot. help(robot.latest) prints one with its arguments and its result."


def help_text(functions: Sequence[Function], name: str = "") -> str:
    """Return a line for each function, or, for a name, the function's signature, description, arguments and result."""
    if not name:
        lines = [f"{each.name}({short_arguments(each.signature)}): {_first_sentence(each.doc)}" for each in functions]
        return "\n".join([_HEAD, *lines])
    found = next((each for each in functions if each.name == name), None)
    if found is None:
        return f"The module robot has no {name}. {did_you_mean(name, [each.name for each in functions])}".rstrip()
    arguments = [line for each in found.signature.parameters.values() if (line := _argument(each))]
    return "\n".join([signature_of(found), found.doc, *arguments, *_result_fields(found)])


def signature_of(function: Function) -> str:
    """Return the signature, as in `robot.turn(angle_deg: float, speed: float | None = None) -> {outcome, …}`."""
    shown: list[str] = []
    for name, each in function.signature.parameters.items():
        star = "*" if each.kind is inspect.Parameter.VAR_POSITIONAL else ""
        default = "" if each.default is inspect.Parameter.empty else f" = {each.default!r}"
        shown.append(f"{star}{name}: {_type(each.annotation)}{default}")
    kind = _result(function)
    result = "" if kind in (None, type(None)) else f" -> {_type(kind)}"
    return f"robot.{function.name}({', '.join(shown)}){result}"


def _argument(each: inspect.Parameter) -> str:
    """Return the line of an argument with a description; "" for an argument without a description."""
    said = [getattr(one, "description", None) for one in getattr(each.annotation, "__metadata__", ())]
    told = " ".join(one for one in said if isinstance(one, str))
    return f"  {each.name}: {told}" if told else ""


def _result(function: Function) -> Any:
    kind = function.signature.return_annotation
    return get_type_hints(kind)[function.unwrapped] if function.unwrapped else kind


def _result_fields(function: Function) -> list[str]:
    """Return the fields of the result, or of the elements of a list, with their types."""
    kind = _result(function)
    element = next((each for each in (kind, *get_args(kind)) if is_dataclass(each)), None)
    if not isinstance(element, type):
        return []
    hints = get_type_hints(element)
    rows = [f"  {each.name}: {_type(hints[each.name])}" for each in fields(element) if not each.metadata.get("hidden")]
    return [f"{element.__name__} is a dict:", *rows]


def _type(kind: Any) -> str:
    if kind in _PLAIN:
        return _PLAIN[kind]
    if kind is Stream:
        return "messages, for a for loop"
    if hasattr(kind, "__metadata__"):
        return _type(get_args(kind)[0])
    origin, arguments = get_origin(kind), get_args(kind)
    if origin is Literal:
        return " | ".join(map(repr, arguments))
    if origin in (Union, types.UnionType):
        return " | ".join(dict.fromkeys(map(_type, arguments)))
    if origin is tuple:
        return "tuple"
    name = getattr(origin, "__name__", "")
    if origin is list or name in ("Sequence", "Iterable"):
        return f"list[{_type(arguments[0])}]"
    if origin is not None or kind is dict or name == "Mapping":
        return "dict"
    return kind.__name__ if is_dataclass(kind) and isinstance(kind, type) else "Any"


def _first_sentence(text: str) -> str:
    return " ".join(text.partition("\n\n")[0].split()).partition(". ")[0].rstrip(".") + "."
