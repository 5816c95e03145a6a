"""The markers of all topics with their poses: live the markers received since the page shows them, else since the
start.
"""

from __future__ import annotations

import asyncio
import hashlib
import json
import zlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from time import monotonic
from typing import Any, cast

import anyio

from ros2_mcp.model.aside import aside
from ros2_mcp.model.errors import RobotError
from ros2_mcp.model.poses import Pose
from ros2_mcp.model.text import counted, named
from ros2_mcp.ops.sources.from_before import FromBefore
from ros2_mcp.robot import Robot
from ros2_mcp.view.look import Chunks, Look
from ros2_mcp.view.markers import MARKER, MARKER_ARRAY, Marker, MarkersOfTopic
from ros2_mcp.world.transforms import FrameTree

_MOST_TOPICS = 8
_MOST_SHOWN = 2000
_MOST_BYTES = 1_500_000
"""Bytes of the points of all markers, in base64: some 90,000 points."""
_IDLE_S = 5.0
"""Seconds without a look, after which the subscription ends; the next look begins anew."""
_TURN_S = 1.0
_AGAIN_S = 2.0
_MOST_READ = 5000
"""Messages of a recording that are read in one look."""
_DIGITS = 4


@dataclass(eq=False)
class _Followed:
    """One topic. `read_ns` is the part of a recording that has been read; `old_ns` is when the last message was sent,
    if it is from before the subscription.
    """

    kind: str
    markers: MarkersOfTopic
    looked_at: float = 0.0
    is_followed: bool = False
    error: str = ""
    read_ns: tuple[int, int] = (0, 0)
    old_ns: int | None = None
    version: int = 0
    placed: dict[int, tuple[Marker, str, Pose]] = field(default_factory=dict[int, tuple[Marker, str, Pose]])

    def forget(self) -> None:
        """Forget all markers."""
        self.markers, self.read_ns, self.old_ns = MarkersOfTopic(self.markers.topic), (0, 0), None
        self.placed.clear()


class MarkerTopics:
    """Subscribes to each topic of markers as long as `shown` is called."""

    def __init__(self, chunks: Chunks) -> None:
        self._chunks = chunks
        self._topics: dict[str, _Followed] = {}
        self._wanted = asyncio.Event()
        self._packed: tuple[object, str, Sequence[object]] = (None, "", ())
        """Identity of the packed markers, the key, and the bodies; the bodies are kept so that their ids stay
        unique."""

    async def run(self, robot: Robot) -> None:
        """Subscribe to the topics that a page shows, until cancelled."""
        async with anyio.create_task_group() as tasks:
            while True:
                await self._wanted.wait()
                self._wanted.clear()
                for topic in self._topics.values():
                    if not topic.is_followed and monotonic() - topic.looked_at < _IDLE_S:
                        topic.is_followed = True
                        tasks.start_soon(self._follow, robot, topic)

    async def _follow(self, robot: Robot, topic: _Followed) -> None:
        topic.forget()
        name = topic.markers.topic
        try:
            async with robot.listen(name, topic.kind) as listening:
                await robot.values.learn(topic.kind)
                topic.error = ""
                while monotonic() - topic.looked_at < _IDLE_S:
                    for sample in await listening.take(_TURN_S):
                        try:
                            message = await aside(sample.size, robot.values.codec.decode, topic.kind, sample.data)
                            await aside(sample.size, topic.markers.take, message, sample.received_ns)
                            topic.old_ns = sample.source_ns if listening.is_from_before(sample) else None
                        except RobotError as error:
                            topic.error = f"A message on {named(name)} is not shown: {error.message}"
                        await asyncio.sleep(0)
        except RobotError as error:
            topic.error = f"{named(name)} is not shown: {error.message}"
            await asyncio.sleep(_AGAIN_S)
        finally:
            topic.is_followed = False
            topic.forget()

    async def shown(
        self, look: Look, tree: FrameTree, frame: str, meshes: Mapping[str, Any], missing: list[str]
    ) -> Mapping[str, Any] | None:
        """Return the `key` of the bodies of `count` markers, and the pose of each in `frame`; None without markers."""
        topics = await self._looked_at(look, missing)
        now_ns, rows = look.now_ns, list[tuple[Marker, Pose]]()
        for topic in topics:
            if topic.error:
                missing.append(topic.error)
            missing += topic.markers.problems()
            unplaced: dict[str, int] = {}
            for marker in topic.markers.shown(now_ns):
                if pose := _pose(topic, marker, tree, frame):
                    rows.append((marker, pose))
                else:
                    unplaced[marker.frame] = unplaced.get(marker.frame, 0) + 1
            for of_frame, count in list(unplaced.items())[:2]:
                why = f"no transform leads from {named(of_frame)} to {named(frame)}."
                missing.append(f"{named(topic.markers.topic)}: {counted(count, 'marker')} not drawn: {why}")
        received = [topic.markers.received_ns for topic in topics if topic.markers.received_ns]
        if not rows:
            return None
        rows = self._within_bounds(rows, missing)
        key = await self._key([marker for marker, _ in rows], meshes, missing)
        poses = [[round(value, _DIGITS) for value in (*pose.translation, *pose.rotation)] for _, pose in rows]
        return {"key": key, "count": len(rows), "poses": poses, "at_s": max(received) / 1e9}

    def old(self, now_ns: int) -> list[str]:
        """Return the topics whose last markers were sent before the subscription, each with their age."""
        topics = [topic for topic in self._topics.values() if topic.is_followed and topic.old_ns is not None]
        return [f"{named(topic.markers.topic)} {FromBefore.of(1, topic.old_ns or 0, now_ns).age}" for topic in topics]

    async def _looked_at(self, look: Look, missing: list[str]) -> Sequence[_Followed]:
        found: list[_Followed] = []
        for kind in (MARKER, MARKER_ARRAY):
            for name in await look.source.publishing(kind):
                topic = self._topics.get(name)
                if topic is None or topic.kind != kind:
                    topic = self._topics[name] = _Followed(kind, MarkersOfTopic(name))
                found.append(topic)
        for topic in found[_MOST_TOPICS:]:
            missing.append(f"{named(topic.markers.topic)} is not shown: the limit is {_MOST_TOPICS} marker topics.")
        for topic in found[:_MOST_TOPICS]:
            topic.looked_at = monotonic()
            if not look.source.is_live:
                await _read(look, topic)
        self._wanted.set()
        return found[:_MOST_TOPICS]

    def _within_bounds(self, rows: list[tuple[Marker, Pose]], missing: list[str]) -> list[tuple[Marker, Pose]]:
        kept: list[tuple[Marker, Pose]] = []
        left = _MOST_BYTES
        for marker, pose in rows:
            left -= len(marker.body.get("points", ""))
            if left < 0 or len(kept) >= _MOST_SHOWN:
                missing.append(f"{len(rows) - len(kept)} markers are not drawn: there are too many.")
                break
            kept.append((marker, pose))
        return kept

    async def _key(self, markers: Sequence[Marker], meshes: Mapping[str, Any], missing: list[str]) -> str:
        bodies = [marker.body for marker in markers]
        unknown = sorted(
            {body["mesh"] for body in bodies if "mesh" in body and not isinstance(meshes.get(body["mesh"]), Mapping)}
        )
        for name in unknown[:2]:
            why = meshes.get(name) or "only meshes that the robot's description names are read."
            missing.append(f"A marker's mesh {named(name)} is not drawn: {why}")
        of = (tuple(map(id, bodies)), tuple(meshes))
        if self._packed[0] != of or self._chunks.find(self._packed[1]) is None:
            told = [{**body, "mesh": _facts(meshes, body["mesh"])} if "mesh" in body else body for body in bodies]
            data = await asyncio.to_thread(_compressed, told)
            key = hashlib.sha256(data).hexdigest()[:32]
            self._chunks.keep(key, data, "markers")
            self._packed = of, key, bodies
        return self._packed[1]


