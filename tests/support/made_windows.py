"""Signals made for the purpose, as windows of real CDR."""

from __future__ import annotations

from collections.abc import AsyncGenerator, Callable, Mapping, Sequence
from contextlib import asynccontextmanager
from dataclasses import dataclass
from typing import Any

from rosbags.typesys import Stores, get_typestore

from ros2_mcp.model.errors import NotFound
from ros2_mcp.model.qos import Endpoint, QoS
from ros2_mcp.model.samples import Sample
from ros2_mcp.ops.sources.source import Capture, GraphSnapshot, K, Keep, Source, Stream, in_batches
from ros2_mcp.values.cdr import Codec
from ros2_mcp.values.check import check
from ros2_mcp.values.definitions import Definitions, DefinitionText
from support.processes import SOURCES

START_NS = 1_700_000_000_000_000_000
_COSTMAPS = ("CostmapMetaData", "Costmap", "CostmapUpdate")
NODE = Endpoint("/node", "", "", "", QoS())


def _definitions() -> Definitions:
    store = get_typestore(Stores.ROS2_JAZZY)
    names = [name for name in store.fielddefs if "/msg/" in name]
    result = Definitions()
    result.add({name: DefinitionText("msg", store.gendefhash(name, {}, ros_version=2)[0]) for name in names})
    angles = "float64 roll\nfloat64 torque_rad\nfloat64 yaw_rad\nfloat64 yaw_deg\n"
    result.add({"odd_msgs/msg/Angles": DefinitionText("msg", angles)})
    result.add({"odd_msgs/msg/State": DefinitionText("msg", "uint8 IDLE=0\nuint8 BUSY=3\nuint8 state\nbool on\n")})
    for package, name in (("map_msgs", "OccupancyGridUpdate"), *(("nav2_msgs", one) for one in _COSTMAPS)):
        text = (SOURCES / "ros2_mcp_demo" / "interfaces" / package / "msg" / f"{name}.msg").read_text()
        result.add({f"{package}/msg/{name}": DefinitionText("msg", text)})
    return result


CODEC = Codec(_definitions())


@dataclass(frozen=True, kw_only=True)
class Window:
    """All samples of one topic between two times."""

    topic: str
    type: str
    codec: Codec
    samples: Sequence[Sample]
    start_ns: int
    end_ns: int
    publishers: Sequence[str] = ()
    holes: Sequence[tuple[int, int]] = ()

    @property
    def duration_s(self) -> float:
        return (self.end_ns - self.start_ns) / 1e9

    def stream(self) -> Stream:
        """As it is followed."""
        stream = Stream(
            topic=self.topic,
            type=self.type,
            codec=self.codec,
            publishers=[NODE],
            start_ns=self.start_ns,
            until_ns=self.end_ns,
            received=len(self.samples),
        )
        stream.batches = in_batches(self.samples)
        return stream

    def captured(self, keep: Keep[K]) -> Capture[K]:
        """What is kept of it."""
        kept = keep(self.stream())
        kept.add(self.samples)
        return Capture(
            topic=self.topic,
            type=self.type,
            codec=self.codec,
            kept=kept,
            start_ns=self.start_ns,
            end_ns=self.end_ns,
            received=len(self.samples),
            publishers=self.publishers,
            source="made",
            holes=self.holes,
        )


Make = Callable[..., Window]


def encoded(type_name: str, value: Mapping[str, Any]) -> bytes:
    return CODEC.encode(type_name, check(CODEC.definitions, type_name, value))


def decoded(type_name: str, value: Mapping[str, Any]) -> object:
    return CODEC.decode(type_name, encoded(type_name, value))


class Recorded(Source):
    """A source that is no robot and no bag: what tests add is all that there is to a kind of source."""

    title = words = "made"
    duration_s = 1.0

    def __init__(self, captures: Sequence[Window], graph: GraphSnapshot | None = None) -> None:
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
        yield self._capture(topic).stream()

    async def graph(self) -> GraphSnapshot:
        return self._graph

    def _capture(self, topic: str) -> Window:
        if topic not in self._captures:
            raise NotFound(f"There is no topic {topic}.")
        return self._captures[topic]
