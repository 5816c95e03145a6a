"""Interface definitions as the robot has them, parsed when they are needed."""

from __future__ import annotations

import re
import threading
from collections.abc import Mapping, Sequence
from types import MappingProxyType
from typing import Any, cast

from rosbags.interfaces import Nodetype
from rosbags.typesys import TypesysError, get_types_from_idl

from ros2_mcp.model.errors import UnknownInterface
from ros2_mcp.model.interfaces import (
    HEADER,
    PRIMITIVES,
    TIME,
    Constant,
    DefinitionText,
    Field,
    FieldType,
    Interface,
    Structure,
)
from ros2_mcp.model.names import defining_type, did_you_mean
from ros2_mcp.model.text import named, quoted
from ros2_mcp.values.msg_text import read_structure, split_sections
from ros2_mcp.values.store import MessageStore, type_hash

__all__ = ["DefinitionText", "Definitions"]

_SIDES: Mapping[str, Mapping[str, str]] = {
    "msg": {"message": ""},
    "srv": {"request": "_Request", "response": "_Response"},
    "action": {"goal": "_Goal", "result": "_Result", "feedback": "_Feedback"},
}
"""The sides of each kind of interface, with the ending of the name of each side's type."""

_ALWAYS_KNOWN: Mapping[str, DefinitionText] = {
    TIME: DefinitionText("msg", "int32 sec\nuint32 nanosec\n"),
    "builtin_interfaces/msg/Duration": DefinitionText("msg", "int32 sec\nuint32 nanosec\n"),
    "unique_identifier_msgs/msg/UUID": DefinitionText("msg", "uint8[16] uuid\n"),
    "service_msgs/msg/ServiceEventInfo": DefinitionText(
        "msg",
        "uint8 REQUEST_SENT=0\nuint8 REQUEST_RECEIVED=1\nuint8 RESPONSE_SENT=2\nuint8 RESPONSE_RECEIVED=3\n"
        "uint8 event_type\nbuiltin_interfaces/Time stamp\nchar[16] client_gid\nint64 sequence_number\n",
    ),
}
"""Definitions of types that every service (for its events) and action (for its services) uses without naming them."""

_IMPLIED: Mapping[str, Mapping[str, str]] = {
    "msg": {},
    "srv": {
        "_Event": "service_msgs/msg/ServiceEventInfo info\n"
        "{name}_Request[<=1] request\n{name}_Response[<=1] response\n",
    },
    "action": {
        "_SendGoal_Request": "unique_identifier_msgs/msg/UUID goal_id\n{name}_Goal goal\n",
        "_SendGoal_Response": "bool accepted\nbuiltin_interfaces/msg/Time stamp\n",
        "_GetResult_Request": "unique_identifier_msgs/msg/UUID goal_id\n",
        "_GetResult_Response": "int8 status\n{name}_Result result\n",
        **{
            f"_{part}_Event": "service_msgs/msg/ServiceEventInfo info\n"
            f"{{name}}_{part}_Request[<=1] request\n{{name}}_{part}_Response[<=1] response\n"
            for part in ("SendGoal", "GetResult")
        },
        "_FeedbackMessage": "unique_identifier_msgs/msg/UUID goal_id\n{name}_Feedback feedback\n",
    },
}
"""The types that rosidl generates for each service and action, by the ending of their names."""
_IDENTIFIER = r"[A-Za-z]\w*"
_TYPE_NAME = re.compile(rf"{_IDENTIFIER}/(msg|srv|action)/{_IDENTIFIER}", re.ASCII)
_INCLUDE = re.compile(r"^\s*#.*$", re.MULTILINE)
_PLACEHOLDER = "structure_needs_at_least_one_member"


