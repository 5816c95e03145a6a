"""Signals made for the purpose, as windows of real CDR."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from contextlib import asynccontextmanager
from typing import Any

from rosbags.typesys import Stores, get_typestore

from ros2_mcp.codec.cdr import Codec
from ros2_mcp.codec.check import check
from ros2_mcp.codec.definitions import Definitions, DefinitionText
from ros2_mcp.model.errors import NotFound
from ros2_mcp.model.qos import Endpoint, QoS
from ros2_mcp.model.samples import Counts
from ros2_mcp.ops.window import Missing, Scene, Stream, Window

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


Make = Callable[..., Window]


def encoded(type_name: str, value: Mapping[str, Any]) -> bytes:
    return CODEC.encode(type_name, check(CODEC.definitions, type_name, value))


def decoded(type_name: str, value: Mapping[str, Any]) -> object:
    return CODEC.decode(type_name, encoded(type_name, value))


class Recorded:
    """A source that is no robot: the seam that a bag will use."""

    words = "recorded"
    codec = CODEC

    def __init__(self, windows: Sequence[Window], scene: Scene | None = None) -> None:
        self._windows = {window.topic: window for window in windows}
        self._scene = scene or Scene({}, None, None)
        self.duration_s = windows[0].duration_s if windows else 1.0

    async def type_of(self, topic: str) -> str:
        if topic not in self._windows:
            raise NotFound(f"There is no topic {topic}.")
        return self._windows[topic].type

    async def windows(self, topics: Sequence[str], report: Any, **_: bool) -> list[Window | Missing]:  # noqa: ARG002
        return [self._windows.get(topic) or Missing(topic, NotFound(f"no {topic}")) for topic in topics]

    @asynccontextmanager
    async def follow(self, topic: str, type_name: str = "", *, most: int | None = None):  # noqa: ARG002
        window = self._windows[topic]

        async def batches():
            yield window.samples

        async def why_no_more(_last: object) -> str:
            return ""

        counts = Counts(len(window.samples))
        yield Stream(
            topic,
            window.type,
            CODEC,
            [NODE],
            batches(),
            lambda: counts,
            why_no_more,
            lambda: window.duration_s,
            end_ns=lambda: window.end_ns,
        )

    async def scene(self) -> Scene:
        return self._scene
