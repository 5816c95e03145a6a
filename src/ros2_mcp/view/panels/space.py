"""The surroundings of the robot in 3D: clouds, scans, frames and the robot's shapes, each at its pose."""

from __future__ import annotations

import asyncio
import base64
import hashlib
import json
import zlib
from collections.abc import Mapping, Sequence
from typing import Any

import anyio

from ros2_mcp.model.aside import load
from ros2_mcp.model.errors import RobotError
from ros2_mcp.model.poses import Pose
from ros2_mcp.model.text import counted, named
from ros2_mcp.ops.pictures.next_message import Next, next_message
from ros2_mcp.ops.results.results import silent
from ros2_mcp.ops.sources.source import Source
from ros2_mcp.ops.space.frames import WORLDS, frames_of
from ros2_mcp.robot import Robot
from ros2_mcp.view.look import Content, Look, PageContext, Panel, when
from ros2_mcp.view.marker_topics import MarkerTopics
from ros2_mcp.view.mesh_files import MeshFiles
from ros2_mcp.world.transforms import FrameTree
from ros2_mcp.world.urdf import Geometry, Urdf, parse

_CLOUD, _SCAN, _TEXT = "sensor_msgs/msg/PointCloud2", "sensor_msgs/msg/LaserScan", "std_msgs/msg/String"
_MOST_FRAMES = 150
_MOST_SCANS = 2
_OUTLINE, _OUTLINE_M = "outline", 0.15
"""An outline is drawn for a link whose mesh cannot be read and that has no simpler shape; the real size is not
known."""
_MOST_SHAPES = 500
_MOST_REASONS = 3
_DIGITS = 4
"""Decimals of metres and quaternions: a tenth of a millimetre."""