class Definitions:
    """Definitions by full type name (`geometry_msgs/msg/Twist`), including the types implied by services and actions.

    `add` may be called while other threads decode: they continue with the definitions with which they began.
    """

    def __init__(self) -> None:
        self._lock = threading.RLock()
        self._set = _DefinitionSet(_ALWAYS_KNOWN)

    def add(self, texts: Mapping[str, DefinitionText]) -> None:
        """Add definitions as the robot has them. A definition that differs from the known one replaces it everywhere.

        Nothing is parsed yet. Raises `UnknownInterface` for a name that no interface can have.
        """
        with self._lock:
            new = {name: text for name, text in texts.items() if self._set.texts.get(name) != text}
            if new:
                self._set = self._set.with_texts(new)

    def add_plain(self, structures: Sequence[Structure]) -> None:
        """Add structures of messages that are not CDR, under names that no definition may have.

        They replace earlier ones.
        """
        with self._lock:
            plain = {**self._set.plain, **{structure.type: structure for structure in structures}}
            self._set = self._set.with_plain(plain)

    def refuse(self, type_name: str, error: UnknownInterface) -> None:
        """Note why a type has no definition: `structure` then raises this error for the type."""
        with self._lock:
            self._set.refused[type_name] = error

    def knows(self, type_name: str) -> bool:
        """Return whether there is a definition, also of derived types such as `std_srvs/srv/SetBool_Request`."""
        current = self._set
        return type_name in current.texts or type_name in current.owners or type_name in current.plain

    def is_cdr(self, type_name: str) -> bool:
        """Return whether its messages are CDR: their bytes can be read without decoding."""
        return type_name not in self._set.plain and type_name not in self._set.refused

    def unknown_in(self, type_name: str) -> list[str]:
        """Return the names of interfaces without a definition to which a known type refers.

        Raises:
            UnknownInterface: if a definition cannot be read.
        """
        found: dict[str, None] = {}
        seen: set[str] = set()

        def look(name: str) -> None:
            if name in seen:
                return
            seen.add(name)
            if not self.knows(name):
                found[defining_type(name)] = None
                return
            for field in self.structure(name).fields:
                if field.type.is_message:
                    look(field.type.base)

        look(type_name)
        return list(found)

    def structure(self, type_name: str) -> Structure:
        """Return the fields and constants of a message, or of one side of a service or an action.

        Raises:
            UnknownInterface: if there is no definition, or it cannot be read.
        """
        current = self._set
        found = current.structures.get(type_name)
        if found is not None:
            return found
        with self._lock:
            return current.load(type_name)

    def interface(self, type_name: str) -> Interface:
        """Return the whole definition, for display: all sides and all nested types."""
        kind = _kind_of(type_name) if type_name in self._set.texts else "msg"
        sides = {side: self.structure(type_name + ending) for side, ending in _SIDES[kind].items()}
        nested: dict[str, Structure] = {}
        with self._lock:
            for side in sides.values():
                reachable = self._set.reachable(side.type)
                nested |= {name: structure for name, structure in reachable.items() if name != side.type}
        return Interface(type_name, kind, sides, nested)

    def hash(self, type_name: str) -> str:
        """Return the type's hash as sent by ROS 2 (`RIHS01_…`); empty if it cannot be computed."""
        with self._lock:
            every = self._set.reachable(type_name)
        if any(field.type.base == "wstring" for structure in every.values() for field in structure.fields):
            return ""
        return type_hash(type_name, every)

    def starts_with_header(self, type_name: str) -> bool:
        """Return whether the first field is a std_msgs/msg/Header, so that the message begins with a stamp."""
        if not self.is_cdr(type_name):
            return False
        fields = self.structure(type_name).fields
        return bool(fields) and fields[0].type == FieldType(HEADER)

    def compiled(self, type_name: str) -> MessageStore:
        """Return a store that can read and write the type."""
        current = self._set
        if type_name not in current.compiled:
            with self._lock:
                current.compile(type_name)
        return current.store

    def message_class(self, type_name: str) -> type:
        """Return the class of the type's objects; its constructor takes one value for each field, in order."""
        return cast("type", self.compiled(type_name).types[type_name])


