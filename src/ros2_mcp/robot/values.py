"""Values of the robot's own types: definitions fetched once, bytes to JSON and back.

The codec is imported inside the methods: with NumPy and rosbags it takes 0.3 to 0.9 s, and the server answers
tools/list before that.
"""

from __future__ import annotations

import asyncio
import math
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from ros2_mcp.model import names
from ros2_mcp.model.errors import BadValue, UnknownInterface
from ros2_mcp.model.samples import Sample
from ros2_mcp_bridge.protocol import DefinitionsReply
from ros2_mcp_bridge.velocity import VELOCITY_TYPES

if TYPE_CHECKING:
    from ros2_mcp.codec.cdr import Codec, Message
    from ros2_mcp.codec.definitions import Definitions
    from ros2_mcp.codec.render import Rendered, RenderOptions
    from ros2_mcp.robot.graph import Graph


class Values:
    """The types that have been learnt from the robot, and their values."""

    def __init__(self, graph: Graph) -> None:
        self._graph = graph
        self._codec: Codec | None = None
        self._loading = asyncio.Lock()

    @property
    def codec(self) -> Codec:
        """Bytes to values and back, loaded at first use."""
        if self._codec is None:
            from ros2_mcp.codec.cdr import Codec
            from ros2_mcp.codec.definitions import Definitions

            self._codec = Codec(Definitions())
        return self._codec

    @property
    def definitions(self) -> Definitions:
        """The definitions known so far."""
        return self.codec.definitions

    async def learn(self, *types: str) -> None:
        """Fetches the definitions of these types, with all they refer to, from the robot.

        Raises:
            UnknownInterface: if the robot's installation has no definition of one.
        """
        if all(self.definitions.knows(name) for name in types):
            return  # without waiting for others that are being fetched: what stops uses types that are known
        async with self._loading:
            unknown = sorted({names.defining_type(name) for name in types if not self.definitions.knows(name)})
            if not unknown:
                return
            answer = await self._graph.query(DefinitionsReply, "definitions", types=unknown)
            if answer["missing"]:
                raise UnknownInterface(
                    f"No definition of {', '.join(answer['missing'])} is installed where the bridge runs.",
                    await self._suggest_type(answer["missing"][0]),
                )
            from ros2_mcp.codec.definitions import DefinitionText

            self.definitions.add(
                {name: DefinitionText(text["format"], text["text"]) for name, text in answer["definitions"].items()}
            )

    async def _suggest_type(self, name: str) -> str:
        installed = await self._graph.interfaces()
        package = name.partition("/")[0]
        if not any(other.startswith(package + "/") for other in installed):
            return f"The package {package} is not there: source its workspace (--workspace DIR) or install it."
        return names.did_you_mean(name, installed, "ros2_interface_list shows what is there.")

    def decode(self, type_name: str, sample: Sample) -> Message:
        """The values of a sample whose type has been learnt."""
        return self.codec.decode(type_name, sample.data)

    async def encode(self, type_name: str, value: object) -> bytes:
        """The bytes of a JSON value, strictly checked.

        Raises:
            BadValue: naming the path of what does not fit.
        """
        await self.learn(type_name)
        return self.encode_known(type_name, value)

    def encode_known(self, type_name: str, value: object) -> bytes:
        """The same, for a type that has been learnt."""
        from ros2_mcp.codec.check import check

        message = check(self.definitions, type_name, value)
        if type_name in VELOCITY_TYPES:
            self._require_finite(type_name, message, "")
        return self.codec.encode(type_name, message)

    def _require_finite(self, type_name: str, message: object, path: str) -> None:
        """Raises `BadValue` for a number in a message with which nothing can be driven; such types have no lists."""
        for each in self.definitions.structure(type_name).fields:
            below, value = f"{path}{each.name}", getattr(message, each.name)
            if each.type.is_message:
                self._require_finite(each.type.base, value, f"{below}.")
            elif isinstance(value, float) and not math.isfinite(value):
                raise BadValue(below, f"{value} is no finite number: nothing can be driven with it.", "Give a number.")

    def render(self, type_name: str, body: bytes, options: RenderOptions | None = None) -> Rendered:
        """Bytes as bounded JSON values."""
        from ros2_mcp.codec.render import RenderOptions, render

        return render(
            self.definitions, type_name, self.codec.decode(type_name, body), options=options or RenderOptions()
        )

    def in_full(self, type_name: str, body: bytes) -> dict[str, Any]:
        """Bytes as JSON values with nothing left out, for this program and not for display."""
        from ros2_mcp.codec.render import RenderOptions

        return self.render(type_name, body, RenderOptions(exact=True)).value

    def example(self, type_name: str) -> dict[str, Any]:
        """A value of a learnt type with every field at its default, ready to fill in."""
        from ros2_mcp.codec.render import example_of

        return example_of(self.definitions, type_name)

    def missing_fields(self, type_name: str, value: Mapping[str, Any]) -> list[str]:
        """Top-level fields of a learnt type that the value does not give."""
        from ros2_mcp.codec.check import missing_fields

        return missing_fields(self.definitions, type_name, value)

    def field_types(self, type_name: str) -> dict[str, Any]:
        """Name → type of the top-level fields of a learnt message type."""
        return {field.name: str(field.type) for field in self.definitions.structure(type_name).fields}