def _facts(meshes: Mapping[str, Any], name: str) -> Mapping[str, Any] | None:
    """Return what the page needs to draw a mesh, if the mesh may be drawn."""
    found = meshes.get(name)
    return cast("Mapping[str, Any]", found) if isinstance(found, Mapping) else None


def _compressed(bodies: Sequence[Mapping[str, Any]]) -> bytes:
    return zlib.compress(json.dumps(bodies).encode(), 1)


def _pose(topic: _Followed, marker: Marker, tree: FrameTree, frame: str) -> Pose | None:
    """Return the marker's pose in `frame`.

    A marker with `frame_locked` follows its own frame; any other one stays where it was put.
    """
    known = topic.placed.get(id(marker))
    if known and known[0] is marker and known[1] == frame:
        return known[2]
    if marker.frame == frame or not marker.frame:
        return marker.pose
    located = (tree.find(frame, marker.frame, marker.stamp_ns) if marker.stamp_ns else None) or tree.newest(
        frame, marker.frame
    )
    if located is None:
        return None
    pose = located.pose @ marker.pose
    if marker.stamp_ns:
        if len(topic.placed) > 2 * _MOST_SHOWN:
            topic.placed.clear()
        topic.placed[id(marker)] = marker, frame, pose
    return pose


async def _read(look: Look, topic: _Followed) -> None:
    """Read a recording up to the time that is shown: from where reading stopped, or anew after a step back."""
    begin_ns, end_ns = look.source.covers_ns or (0, 0)
    if topic.read_ns[0] != begin_ns or topic.read_ns[1] > end_ns:
        topic.forget()
        topic.read_ns = begin_ns, begin_ns
    if topic.read_ns[1] == end_ns:
        return
    read_from, topic.read_ns = topic.read_ns[1], (0, 0)  # after a cancellation, reading begins anew
    name = topic.markers.topic
    topic.error = ""
    async with look.source.part(read_from, end_ns).follow(
        name, limit=_MOST_READ, latched=read_from == begin_ns
    ) as stream:
        async for batch in stream.batches:
            for sample in batch:
                try:
                    message = await aside(sample.size, stream.codec.decode, stream.type, sample.data)
                    await aside(sample.size, topic.markers.take, message, sample.received_ns)
                except RobotError as error:
                    topic.error = f"A message on {named(name)} is not shown: {error.message}"
            await asyncio.sleep(0)
    topic.read_ns = begin_ns, end_ns