class _DefinitionSet:
    """A consistent set of definition texts, with the structures parsed and the types compiled from them so far."""

    def __init__(
        self, texts: Mapping[str, DefinitionText], plain: Mapping[str, Structure] = MappingProxyType({})
    ) -> None:
        self.texts = dict(texts)
        self.owners = {made: name for name in texts for made in _types_of(name)}
        self.plain = dict(plain)
        self.refused: dict[str, UnknownInterface] = {}
        self.structures: dict[str, Structure] = dict(plain)
        self.compiled: set[str] = set()
        self.store = MessageStore()

    def with_plain(self, plain: Mapping[str, Structure]) -> _DefinitionSet:
        """Return a set with these structures of messages that are not CDR; structures from texts are kept."""
        result = _DefinitionSet(self.texts, plain)
        result.structures = {**self.structures, **plain}
        result.compiled, result.store, result.refused = self.compiled, self.store, self.refused
        return result

    def with_texts(self, new: Mapping[str, DefinitionText]) -> _DefinitionSet:
        """Return a set with these texts added. Parsed structures are kept unless a known text changes."""
        result = _DefinitionSet({**self.texts, **new}, self.plain)
        result.refused = {name: error for name, error in self.refused.items() if name not in result.owners}
        if not any(name in self.texts for name in new):
            result.structures, result.compiled, result.store = self.structures, self.compiled, self.store
        return result

    def load(self, type_name: str) -> Structure:
        if type_name in self.plain:
            return self.plain[type_name]
        owner = self.owners.get(type_name)
        if owner is None and (refused := self.refused.get(type_name)):
            raise UnknownInterface(refused.message, refused.hint)
        if owner is None:
            raise UnknownInterface(
                f"No definition of {named(type_name)} is known.", did_you_mean(type_name, list(self.texts))
            )
        if type_name not in self.structures:
            self.structures.update(_structures_of(owner, self.texts[owner]))
        return self.structures[type_name]

    def compile(self, type_name: str) -> None:
        structures = self.reachable(type_name).values()
        try:
            self.store.add(structures)
            self.store.get_msgdef(type_name)
        except (TypesysError, SyntaxError) as error:
            raise UnknownInterface(f"The definition of {type_name} is not valid: {quoted(str(error))}") from error
        self.compiled.add(type_name)

    def reachable(self, type_name: str) -> dict[str, Structure]:
        """Return the structures of the type and of all types that it contains, by name, in order of first use."""
        found: dict[str, Structure] = {}

        def collect(name: str, inside: tuple[str, ...]) -> None:
            if name in inside:
                raise UnknownInterface(f"The definition of {name} contains itself.")
            if name in found:
                return
            found[name] = self.load(name)
            for field in found[name].fields:
                if field.type.is_message:
                    collect(field.type.base, (*inside, name))

        collect(type_name, ())
        return found


# ── from the texts to structures, with the types that services and actions imply ──────────────────────────────────


def _kind_of(type_name: str) -> str:
    """Return the kind of an interface: `msg`, `srv` or `action`.

    Raises:
        UnknownInterface: if it is not the full name of an interface.
    """
    match = _TYPE_NAME.fullmatch(type_name)
    if match is None:
        raise UnknownInterface(f"{quoted(type_name)} is not the full name of a type.", "Write it as package/msg/Name.")
    return match[1]


def _types_of(name: str) -> list[str]:
    """Return the names of all types with fields that the interface `name` defines."""
    kind = _kind_of(name)
    return [name + ending for ending in (*_SIDES[kind].values(), *_IMPLIED[kind])]


def _structures_of(name: str, source: DefinitionText) -> dict[str, Structure]:
    """Parse every structure that the interface `name` defines; return them by full type name.

    Raises:
        UnknownInterface: if the text cannot be read.
    """
    kind = _kind_of(name)
    types = [name + ending for ending in _SIDES[kind].values()]
    if source.format == "idl":
        found = _read_idl(name, source.text)
        missing = [side for side in types if side not in found]
        if missing:
            raise UnknownInterface(f"The IDL text of {name} does not define {missing[0]}.")
    else:
        parts = split_sections(source.text)
        if len(parts) != len(types):
            raise UnknownInterface(f"The definition of {name} has {len(parts)} parts; a {kind} has {len(types)}.")
        found = {side: read_structure(side, part) for side, part in zip(types, parts, strict=True)}
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
        raise UnknownInterface(f"The IDL text of {name} cannot be read: {quoted(str(error))}") from error


def _idl_type(field: str, node: Any) -> FieldType:
    """Convert a node of rosbags' parse tree, (kind, (name, bound)) or (kind, (element, size)), to a type."""
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
