"""Values of the robot's own types: definitions fetched once, conversion between bytes and JSON.

The codec is imported with the first type: with NumPy and rosbags that takes 0.3 to 0.9 s, and the server answers
tools/list before that. Large values are encoded, decoded and rendered in a thread (`aside`).
"""

from __future__ import annotations

import asyncio
import math
from collections.abc import Iterable, Mapping, Sequence
from typing import TYPE_CHECKING, Any

from ros2_mcp.link.interfaces import curing
from ros2_mcp.model import names
from ros2_mcp.model.aside import aside, extent, load
from ros2_mcp.model.errors import BadValue, UnknownInterface
from ros2_mcp.model.samples import Sample
from ros2_mcp.model.text import listed
from ros2_mcp.robot.described import described
from ros2_mcp_common.policy.velocity import MOTION_TYPES
from ros2_mcp_common.wire.protocol import DefinitionsReply

if TYPE_CHECKING:
    from ros2_mcp.robot.graph import Graph
    from ros2_mcp.values.cdr import Codec, Message
    from ros2_mcp.values.definitions import Definitions
    from ros2_mcp.values.render import Rendered, RenderOptions

_MAX_UNKNOWN = 5
"""The most types that a note names; usually all are of one package."""
_CODEC = ("ros2_mcp.values.cdr", "ros2_mcp.values.check", "ros2_mcp.values.render")


class Values:
    """The types that were learnt from the robot, and the conversion of their values."""

    def __init__(self, graph: Graph) -> None:
        self._graph = graph
        self._codec: Codec | None = None
        self._loading = asyncio.Lock()

    @property
    def codec(self) -> Codec:
        """The conversion between bytes and values, loaded at first use."""
        if self._codec is None:
            from ros2_mcp.values.cdr import Codec
            from ros2_mcp.values.definitions import Definitions

            self._codec = Codec(Definitions())
        return self._codec

    @property
    def definitions(self) -> Definitions:
        """The definitions known so far."""
        return self.codec.definitions

    async def learn(self, *types: str) -> None:
        """Fetch the definitions of these types, with all types in them, from the robot.

        A type that is not installed where the bridge runs may be described by a node that uses it (`described.py`).

        Raises:
            UnknownInterface: if neither the robot's installation nor a node provides the definition of a type.
        """
        await load(*_CODEC)
        if all(self.definitions.knows(name) for name in types):
            return  # without waiting for other fetches: a stop uses types that are known
        async with self._loading:
            unknown = sorted({names.defining_type(name) for name in types if not self.definitions.knows(name)})
            if not unknown:
                return
            answer = await self._graph.query(DefinitionsReply, "definitions", types=unknown)
            from ros2_mcp.values.definitions import DefinitionText

            self.definitions.add(
                {name: DefinitionText(text["format"], text["text"]) for name, text in answer["definitions"].items()}
            )
        for name in answer["missing"]:  # without the lock: the nodes' answers have a type that must be learnt itself
            told = await described(self._graph, self, name)
            self.definitions.add({each: text for each, text in told.items() if not self.definitions.knows(each)})
        missing = [name for name in answer["missing"] if not self.definitions.knows(name)]
        if missing:
            raise UnknownInterface(
                f"No definition of {', '.join(missing)} is installed where the bridge runs, and no node provides it.",
                await self._suggest_type(missing[0]),
            )

    async def _suggest_type(self, name: str) -> str:
        installed = await self._graph.interfaces()
        package = name.partition("/")[0]
        if not any(other.startswith(package + "/") for other in installed):
            return curing(package)
        return names.did_you_mean(name, installed, "ros2_interface_list shows what is there.")

    def decode(self, type_name: str, sample: Sample) -> Message:
        """Decode a small sample whose type has been learnt."""
        return self.codec.decode(type_name, sample.data)

    async def decode_all(self, type_name: str, samples: Sequence[Sample]) -> list[Message]:
        """Decode several samples whose type has been learnt."""
        size = sum(len(sample.data) for sample in samples)
        return await aside(size, lambda: [self.decode(type_name, sample) for sample in samples])

    async def encode(self, type_name: str, value: object) -> bytes:
        """Encode a JSON value as bytes, after a strict check.

        Raises:
            BadValue: with the path of the field that does not fit.
        """
        await self.learn(type_name)
        return await aside(extent(value), self.encode_known, type_name, value)

    def encode_known(self, type_name: str, value: object) -> bytes:
        """Encode at once a small value of a type that has been learnt."""
        from ros2_mcp.values.check import check

        message = check(self.definitions, type_name, value)
        if type_name in MOTION_TYPES:
            self._require_finite(type_name, message, "")
        return self.codec.encode(type_name, message)

    def _require_finite(self, type_name: str, message: object, path: str) -> None:
        """Raise `BadValue` for a number in a message that is not finite: it cannot drive anything."""
        for each in self.definitions.structure(type_name).fields:
            value: Any = getattr(message, each.name)
            shown = [(f"{path}{each.name}", value)]
            if each.type.arity != "single":
                shown = [(f"{path}{each.name}[{index}]", entry) for index, entry in enumerate(value)]
            for below, entry in shown:
                if each.type.is_message:
                    self._require_finite(each.type.base, entry, f"{below}.")
                elif isinstance(entry, float) and not math.isfinite(entry):
                    what = f"{entry} is not a finite number: a motion needs finite numbers."
                    raise BadValue(below, what, "Give a number.")

    async def render(self, type_name: str, body: bytes, options: RenderOptions | None = None) -> Rendered:
        """Render bytes as JSON values of bounded size."""
        return await aside(len(body), self._render, type_name, body, options)

    def _render(self, type_name: str, body: bytes, options: RenderOptions | None) -> Rendered:
        from ros2_mcp.values.render import RenderOptions, render

        return render(
            self.definitions, type_name, self.codec.decode(type_name, body), options=options or RenderOptions()
        )

    async def in_full(self, type_name: str, body: bytes) -> dict[str, Any]:
        """Decode bytes to complete JSON values, for this program and not for display."""
        from ros2_mcp.values.render import RenderOptions

        return (await self.render(type_name, body, RenderOptions(exact=True))).value

    def example(self, type_name: str) -> dict[str, Any]:
        """Return a value of a learnt type with every field at its default, for a user to fill in."""
        from ros2_mcp.values.render import example_of

        return example_of(self.definitions, type_name)

    def missing_fields(self, type_name: str, value: Mapping[str, Any]) -> list[str]:
        """Return the top-level fields of a learnt type that the value lacks."""
        from ros2_mcp.values.check import missing_fields

        return missing_fields(self.definitions, type_name, value)

    def field_types(self, type_name: str) -> dict[str, Any]:
        """Return the types of the top-level fields of a learnt message type, by name."""
        return {field.name: str(field.type) for field in self.definitions.structure(type_name).fields}

    async def fields_of(self, types: Iterable[str], part: str = "") -> tuple[dict[str, dict[str, Any]], str]:
        """Return the top-level fields of these types, or of their `part`, such as `_Request`, by type; and a note.

        A type that is not installed where the bridge runs has no fields in the result, and the note says why.
        """
        fields: dict[str, dict[str, Any]] = {}
        unknown: dict[str, str] = {}
        for name in sorted(set(types)):
            try:
                await self.learn(name)
                fields[name] = self.field_types(f"{name}{part}")
            except UnknownInterface as error:
                fields[name], unknown[name] = {}, str(error)
        if not unknown:
            return fields, ""
        first, *others = unknown
        also = f" Also unknown: {listed(others, _MAX_UNKNOWN)}." if others else ""
        return fields, f"Fields are missing: {unknown[first]}{also}"
