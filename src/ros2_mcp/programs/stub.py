"""The module `robot` in words: a typed stub for the check of types, and a short form for who writes programs."""

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
from typing import Any, Iterator, Literal, Sequence, TypedDict
Message = dict[str, Any]
class Messages:
    def __iter__(self) -> Iterator[Message]: ...
"""


_OF_RECORDINGS = ("bag", "start", "end")
"""Arguments of whatever can read a recording: the first one stands for all in the short form."""
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
_TOOLS = "As the tools, with their arguments and the fields of their results (print one to see them):"
_MOST_OPTIONAL = 2
_MOST_FIELDS = 4
"""Of a result in the short form; the check of types knows all, and names the nearest."""


class Stream:
    """What `messages` gives: the program iterates over it."""


def stub(functions: Sequence[Function]) -> str:
    """The whole stub, as the check of types reads it: results are typed to their last field."""
    classes: dict[str, str] = {}
    lines = [
        f"def {each.name}({_arguments(each.signature, classes)}) -> {_result(each, classes)}: ..." for each in functions
    ]
    return "\n".join([_HEAD, *classes.values(), *lines, ""])


def short(functions: Sequence[Function]) -> str:
    """The functions as a model reads them: those that only programs have a line each, with arguments and the fields of
    the result; of those that are tools, what must be given. The whole is a part of a description, of which some clients
    show no more than 2,048 characters.
    """
    alike: dict[str, list[str]] = {}
    for each in functions:
        if not each.tool:
            alike.setdefault(f"({_short_arguments(each.signature)}){_short_result(each)}", []).append(each.name)
    own = [f"{', '.join(names)}{rest}" for rest, names in alike.items()]
    tools = ", ".join(f"{each.name}({_needed_arguments(each.signature)})" for each in functions if each.tool)
    return "\n".join([*own, *([f"{_TOOLS}\n{tools}"] if tools else [])])


def _arguments(signature: inspect.Signature, classes: dict[str, str]) -> str:
    shown: list[str] = []
    for name, each in signature.parameters.items():
        star = "*" if each.kind is inspect.Parameter.VAR_POSITIONAL else ""
        default = "" if each.default is inspect.Parameter.empty else " = ..."
        shown.append(f"{star}{name}: {_type(each.annotation, classes)}{default}")
    return ", ".join(shown)


def _result(function: Function, classes: dict[str, str]) -> str:
    kind = function.signature.return_annotation
    if function.unwrapped:
        kind = get_type_hints(kind)[function.unwrapped]
    return "Messages" if kind is Stream else _type(kind, classes)


def _type(kind: Any, classes: dict[str, str]) -> str:
    """A type of ours as one of the stub; what is a class of data becomes a typed dictionary."""
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
        classes[kind.__name__] = ""  # it may be in itself
        hints = get_type_hints(kind)
        rows = [
            f"    {each.name}: {_of_result(hints[each.name], classes)}"
            for each in fields(kind)
            if not each.metadata.get("hidden")
        ]
        text = "\n".join([f"class {kind.__name__}(TypedDict):", *(rows or ["    pass"])])
        del classes[kind.__name__]  # behind those that it refers to
        classes[kind.__name__] = text
    return kind.__name__


def _of_result(kind: Any, classes: dict[str, str]) -> str:
    """A field of a result: what may be null there is taken as it is, so that nobody has to ask before each use."""
    present = [each for each in get_args(kind) if each is not type(None)]
    if get_origin(kind) in (Union, types.UnionType) and len(present) < len(get_args(kind)):
        return "Any"
    return _type(kind, classes).replace("Sequence[", "list[")


def _short_arguments(signature: inspect.Signature) -> str:
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
    """What must be given, and as many of the others as tell what it is about."""
    given = [each.name for each in signature.parameters.values() if each.default is inspect.Parameter.empty]
    others = [f"{name}?" for name in signature.parameters if name not in given and name not in _OF_RECORDINGS]
    shown = others[: max(_MOST_OPTIONAL - len(given), 0)]
    return ", ".join([*given, *shown, *(["…"] if len(shown) < len(others) else [])])


def _short_result(function: Function) -> str:
    kind = function.signature.return_annotation
    if kind is Stream:
        return " → for"
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
    """The fields that a program asks for: what it gave itself, and words about it, are none."""
    names = [each.name for each in fields(kind) if not each.metadata.get("hidden") and each.name not in left_out]
    return f"{{{', '.join(names[:_MOST_FIELDS])}{', …' if len(names) > _MOST_FIELDS else ''}}}"