class SpacePanel(Panel):
    """Shows everything with a pose. The page fetches large parts (a cloud, the robot's shapes) once, by their keys."""

    name = "space"
    shows_types = (_CLOUD,)
    shows_kind = "pointcloud"
    period_s = 0.2

    def __init__(self, page: PageContext) -> None:
        super().__init__(page)
        self._files = MeshFiles(page.chunks, page.prefixes)
        self._markers = MarkerTopics(page.chunks)
        self._urdf: tuple[str, Urdf | str] = ("", "")
        self._described, self._is_read = asyncio.Event(), False
        self._meshes: Mapping[str, Mapping[str, Any] | str] = {}
        self._cloud: tuple[object, Mapping[str, Any]] = (None, {})
        self._model: tuple[str, Mapping[str, Any]] = ("", {})

    async def show(self, look: Look) -> Content | None:
        """Return what can be placed in one frame; `missing` has the reasons for the rest."""
        await load("ros2_mcp.values.cdr")  # imports numpy, only when needed
        source, missing = look.source, list[str]()
        clouds, scans, texts = await asyncio.gather(*(source.publishing(kind) for kind in (_CLOUD, _SCAN, _TEXT)))
        topic = look.chosen if look.chosen in clouds else next(iter(clouds), "")
        descriptions = [name for name in texts if name.rpartition("/")[2] == "robot_description"]
        model = await self._shapes(source, descriptions[0], missing) if descriptions else None
        read = [(name, _SCAN) for name in scans[:_MOST_SCANS]] + ([(topic, _CLOUD)] if topic else [])
        found = await asyncio.gather(*(_next(source, name, kind, missing) for name, kind in read))
        try:
            tree = await frames_of(source, until=lambda tree: bool(tree.frames), patience_s=1.0)
        except RobotError as error:
            missing.append(f"Without transforms, only data in one frame is shown: {error.message}")
            tree = FrameTree()
        frame = _frame_of(tree, [one.message.header.frame_id for one in found if one])
        placed = [
            (kind, name, one, pose)
            for (name, kind), one in zip(read, found, strict=True)
            if one and (pose := _located(tree, frame, one.message.header, name, missing))
        ]
        rows = [(name, one, pose) for kind, name, one, pose in placed if kind == _SCAN]
        points = await asyncio.gather(*(asyncio.to_thread(_scan, one.message, name, missing) for name, one, _ in rows))
        old = [f"{named(name)} {one.age}" for _, name, one, _ in placed if one.age]
        cloud = None
        for kind, name, one, pose in placed:
            if kind == _CLOUD and (facts := await self._packed(one.message, name, missing)):
                cloud = {**facts, **_whence(name, one, pose)}
        markers = await self._markers.shown(look, tree, frame, self._meshes, missing)
        old += self._markers.old(look.now_ns)
        told = [edge.last_received_ns for edge in tree.edges.values() if edge.moving]
        return {
            "frame": frame,
            "base": tree.base,
            "frames": _frames(tree, frame),
            "clouds": clouds,
            "cloud": cloud,
            "scans": [_whence(name, one, pose) for name, one, pose in rows],
            "model": model,
            "markers": markers,
            "missing": missing,
            "old": old,
            "told_s": max(told) / 1e9 if told else None,
            "bulk": list(points),
        }

    async def beside(self, robot: Robot) -> None:
        """Subscribe to markers while a page shows them, and read the meshes of a new description."""
        async with anyio.create_task_group() as tasks:
            tasks.start_soon(self._markers.run, robot)
            while True:
                await self._described.wait()
                self._described.clear()
                await self._read()

    async def _packed(self, message: Any, topic: str, missing: list[str]) -> Mapping[str, Any] | None:
        """Return the facts of a cloud; the page fetches its points by the key."""
        if self._cloud[0] is not message:
            from ros2_mcp.world.thinned_clouds import packed

            try:
                made = await asyncio.to_thread(packed, message)
            except RobotError as error:
                missing.append(f"The cloud {named(topic)} is not shown: {error.message}")
                return None
            key = hashlib.sha256(made.data).hexdigest()[:32]
            self._page.chunks.keep(key, made.data, "cloud")
            self._cloud = (
                message,
                {
                    "key": key,
                    "count": made.count,
                    "points": made.points,
                    "low": made.low,
                    "step": made.step,
                    "colours": made.colours,
                    "cell_m": made.cell_m,
                },
            )
        return self._cloud[1]

    async def _shapes(self, source: Source, topic: str, missing: list[str]) -> Mapping[str, Any] | None:
        found = await _next(source, topic, _TEXT, missing)
        if found is None:
            return None
        text = str(found.message.data)
        if self._urdf[0] != text:
            self._urdf = text, await asyncio.to_thread(_parsed, text)
            self._meshes = {}
            self._is_read = False
            self._described.set()
        urdf = self._urdf[1]
        if isinstance(urdf, str):
            missing.append(f"The robot's description cannot be read: {urdf}")
            return None
        if not self._is_read and not source.is_live:  # a recording is shown once; live, the next update has them
            await self._read()
        shapes = _shapes_of(urdf, self._meshes)
        missing += _without(urdf, self._meshes) if self._is_read else ["The robot's meshes are being read."]
        if hidden := sum(1 for shape in shapes if shape["kind"] == _OUTLINE):
            links = "1 link" if hidden == 1 else f"{hidden} links"
            missing.append(f"The shapes of {links} are missing: outlines are drawn instead.")
        of = hashlib.sha256(json.dumps(shapes).encode()).hexdigest()[:32]
        if self._model[0] != of or self._page.chunks.find(of) is None:
            self._page.chunks.keep(of, await asyncio.to_thread(_compressed, shapes), "model")
            meshes = sum(1 for shape in shapes if shape["mesh"])
            self._model = of, {"key": of, "shapes": len(shapes) - hidden, "meshes": meshes}
        return self._model[1]

    async def _read(self) -> None:
        urdf = self._urdf[1]
        found = await self._files.read([] if isinstance(urdf, str) else _named_meshes(urdf))
        if self._urdf[1] is urdf:
            self._meshes, self._is_read = found, True

    def words(self, content: Content) -> str:
        """Return the content in one line for the model."""
        if "frame" not in content:
            return ""
        cloud, model = content.get("cloud"), content.get("model")
        parts = [
            f"in {named(str(content['frame']))}",
            f"{cloud['count']} points of {named(str(cloud['name']))}" if cloud else "no cloud",
            counted(len(content.get("scans") or ()), "scan"),
            f"{model['shapes']} shapes of the robot" if model else "",
            counted(content["markers"]["count"], "marker") if content.get("markers") else "",
        ]
        return ", ".join(filter(None, parts))


def _parsed(text: str) -> Urdf | str:
    try:
        return parse(text)
    except RobotError as error:
        return error.message


def _compressed(shapes: Sequence[Mapping[str, Any]]) -> bytes:
    return zlib.compress(json.dumps(shapes).encode())


async def _next(source: Source, topic: str, kind: str, missing: list[str]) -> Next | None:
    try:
        return await next_message(source, topic, kind, silent)
    except RobotError as error:
        missing.append(f"{named(topic)} is not shown: {error.message}")
        return None


