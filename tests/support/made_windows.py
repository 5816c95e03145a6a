"""Signals made for the purpose, as windows of real CDR."""

from __future__ import annotations

from collections.abc import AsyncGenerator, Callable, Mapping, Sequence
from contextlib import asynccontextmanager
from typing import Any

from rosbags.typesys import Stores, get_typestore

from ros2_mcp.codec.cdr import Codec
from ros2_mcp.codec.check import check
from ros2_mcp.codec.definitions import Definitions, DefinitionText
from ros2_mcp.model.errors import NotFound
from ros2_mcp.model.qos import Endpoint, QoS
from ros2_mcp.ops.sources.source import Capture, GraphSnapshot, Missing, Source, Stream, in_batches

START_NS = 1_700_000_000_000_000_000
NODE = Endpoint("/node", "", "", "", QoS())


def _definitions() -> Definitions:
    store = get_typestore(Stores.ROS2_JAZZY)
    names = [name for name in store.fielddefs if "/msg/" in name]
    result = Definitions()
    result.add({name: DefinitionText("msg", store.gendefhash(name, {}, ros_version=2)[0]) for name in names})
    result.add({"odd_msgs/msg/State": DefinitionText("msg", "uint8 IDLE=0\nuint8 BUSY=3\nuint8 state\nbool on\n")})
    return result


CODEC = Codec(_definitions())


Make = Callable[..., Capture]


def encoded(type_name: str, value: Mapping[str, Any]) -> bytes:
    return CODEC.encode(type_name, check(CODEC.definitions, type_name, value))


def decoded(type_name: str, value: Mapping[str, Any]) -> object:
    return CODEC.decode(type_name, encoded(type_name, value))


class Recorded(Source):
    """A source that is no robot and no bag: what tests add is all that there is to a kind of source."""

    title = words = "made"
    duration_s = 1.0

    def __init__(self, captures: Sequence[Capture], graph: GraphSnapshot | None = None) -> None:
        self._captures = {capture.topic: capture for capture in captures}
        self._graph = graph or GraphSnapshot({})
        if captures:
            self.duration_s = captures[0].duration_s

    @property
    def codec(self) -> Codec:
        return CODEC

    async def type_of(self, topic: str) -> str:
        return self._capture(topic).type

    @asynccontextmanager
    async def follow(self, topic: str, type_name: str = "", **_: Any) -> AsyncGenerator[Stream, None]:  # noqa: ARG002
        capture = self._capture(topic)
        stream = Stream(
            topic=topic,
            type=capture.type,
            codec=CODEC,
            publishers=[NODE],
            start_ns=capture.start_ns,
            until_ns=capture.end_ns,
            received=len(capture.samples),
        )
        stream.batches = in_batches(capture.samples)
        yield stream

    async def captures(self, topics: Sequence[str], *_: Any, **__: Any) -> list[Capture | Missing]:
        return [self._captures.get(topic) or Missing(topic, NotFound(f"no {topic}")) for topic in topics]

    async def graph(self) -> GraphSnapshot:
        return self._graph

    def _capture(self, topic: str) -> Capture:
        if topic not in self._captures:
            raise NotFound(f"There is no topic {topic}.")
        return self._captures[topic]
