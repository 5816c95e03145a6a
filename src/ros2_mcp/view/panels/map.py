"""The map: the content of `ros2_scene` as numbers, for a page that draws it itself."""

from __future__ import annotations

import asyncio
import base64
import hashlib
import math
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

from ros2_mcp.model.pictures import OCCUPANCY_GRID
from ros2_mcp.model.text import listed, named
from ros2_mcp.ops.space.scene import Gathered, gather
from ros2_mcp.ops.space.scene_picture import SceneLayer, SceneRequest
from ros2_mcp.view.look import MOST_NAMED, Content, Look, PageContext, Panel

if TYPE_CHECKING:
    from ros2_mcp.pictures.scene import GridLayer, Mark
    from ros2_mcp.world.limbs import LimbSeen

_MOST_CELLS = 4_000_000
"""Cells of a grid: 2000 × 2000, which a page draws in some milliseconds."""
_MILLIMETRES = 3


class MapPanel(Panel):
    """Shows the surroundings of the robot from above, in metres of one frame."""

    name = "map"
    shows_types = (OCCUPANCY_GRID,)
    period_s = 0.19
    """Seconds. A robot at 1 m/s moves by less than its own length in that time."""

    def __init__(self, page: PageContext) -> None:
        super().__init__(page)
        self._grid: tuple[object, Mapping[str, Any]] = (None, {})

    async def show(self, look: Look) -> Content | None:
        """Return everything that can be placed; `missing` has the reasons for the rest."""
        grids = await look.source.publishing(OCCUPANCY_GRID)
        request = SceneRequest(grid=look.chosen if look.chosen in grids else "")
        found = await gather(look.robot, look.source, request)
        if not found.frame:
            return {"grids": grids, "why": "There is nothing to draw: no map, scan, path or transform was received."}
        at = found.robot
        robot = at and {
            "x": round(at.x_m, 4),
            "y": round(at.y_m, 4),
            "z": round(at.z_m, _MILLIMETRES),
            "yaw": round(at.yaw_rad, 5),
            "at_s": None if at.stamp_ns is None else at.stamp_ns / 1e9,
            "reckoned": _reckoned(found),
        }
        grid = None
        if found.grid_layer:
            grid = await self._packed(found.grid_layer, found.grid_topic)
        return {
            "frame": found.frame,
            "grids": grids,
            "robot": robot,
            "grid": grid,
            "footprint": _rounded(found.footprint) if found.footprint is not None else None,
            "limbs": [_limb(limb) for limb in found.limbs],
            "paths": [
                {"name": name, "points": _rounded(points)}
                for name, points in zip(found.path_names, found.paths, strict=True)
            ],
            "goals": [_mark(mark) for mark in found.goals],
            "places": [_mark(mark) for mark in found.places],
            "layers": [_told(layer, found) for layer in found.layers],
            "missing": list(found.missing),
            "old": [f"{one.kind} {named(one.name)} {one.from_before}" for one in found.layers if one.from_before],
            "bulk": [_points(scan) for scan in found.scans],
        }

    async def _packed(self, layer: GridLayer, topic: str) -> Mapping[str, Any]:
        """Return the facts of the grid; the page fetches its cells once, by the key."""
        if self._grid[0] is not layer.grid:
            from ros2_mcp.pictures.palette import cost_colours
            from ros2_mcp.pictures.scene import packed

            made = await asyncio.to_thread(packed, layer, _MOST_CELLS)
            key = hashlib.sha256(made.data).hexdigest()[:32]
            self._page.chunks.keep(key, made.data)
            facts: dict[str, Any] = {
                "key": key,
                "width": made.width,
                "height": made.height,
                "resolution": made.resolution_m,
            }
            if layer.costs:
                facts["colours"] = base64.b64encode(cost_colours().tobytes()).decode("ascii")
            self._grid = layer.grid, facts
        corner = layer.corner
        return {
            **self._grid[1],
            "name": topic,
            "costs": layer.costs,
            "x": corner.x_m,
            "y": corner.y_m,
            "yaw": corner.yaw_rad,
        }

    def words(self, content: Content) -> str:
        """Return the content in one line for the model."""
        parts: list[str] = []
        if grid := content.get("grid"):
            parts.append(named(str(grid["name"])))
        if at := content.get("robot"):
            where = f"({at['x']:.2f}, {at['y']:.2f}) m in {named(str(content.get('frame')))}"
            parts.append(f"the robot at {where}, heading {round(math.degrees(at['yaw']))}°")
        elif content.get("frame"):
            parts.append("the robot's pose is unknown")
        for kind in ("goals", "places", "paths"):
            if names := [str(one["name"]) for one in content.get(kind) or ()]:
                parts.append(f"{kind} {listed(names, MOST_NAMED)}")
        return ", ".join(parts)


def _reckoned(found: Gathered) -> Mapping[str, float] | None:
    """Return the robot's pose by odometry alone, which drifts but does not jitter as localisation does.

    None if there is no odometry, or the map is in its frame.
    """
    frame = next((name for name in found.tree.frames if name.rpartition("/")[2] == "odom" and name != found.frame), "")
    at = found.tree.newest(frame, found.tree.base) if frame and found.tree.base else None
    if at is None or at.stamp_ns is None:
        return None
    x, y, z = (round(part, 4) for part in at.pose.translation)
    return {"x": x, "y": y, "z": z, "yaw": round(at.pose.yaw_rad, 5), "at_s": at.stamp_ns / 1e9}


def _rounded(points: Any) -> Sequence[Sequence[float]]:
    return [[round(float(x), _MILLIMETRES), round(float(y), _MILLIMETRES)] for x, y in points]


def _points(points: Any) -> str:
    """Encode x, y, x, y, … as little-endian 32-bit floats in base64: the page reads them without parsing numbers."""
    return base64.b64encode(points.astype("<f4").tobytes()).decode("ascii")


def _limb(limb: LimbSeen) -> Mapping[str, Any]:
    bone = None if limb.bone is None else _rounded(limb.bone)
    return {"outline": _rounded(limb.outline), "bone": bone, "jointed": limb.is_jointed}


def _mark(mark: Mark) -> Mapping[str, Any]:
    return {"name": mark.name, "x": mark.x_m, "y": mark.y_m, "yaw": mark.yaw_rad}


def _told(layer: SceneLayer, found: Gathered) -> Mapping[str, Any]:
    """Return a layer with its time instead of its age, so that the page can count on."""
    at_s = None if layer.age_s is None or not math.isfinite(layer.age_s) else found.at_ns / 1e9 - layer.age_s
    return {"kind": layer.kind, "name": layer.name, "at_s": at_s}
