"""Definitions of types that are not installed where the bridge runs, from the nodes that use them.

Since Jazzy each node describes the messages of its topics (`~/get_type_description`, REP 2016) to clients that know the
hash of the type, which discovery provides. For a service discovery provides only the hash of the request, while the
node requires the hash of the service. A service is therefore described only through the topic of its events, if its
node has service introspection on.
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
"""The time limit for an answer, in s: a node that spins answers within milliseconds, also over a wireless network."""
_APPEAR_S = 1.0
"""The time limit for the service of a node that has just started to appear, in s."""
_ASKED_NODES = 3
"""The most nodes that are asked. All nodes with a type describe it alike; a second one is asked only because the first
may hang, or be configured not to describe."""

_BASES: Mapping[int, str] = {
    2: "int8", 3: "uint8", 4: "int16", 5: "uint16", 6: "int32", 7: "uint32", 8: "int64", 9: "uint64", 10: "float32",
    11: "float64", 13: "char", 15: "bool", 16: "byte", 17: "string", 18: "wstring", 21: "string<={}", 22: "wstring<={}",
}  # fmt: skip
"""Names for the numbers in `type_description_interfaces/msg/FieldType`. Arrays, bounded and unbounded sequences are
greater by 48, 96 and 144. The numbers that are missing here belong to IDL types, which messages do not have."""
_NESTED, _STEP = 1, 48
_ARITIES = ("", "[{}]", "[<={}]", "[]")
_FILLER = "structure_needs_at_least_one_member"
"""The field that the generator adds to empty messages."""


class _Values(Protocol):
    """The methods of `Values` that are used here; `Values` imports this module."""

    async def encode(self, type_name: str, value: object) -> bytes: ...

    async def in_full(self, type_name: str, body: bytes) -> dict[str, Any]: ...


async def described(graph: Graph, values: _Values, type_name: str) -> dict[str, DefinitionText]:
    """Return the definition of a type and all types in it, from a node that uses it; empty if no node provides it.

    For a `msg` the text is the original, with constants, defaults and comments, if the node was built with it.
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
    except RobotError:  # the node has no such service, as before Jazzy, or hangs
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
    """Convert `IndividualTypeDescription`s to definitions.

    A service whose request and response are among them gets one definition. A type with a field type that messages do
    not have is omitted.
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
    """Return a field type as definitions spell it; "" for a type that messages do not have."""
    number = int(told["type_id"])
    if not 0 < number <= len(_ARITIES) * _STEP:
        return ""
    arity, kind = divmod(number - 1, _STEP)
    base = told["nested_type_name"] if kind + 1 == _NESTED else _BASES.get(kind + 1, "")
    if not base:
        return ""
    return base.format(told["string_capacity"]) + _ARITIES[arity].format(told["capacity"])
