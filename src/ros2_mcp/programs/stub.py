"""The module `robot` as text: a typed stub for the type check, and a short form for the authors of programs."""

from __future__ import annotations

import inspect
import types
from collections.abc import Mapping, Sequence
from dataclasses import fields, is_dataclass
from typing import Any, Literal, Union, get_args, get_origin, get_type_hints

from ros2_mcp.programs.declare import Function

_PLAIN: Mapping[Any, str] = {
    str: "str",
    int: "int",
    float: "float",
    bool: "bool",
    bytes: "bytes",
    Any: "Any",
    object: "Any",
    None: "None",
    type(None): "None",
    inspect.Signature.empty: "Any",
}
_HEAD = """\
from typing import Any, Iterator, Literal, Mapping, Sequence, TypedDict
Message = dict[str, Any]
class Messages:
    def __iter__(self) -> Iterator[Message]: ...
"""


_OF_RECORDINGS = ("bag", "start", "end")
"""Arguments of functions that can read recordings: in the short form the first argument represents all."""
_SAID_ELSEWHERE = frozenset(
    {
        "topic_name",
        "topic_type",
        "note",
        "source",
        "elapsed",
        "elapsed_s",
        "waited",
        "service_name",
        "action_name",
        "action_type",
        "qos",
        "condition",
    }
)
_TOOLS = "The tools, with all their arguments (here what must be given):"
_NUMBER = " → float"
_MOST_FIELDS = 3
"""The most fields of a result in the short form. The type check knows all, and suggests the most similar name."""


class Stream:
    """The type of the result of `messages`, over which the program iterates."""


def stub(functions: Sequence[Function]) -> str:
    """Return the complete stub for the type check; results are typed to their last field."""
    classes: dict[str, str] = {}
    lines = [
        f"def {each.name}({_arguments(each.signature, classes)}) -> {_result(each, classes)}: ..." for each in functions
    ]
    return "\n".join([_HEAD, *classes.values(), *lines, ""])


def short(functions: Sequence[Function]) -> str:
    """Return the functions in the short form that models read.

    Functions that only programs have get a line each, with arguments and the fields of the result; those that return
    one number share a line; of tools, the required arguments are listed. All of it is part of a description, of which
    some clients show only 2,048 characters.
    """
    own: list[str] = []
    numbers: list[str] = []
    for each in functions:
        arguments, result = short_arguments(each.signature), _short_result(each)
        if result == _NUMBER:
            numbers.append(each.name if len(each.signature.parameters) == 1 else f"{each.name}({arguments})")
        elif not each.tool:
            own.append(f"{each.name}({arguments}){result}")
    tools = ", ".join(f"{each.name}({_needed_arguments(each.signature)})" for each in functions if each.tool)
    lines = [*own, ", ".join(numbers) + _NUMBER if numbers else "", f"{_TOOLS}\n{tools}" if tools else ""]
    return "\n".join(filter(None, lines))


def _arguments(signature: inspect.Signature, classes: dict[str, str]) -> str:
    shown: list[str] = []
    for name, each in signature.parameters.items():
        star = "*" if each.kind is inspect.Parameter.VAR_POSITIONAL else ""
        # To the type checker a result, which is a TypedDict, is not a dict[str, Any].
        kind, default = _type(each.annotation, classes).replace("dict[str, Any]", "Mapping[str, Any]"), ""
        if each.default is not inspect.Parameter.empty:  # None means "not given" there
            kind, default = kind if kind in ("Any", "None") or kind.endswith("| None") else f"{kind} | None", " = ..."
        shown.append(f"{star}{name}: {kind}{default}")
    return ", ".join(shown)


def _result(function: Function, classes: dict[str, str]) -> str:
    kind = function.signature.return_annotation
    if function.unwrapped:
        kind = get_type_hints(kind)[function.unwrapped]
    return "Messages" if kind is Stream else _type(kind, classes)


