"""From the texts of definitions to structures, including the types that services and actions imply."""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import Any

from rosbags.interfaces import Nodetype
from rosbags.typesys import TypesysError, get_types_from_idl

from ros2_mcp.codec.msg_text import read_structure, split_sections
from ros2_mcp.model.errors import UnknownInterface
from ros2_mcp.model.interfaces import PRIMITIVES, Constant, DefinitionText, Field, FieldType, Structure

SIDES: Mapping[str, Mapping[str, str]] = {
    "msg": {"message": ""},
    "srv": {"request": "_Request", "response": "_Response"},
    "action": {"goal": "_Goal", "result": "_Result", "feedback": "_Feedback"},
}
"""The sides of each kind of interface, with the ending of the side's own type."""

ALWAYS_KNOWN: Mapping[str, DefinitionText] = {
    "builtin_interfaces/msg/Time": DefinitionText("msg", "int32 sec\nuint32 nanosec\n"),
    "builtin_interfaces/msg/Duration": DefinitionText("msg", "int32 sec\nuint32 nanosec\n"),
    "unique_identifier_msgs/msg/UUID": DefinitionText("msg", "uint8[16] uuid\n"),
}
"""What the services of an action refer to, for robots that send only the action itself."""

_IMPLIED_BY_SERVICE = {
    "_Event": ("service_msgs/msg/ServiceEventInfo info\n{name}_Request[<=1] request\n{name}_Response[<=1] response\n"),
}
_IMPLIED_BY_ACTION = {
    "_SendGoal_Request": "unique_identifier_msgs/msg/UUID goal_id\n{name}_Goal goal\n",
    "_SendGoal_Response": "bool accepted\nbuiltin_interfaces/msg/Time stamp\n",
    "_GetResult_Request": "unique_identifier_msgs/msg/UUID goal_id\n",
    "_GetResult_Response": "int8 status\n{name}_Result result\n",
    "_FeedbackMessage": "unique_identifier_msgs/msg/UUID goal_id\n{name}_Feedback feedback\n",
}
_IMPLIED = {"msg": {}, "srv": _IMPLIED_BY_SERVICE, "action": _IMPLIED_BY_ACTION}
_IDENTIFIER = r"[A-Za-z]\w*"
_TYPE_NAME = re.compile(rf"{_IDENTIFIER}/(msg|srv|action)/{_IDENTIFIER}", re.ASCII)
_INCLUDE = re.compile(r"^\s*#.*$", re.MULTILINE)
_PLACEHOLDER = "structure_needs_at_least_one_member"


def kind_of(type_name: str) -> str:
    """`msg`, `srv` or `action`.

    Raises:
        UnknownInterface: if it is not the full name of an interface.
    """
    match = _TYPE_NAME.fullmatch(type_name)
    if match is None:
        raise UnknownInterface(f"{type_name[:80]!r} is not the full name of a type.", "Write it as package/msg/Name.")
    return match[1]


def types_of(name: str) -> list[str]:
    """The names of all the types with fields that the interface `name` defines."""
    kind = kind_of(name)
    return [name + ending for ending in (*SIDES[kind].values(), *_IMPLIED[kind])]


def structures_of(name: str, source: DefinitionText) -> dict[str, Structure]:
    """Every structure that the interface `name` defines, by its full type name.

    Raises:
        UnknownInterface: if the text cannot be read.
    """
    kind = kind_of(name)
    types = [name + ending for ending in SIDES[kind].values()]
    if source.format == "idl":
        found = _read_idl(name, source.text)
        missing = [each for each in types if each not in found]
        if missing:
            raise UnknownInterface(f"The IDL text of {name} does not define {missing[0]}.")
    else:
        parts = split_sections(source.text)
        if len(parts) != len(types):
            raise UnknownInterface(f"The definition of {name} has {len(parts)} parts, a {kind} has {len(types)}.")
        found = {each: read_structure(each, part) for each, part in zip(types, parts, strict=True)}
    for ending, text in _IMPLIED[kind].items():
        found.setdefault(name + ending, read_structure(name + ending, text.format(name=name)))
    return found


def _read_idl(name: str, text: str) -> dict[str, Structure]:
    try:
        return {
            type_name: Structure(
                type_name,
                tuple(Field(field, _idl_type(field, node)) for field, node in fields if field != _PLACEHOLDER),
                tuple(Constant(constant, str(base), value) for constant, base, value in constants),
            )
            for type_name, (constants, fields) in get_types_from_idl(_INCLUDE.sub("", text)).items()
        }
    except (TypesysError, ValueError) as error:
        raise UnknownInterface(f"The IDL text of {name} cannot be read: {str(error)[:300]}") from error


def _idl_type(field: str, node: Any) -> FieldType:
    """The type that a node of rosbags' parse tree stands for: (kind, (name, bound)), or (kind, (element, size))."""
    kind, rest = node
    if kind == Nodetype.NAME:
        return FieldType(rest)
    if kind == Nodetype.BASE:
        base, bound = rest
        if base not in PRIMITIVES:
            raise ValueError(f"the field {field} is a {base}, which ROS messages cannot carry")
        return FieldType(base, text_bound=bound)
    element = _idl_type(field, rest[0])
    arity = "array" if kind == Nodetype.ARRAY else "sequence"
    return FieldType(element.base, arity, rest[1], element.text_bound)
