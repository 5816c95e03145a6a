"""Definitions of types that are not installed where the bridge runs, as the nodes that use them tell them.

Since Jazzy each node describes the messages of its topics (`~/get_type_description`, REP 2016), for whoever knows the
hash of the type, which discovery tells. A service is described only by the topic of its events, where its node has
service introspection on: discovery tells the hash of its request, and the node asks for that of the whole.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any, Protocol

from ros2_mcp.model import names
from ros2_mcp.model.errors import RobotError
from ros2_mcp.model.interfaces import DefinitionText

if TYPE_CHECKING:
    from ros2_mcp.robot.graph import Graph

_SERVICE = "type_description_interfaces/srv/GetTypeDescription"
_ANSWER_S = 2.0
"""A node that spins answers within milliseconds, over a wireless network as well."""
_APPEAR_S = 1.0
"""For a service of a node that has only just come up."""
_ASKED_NODES = 3
"""All that use a type describe it alike: others are asked only because one may hang, or be told not to describe."""

_BASES: Mapping[int, str] = {
    2: "int8", 3: "uint8", 4: "int16", 5: "uint16", 6: "int32", 7: "uint32", 8: "int64", 9: "uint64", 10: "float32",
    11: "float64", 13: "char", 15: "bool", 16: "byte", 17: "string", 18: "wstring", 21: "string<={}", 22: "wstring<={}",
}  # fmt: skip
"""`type_description_interfaces/msg/FieldType`: what its numbers mean. Those of arrays, and of bounded and unbounded
sequences, are greater by 48, 96 and 144; the others are of IDL, which messages do not have."""
_NESTED, _STEP = 1, 48
_ARITIES = ("", "[{}]", "[<={}]", "[]")
_FILLER = "structure_needs_at_least_one_member"
"""The field that the generator gives to messages without any."""


class _Values(Protocol):
    """What it needs of `Values`, which imports this module."""

    async def encode(self, type_name: str, value: object) -> bytes: ...

    async def in_full(self, type_name: str, body: bytes) -> dict[str, Any]: ...


async def described(graph: Graph, values: _Values, type_name: str) -> dict[str, DefinitionText]:
    """The definition of a type with all that it contains, from a node that uses it; empty where none tells it.

    Of a `msg` its own text, with constants, defaults and comments, where the node was built with it.
    """
    wanted = type_name if "/msg/" in type_name else f"{type_name}_Event"
    asked: set[str] = set()
    for topic in [row.name for row in await graph.topics() if wanted in row.types]:
        present = await graph.endpoints(topic)
        for user in (*present.publishers, *present.subscribers):
            is_asked = user.type == wanted and user.hash and user.node.startswith("/") and not user.ours
            if not is_asked or user.node in asked or len(asked) >= _ASKED_NODES:
                continue
            asked.add(user.node)
            if found := await _ask(graph, values, user.node, wanted, user.hash):
                return found
    return {}


async def _ask(graph: Graph, values: _Values, node: str, type_name: str, type_hash: str) -> dict[str, DefinitionText]:
    asked = {"type_name": type_name, "type_hash": type_hash, "include_type_sources": True}
    try:
        reply = await graph.ask(
            "call",
            await values.encode(f"{_SERVICE}_Request", asked),
            service=f"{node}/get_type_description",
            type=_SERVICE,
            wait_s=_APPEAR_S,
            timeout_s=_ANSWER_S,
            within_s=_APPEAR_S + _ANSWER_S,
        )
        told = await values.in_full(f"{_SERVICE}_Response", reply.body)
    except RobotError:  # it offers none, as before Jazzy, or it hangs
        return {}
    if not told["successful"]:
        return {}
    sources = {
        source["type_name"]: DefinitionText("msg", source["raw_file_contents"])
        for source in told["type_sources"]
        if source["encoding"] == "msg" and source["raw_file_contents"]
    }
    whole = told["type_description"]
    parts = [whole["type_description"], *whole["referenced_type_descriptions"]]
    return {**definitions_of(parts), **sources}


def definitions_of(descriptions: Sequence[Mapping[str, Any]]) -> dict[str, DefinitionText]:
    """Definitions with the fields of `IndividualTypeDescription`s; of a service whose request and response are among
    them, one of the service. A type with a field that no message has is left out.
    """
    texts: dict[str, str] = {}
    for one in descriptions:
        lines = [f"{_type_of(field['type'])} {field['name']}" for field in one["fields"] if field["name"] != _FILLER]
        if all(not line.startswith(" ") for line in lines):
            texts[one["type_name"]] = "".join(f"{line}\n" for line in lines)
    found = {name: DefinitionText("msg", text) for name, text in texts.items() if not names.is_derived(name)}
    for service in {names.defining_type(name) for name in texts if "/srv/" in name}:
        sides = [texts.get(f"{service}_{side}") for side in ("Request", "Response")]
        if None not in sides:
            found[service] = DefinitionText("srv", f"{sides[0]}---\n{sides[1]}")
    return found


def _type_of(told: Mapping[str, Any]) -> str:
    """A type as a definition writes it; empty for what no message has."""
    number = int(told["type_id"])
    if not 0 < number <= len(_ARITIES) * _STEP:
        return ""
    arity, kind = divmod(number - 1, _STEP)
    base = told["nested_type_name"] if kind + 1 == _NESTED else _BASES.get(kind + 1, "")
    if not base:
        return ""
    return base.format(told["string_capacity"]) + _ARITIES[arity].format(told["capacity"])