def _type(kind: Any, classes: dict[str, str]) -> str:
    """Return a Python type as a type of the stub. A dataclass becomes a TypedDict."""
    if kind in _PLAIN:
        return _PLAIN[kind]
    origin, arguments = get_origin(kind), get_args(kind)
    if origin is not None and hasattr(kind, "__metadata__"):
        return _type(arguments[0], classes)
    if origin is Literal:
        return f"Literal[{', '.join(map(repr, arguments))}]"
    if origin in (Union, types.UnionType):
        return " | ".join(dict.fromkeys(_type(each, classes) for each in arguments))
    if origin in (list, tuple) or getattr(origin, "__name__", "") in ("Sequence", "Iterable"):
        return (
            f"list[{_type(arguments[0], classes)}]" if origin is list else f"Sequence[{_type(arguments[0], classes)}]"
        )
    if origin is not None or kind is dict:
        return "dict[str, Any]"
    if is_dataclass(kind) and isinstance(kind, type):
        return _typed_dictionary(kind, classes)
    return "Any"


def _typed_dictionary(kind: type[Any], classes: dict[str, str]) -> str:
    if kind.__name__ not in classes:
        classes[kind.__name__] = ""  # it may contain itself
        hints = get_type_hints(kind)
        rows = [
            f"    {each.name}: {_of_result(hints[each.name], classes)}"
            for each in fields(kind)
            if not each.metadata.get("hidden")
        ]
        text = "\n".join([f"class {kind.__name__}(TypedDict):", *(rows or ["    pass"])])
        del classes[kind.__name__]  # after those that it refers to
        classes[kind.__name__] = text
    return kind.__name__


def _of_result(kind: Any, classes: dict[str, str]) -> str:
    """Return the type of a result's field. A field that may be null is Any, so that programs need no check before each
    use.
    """
    present = [each for each in get_args(kind) if each is not type(None)]
    if get_origin(kind) in (Union, types.UnionType) and len(present) < len(get_args(kind)):
        return "Any"
    return _type(kind, classes).replace("Sequence[", "list[")


def short_arguments(signature: inspect.Signature) -> str:
    """Return the names of the arguments, optional arguments with a question mark."""
    shown: list[str] = []
    for name, each in signature.parameters.items():
        if name in _OF_RECORDINGS:
            continue
        star = "*" if each.kind is inspect.Parameter.VAR_POSITIONAL else ""
        shown.append(f"{star}{name}{'' if star or each.default is inspect.Parameter.empty else '?'}")
    if _OF_RECORDINGS[0] in signature.parameters:
        shown.append(_OF_RECORDINGS[0] + "?")
    return ", ".join(shown)


def _needed_arguments(signature: inspect.Signature) -> str:
    """Return the required arguments; if there are none, the first argument with a question mark."""
    given = [each.name for each in signature.parameters.values() if each.default is inspect.Parameter.empty]
    return ", ".join(given or [f"{name}?" for name in signature.parameters][:1])


def _short_result(function: Function) -> str:
    kind = function.signature.return_annotation
    if kind is Stream:
        return " → for"
    if len(some := [each for each in get_args(kind) if is_dataclass(each)]) == 1 and type(None) in get_args(kind):
        return f" → {_names(some[0])} | None"
    if function.unwrapped:
        kind = get_type_hints(kind)[function.unwrapped]
        element = get_args(kind)[0]
        return (
            f" → [{_names(element, frozenset())}]"
            if is_dataclass(element)
            else " → dict"
            if len(get_args(kind)) > 1
            else " → list"
        )
    if is_dataclass(kind):
        return f" → {_names(kind)}"
    return "" if kind in (None, type(None)) else f" → {_type(kind, {}).partition('[')[0]}"


def _names(kind: Any, left_out: frozenset[str] = _SAID_ELSEWHERE) -> str:
    """Return the most useful fields of a result: fields that repeat arguments or contain notes are omitted."""
    names = [each.name for each in fields(kind) if not each.metadata.get("hidden") and each.name not in left_out]
    return f"{{{', '.join(names[:_MOST_FIELDS])}{', …' if len(names) > _MOST_FIELDS else ''}}}"