def _frame_of(tree: FrameTree, of_messages: Sequence[str]) -> str:
    """Return the frame in which everything is shown: a world frame if it exists."""
    standard = [name for name in WORLDS if name in tree.frames]
    top = tree.root_of(tree.base) if tree.base else next(iter(tree.roots), "")
    return next(iter([*standard, *filter(None, [top]), *(name.lstrip("/") for name in of_messages)]), "")


def _located(tree: FrameTree, frame: str, header: Any, topic: str, missing: list[str]) -> Pose | None:
    """Return the pose of a message's frame at its stamp, or from the newest transforms."""
    name = str(header.frame_id).lstrip("/")
    if name == frame:
        return Pose()
    at_ns = header.stamp.sec * 1_000_000_000 + header.stamp.nanosec
    found = (tree.find(frame, name, at_ns) if at_ns else None) or tree.newest(frame, name)
    if found is None:
        missing.append(f"{named(topic)} is not shown: no transform leads from {named(name)} to {named(frame)}.")
        return None
    return found.pose


def _whence(name: str, one: Next, pose: Pose) -> Mapping[str, Any]:
    """Return which message it is, when it was received, and the pose of its frame."""
    frame = str(one.message.header.frame_id).lstrip("/")
    return {"name": name, "frame": frame, **when(one.sample, bool(one.age)), "pose": _told(pose)}


def _frames(tree: FrameTree, frame: str) -> Sequence[Mapping[str, Any]]:
    rows: list[Mapping[str, Any]] = []
    for name in sorted(tree.frames)[:_MOST_FRAMES]:
        if found := tree.newest(frame, name):
            edge = tree.edges.get(name)
            parent = edge.newest.parent if edge and edge.newest else ""
            rows.append({"name": name, "parent": parent, "pose": _told(found.pose)})
    return rows


def _told(pose: Pose) -> Sequence[float]:
    """Return x, y, z and the quaternion x, y, z, w."""
    return [round(value, _DIGITS) for value in (*pose.translation, *pose.rotation)]


def _scan(message: Any, topic: str, missing: list[str]) -> str:
    """Encode x, y, x, y, … of a scan's obstacle points as little-endian 32-bit floats in base64."""
    from ros2_mcp.world.scans import scan_points

    try:
        hits = scan_points(message).hits
    except RobotError as error:
        missing.append(f"The scan {named(topic)} is not shown: {error.message}")
        return ""
    return base64.b64encode(hits[:20_000].astype("<f4").tobytes()).decode("ascii")


def _named_meshes(urdf: Urdf) -> list[str]:
    """Return the meshes of visual shapes, or of collision shapes for links without visual shapes."""
    return [one.mesh for link in urdf.links.values() for one in (link.visuals or link.collisions) if one.kind == "mesh"]


def _without(urdf: Urdf, meshes: Mapping[str, Mapping[str, Any] | str]) -> list[str]:
    """Describe which meshes are not drawn, and why."""
    reasons = {name: why for name in _named_meshes(urdf) if isinstance(why := meshes.get(name), str)}
    told = [f"The mesh {named(name)} is not drawn: {why}" for name, why in list(reasons.items())[:_MOST_REASONS]]
    if len(reasons) > _MOST_REASONS:
        told.append(f"{len(reasons) - _MOST_REASONS} more meshes are not drawn.")
    return told


def _shapes_of(urdf: Urdf, meshes: Mapping[str, Mapping[str, Any] | str]) -> Sequence[Mapping[str, Any]]:
    """Return the visual shapes of each link; collision shapes replace a mesh that cannot be drawn."""
    shapes: list[Mapping[str, Any]] = []
    for link in urdf.links.values():
        looks = link.visuals or link.collisions
        drawn = [one for one in looks if one.kind != "mesh" or isinstance(meshes.get(one.mesh), Mapping)]
        if len(drawn) < len(looks) or not looks:
            drawn += [one for one in link.collisions if one.kind != "mesh" and one not in drawn]
        shapes += [_shape(link.name, one, meshes.get(one.mesh)) for one in drawn]
        if not drawn and any(isinstance(meshes.get(one.mesh), str) for one in looks):
            shapes.append({**_shape(link.name, looks[0], None), "kind": _OUTLINE, "size": [_OUTLINE_M] * 3})
    return shapes[:_MOST_SHAPES]


def _shape(link: str, geometry: Geometry, mesh: Mapping[str, Any] | str | None) -> Mapping[str, Any]:
    mount = geometry.mount
    return {
        "link": link,
        "kind": geometry.kind,
        "size": list(geometry.size),
        "xyz": mount.xyz,
        "rpy": mount.rpy,
        "rgba": geometry.rgba,
        "mesh": mesh if geometry.kind == "mesh" else None,
    }
