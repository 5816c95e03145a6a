"""Draw the scene: one picture from above, in metres, from which coordinates can be read."""

from __future__ import annotations

import math
import zlib
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw

from ros2_mcp.model.costs import OCCUPIED, TOUCHING, UNKNOWN
from ros2_mcp.model.errors import BadData
from ros2_mcp.model.pictures import Bounds, Place
from ros2_mcp.pictures.palette import cost_colours, hexadecimal, map_colours
from ros2_mcp.pictures.plot import Span, labels, letters, round_step
from ros2_mcp.pictures.raster import Pixels, Raster
from ros2_mcp.world.limbs import LimbSeen
from ros2_mcp.world.occupancy import OccupancyGrid, largest_of

_MOST_PIXELS = 1_050_000
"""Vision models scale down larger pictures, so that the letters become too small."""
_LONGEST_SIDE = 1400
"""Pixels of the ground; the axes take the rest of the largest side that models accept."""
_FINEST_M = 0.002
"""Least metres per pixel: measurements are not more accurate than a few centimetres."""
_BETWEEN_PX = 36
"""Least pixels between two grid lines: closer lines would hide what is below, and a fifth of a spacing can be
estimated."""
_LABEL_PX = 58
"""Least pixels between two labels; if lines are closer, only every second line has a label."""
_FARTHEST_M = 1e6
"""Larger coordinates are invalid: no robot is a thousand kilometres away."""
_BEYOND_PX = 20_000
"""Lines to points farther out are clipped here: they are outside of the picture, and drawing longer lines takes
seconds.
"""
_TOP, _RIGHT, _GAP, _TICK, _ROW = 30, 64, 8, 5, 22
"""Pixels: room above and right of the ground for labels, beside a label, of a tick, and of a line of the legend."""
_LARGE, _SMALL = 17, 15
"""Pixels: the letters of labels on the axes, and of names in the picture."""
_MOST_OUTSIDE = 3
"""Goals outside of the picture that the legend lists; the result lists all of them."""
_LONGEST_NAME = 28
"""Characters of a name in the picture; the result has the full name."""

_PAPER, _INK = "#ffffff", "#1a1a1a"
_LINE, _STRONG_LINE = (40, 90, 200, 120), (30, 80, 200, 190)
"""Grid lines are blue (no map is blue), so that they are visible on black, grey and white."""
ROBOT, SCAN, PATH, GOAL, PLACE = "#ff8c00", "#e6003c", "#00a03c", "#c800c8", "#0050d2"
_HEADING = "#8a3c00"
_ZONE, _ZONE_FILL = "#b00000", (200, 0, 0, 55)
LIMB, _LIMB_FILL = "#5a3296", (150, 110, 220)
_PATHS = (PATH, "#00949e", "#7a9a00", "#3c6e50")
_MIDDLE_COST = 50
"""The cost between free and inscribed whose colour the legend shows."""


@dataclass(frozen=True, slots=True)
class GridLayer:
    """An occupancy grid, with the pose of the corner of cell (0, 0) in the frame of the scene.

    `costs` is whether it is a costmap.
    """

    grid: OccupancyGrid
    corner: Place
    costs: bool = False


@dataclass(frozen=True, slots=True)
class Mark:
    """A named place, or a goal; without a yaw it is only a point."""

    name: str
    x_m: float
    y_m: float
    yaw_rad: float | None = None


@dataclass(frozen=True, slots=True)
class Zone:
    """A keep-out zone: its name, and its corners as n × 2."""

    name: str
    corners: NDArray[np.float64]


@dataclass(frozen=True, slots=True, kw_only=True)
class Scene:
    """The content of a scene, all in the frame `frame`, in metres: points and lines are n × 2.

    `x` and `y` are the ranges shown. `footprint` is the outline of the robot, `limbs` are its links moved by joints,
    the lowest first; `path_names` are the names of `paths`.
    """

    frame: str
    x: Span
    y: Span
    grid: GridLayer | None = None
    robot: Place | None = None
    footprint: NDArray[np.float64] | None = None
    limbs: Sequence[LimbSeen] = ()
    scans: Sequence[NDArray[np.float64]] = ()
    paths: Sequence[NDArray[np.float64]] = ()
    path_names: Sequence[str] = ()
    goals: Sequence[Mark] = ()
    places: Sequence[Mark] = ()
    zones: Sequence[Zone] = ()


@dataclass(frozen=True, slots=True)
class SceneDrawing:
    """The scene as pixels; the ground's upper left pixel is at `left_px`, `top_px`.

    `line_m` is the spacing of grid lines.
    """

    raster: Raster
    metres_per_pixel: float
    left_px: int
    top_px: int
    line_m: float


def extent(
    grid: GridLayer | None, points: Iterable[NDArray[np.float64]], about: Place | None, radius_m: float | None
) -> tuple[Span, Span]:
    """Return the ranges to show: around a place, or the known part of the grid and all points, with a margin.

    Raises:
        BadData: if there is nothing to show.
    """
    if radius_m is not None and about is not None:
        return Span(about.x_m - radius_m, about.x_m + radius_m), Span(about.y_m - radius_m, about.y_m + radius_m)
    found = [np.empty((0, 2)), *points]
    if about is not None:
        found.append(np.array([[about.x_m, about.y_m]]))
    every = np.concatenate(found)
    every = every[(np.abs(every) < _FARTHEST_M).all(axis=1)]
    if grid is not None:  # far points must not shrink the grid to a few pixels
        corners = _known_corners(grid)
        low, high = corners.min(axis=0), corners.max(axis=0)
        far = (high - low).max()
        every = np.concatenate((corners, every[((every > low - far) & (every < high + far)).all(axis=1)]))
    if not len(every):
        raise BadData("There is nothing to show: no grid, no scan and no robot.")
    low, high = every.min(axis=0), every.max(axis=0)
    room = max(0.5 if grid is None else 0.1, 0.02 * float((high - low).max()))  # so that nothing lies on the edge
    least = max(1.0, 0.15 * float((high - low).max()))  # for a robot alone, and so that a corridor has room for lines
    spans = [Span(float(a) - room, float(b) + room) for a, b in zip(low, high, strict=True)]
    x, y = (Span(min(s.low, mid - least), max(s.high, mid + least)) for s in spans for mid in ((s.low + s.high) / 2,))
    return x, y


def scene_drawing(scene: Scene, bounds: Bounds) -> SceneDrawing:
    """Draw the scene with labelled grid lines, x to the right and y up."""
    side = min(_LONGEST_SIDE, bounds.max_side - 160)
    metres = max(
        math.sqrt(scene.x.length * scene.y.length / _MOST_PIXELS),
        max(scene.x.length, scene.y.length) / side,
        _FINEST_M,
    )
    width, height = max(1, round(scene.x.length / metres)), max(1, round(scene.y.length / metres))
    ground = Image.fromarray(_ground(scene, metres, width, height))
    line_m = round_step(_BETWEEN_PX * metres)
    x_lines, y_lines = _lines(scene.x, line_m), _lines(scene.y, line_m)
    sheet = _Sheet(scene, metres, ground)
    sheet.draw_lines(x_lines, y_lines, line_m)
    sheet.draw_layers()
    legend = sheet.legend()
    x_labels, y_labels = _labelled(x_lines, line_m, metres), _labelled(y_lines, line_m, metres)
    left = math.ceil(max((_wide(label) for _, label in y_labels), default=0)) + _GAP + _TICK
    rows = _rows(legend, left + width)
    whole = Image.new("RGB", (left + width + _RIGHT, _TOP + height + _ROW * (len(rows) + 2)), _PAPER)
    whole.paste(sheet.image, (left, _TOP))
    _write_axes(whole, scene, metres, (x_labels, y_labels), (left, width, height))
    _write_legend(whole, rows, _TOP + height + 2 * _ROW)
    return SceneDrawing(Raster(np.asarray(whole), "", kind="drawing"), metres, left, _TOP, line_m)


# ── the ground: an occupancy grid in the frame of the scene ──────────────────────────────────────────────────────


def _ground(scene: Scene, metres: float, width: int, height: int) -> Pixels:
    """Draw the grid by looking up each pixel in it; white outside of the grid."""
    if scene.grid is None:
        return np.full((height, width, 3), 255, np.uint8)
    cells, resolution = _pooled(scene.grid, metres)
    corner = scene.grid.corner
    x = scene.x.low + (np.arange(width) + 0.5) * metres - corner.x_m
    y = scene.y.low + (np.arange(height)[::-1] + 0.5) * metres - corner.y_m
    cos, sin = math.cos(corner.yaw_rad), math.sin(corner.yaw_rad)
    along, across = cos * x[None, :] + sin * y[:, None], cos * y[:, None] - sin * x[None, :]
    columns, rows = np.floor(along / resolution), np.floor(across / resolution)
    inside = (columns >= 0) & (rows >= 0) & (columns < cells.shape[1]) & (rows < cells.shape[0])
    values = np.full((height, width), -1, np.int16)
    values[inside] = cells[rows[inside].astype(np.int64), columns[inside].astype(np.int64)]
    return (cost_colours() if scene.grid.costs else map_colours())[values + 1]


def _pooled(layer: GridLayer, metres: float) -> tuple[NDArray[np.int8], float]:
    """Return the cells and their size; cells smaller than pixels are pooled, and the most occupied one wins."""
    together = max(1, math.floor(metres / layer.grid.resolution_m))
    return largest_of(layer.grid.percentages(), together), layer.grid.resolution_m * together


@dataclass(frozen=True, slots=True)
class PackedGrid:
    """The cells of a grid as signed bytes (-1 unknown, 0 to 100), rows upwards, packed with zlib."""

    width: int
    height: int
    resolution_m: float
    data: bytes


def packed(layer: GridLayer, most_cells: int) -> PackedGrid:
    """Pack a grid for drawing on the page; a grid with more cells than `most_cells` is pooled as in `_pooled`."""
    more = layer.grid.cells.size / most_cells
    side_m = layer.grid.resolution_m * (math.ceil(math.sqrt(more)) * (1 + 1e-9) if more > 1 else 1)
    cells, resolution_m = _pooled(layer, side_m)
    height, width = cells.shape
    return PackedGrid(width, height, resolution_m, zlib.compress(cells.tobytes(), 1))


def _known_corners(layer: GridLayer) -> NDArray[np.float64]:
    """Return the corners of the known part of the grid, in the frame of the scene."""
    cells, resolution, corner = layer.grid.percentages(), layer.grid.resolution_m, layer.corner
    known = np.argwhere(cells >= 0)
    low, high = (known.min(axis=0), known.max(axis=0) + 1) if len(known) else (np.zeros(2), np.array(cells.shape))
    rows, columns = np.array([low[0], low[0], high[0], high[0]]), np.array([low[1], high[1], high[1], low[1]])
    x, y = columns * resolution, rows * resolution
    cos, sin = math.cos(corner.yaw_rad), math.sin(corner.yaw_rad)
    return np.stack((corner.x_m + cos * x - sin * y, corner.y_m + sin * x + cos * y), axis=1)


# ── what is on it ────────────────────────────────────────────────────────────────────────────────────────────────


class _Sheet:
    """The ground with the layers drawn on it."""

    def __init__(self, scene: Scene, metres: float, ground: Image.Image) -> None:
        self._scene, self._metres = scene, metres
        self.image = ground
        self._pen = ImageDraw.Draw(ground, "RGBA")

    def _pixel(self, x_m: float, y_m: float) -> tuple[float, float]:
        scene = self._scene
        return (x_m - scene.x.low) / self._metres, self.image.height - (y_m - scene.y.low) / self._metres

    def _pixels(self, points: NDArray[np.float64]) -> list[tuple[float, float]]:
        fine = points[np.isfinite(points).all(axis=1) & (np.abs(points) < _FARTHEST_M).all(axis=1)]
        pixels = [self._pixel(float(x), float(y)) for x, y in fine]
        return [(min(max(x, -_BEYOND_PX), _BEYOND_PX), min(max(y, -_BEYOND_PX), _BEYOND_PX)) for x, y in pixels]

    def _shows(self, mark: Mark) -> bool:
        return self._is_inside(self._pixel(mark.x_m, mark.y_m))

    def _is_inside(self, at: tuple[float, float]) -> bool:
        return 0 <= at[0] <= self.image.width and 0 <= at[1] <= self.image.height

    def draw_lines(self, x_lines: Sequence[float], y_lines: Sequence[float], line_m: float) -> None:
        for x in x_lines:
            at = self._pixel(x, 0)[0]
            self._pen.line([at, 0, at, self.image.height], *_line_style(x, line_m))
        for y in y_lines:
            at = self._pixel(0, y)[1]
            self._pen.line([0, at, self.image.width, at], *_line_style(y, line_m))

    def draw_layers(self) -> None:
        scene = self._scene
        for zone in scene.zones:
            if len(outline := self._pixels(zone.corners)) > 2:
                self._pen.polygon(outline, fill=_ZONE_FILL, outline=_ZONE, width=2)
        for index, path in enumerate(scene.paths):
            pixels = self._pixels(path)
            if len(pixels) > 1:
                self._pen.line(pixels, _PATHS[index % len(_PATHS)], 3, "curve")
        for scan in scene.scans:
            for x, y in filter(self._is_inside, self._pixels(scan)):
                self._pen.ellipse([x - 2.5, y - 2.5, x + 2.5, y + 2.5], fill=SCAN)
        for zone in scene.zones:
            x, y = self._pixel(*map(float, zone.corners.mean(axis=0)))
            if self._is_inside((x, y)):
                self._write(zone.name, (x, y), _ZONE)
        for mark in scene.places:
            self._draw_mark(mark, PLACE, square=True)
        for mark in scene.goals:
            self._draw_mark(mark, GOAL, square=False)
        if scene.robot:
            self._draw_robot(scene.robot)
        for limb in scene.limbs:
            self._draw_limb(limb)

    def _draw_mark(self, mark: Mark, colour: str, *, square: bool) -> None:
        x, y = self._pixel(mark.x_m, mark.y_m)
        if not self._is_inside((x, y)):
            return
        if mark.yaw_rad is not None:
            self._arrow((x, y), mark.yaw_rad, 34, colour)
        outline = [x - 6, y - 6, x + 6, y + 6]
        if square:
            self._pen.rectangle(outline, fill=colour, outline="white", width=2)
        else:
            self._pen.ellipse(outline, fill=colour, outline="white", width=2)
        is_up = mark.yaw_rad is not None and math.sin(mark.yaw_rad) > 0 and math.cos(mark.yaw_rad) > 0
        self._write(mark.name, (x, y + 26 if is_up else y), colour)  # beside the arrow

    def _draw_robot(self, robot: Place) -> None:
        scene, at = self._scene, self._pixel(robot.x_m, robot.y_m)
        if max(map(abs, at)) > _BEYOND_PX:
            return
        reach = 26.0
        if scene.footprint is not None and len(outline := self._pixels(scene.footprint)) > 2:
            self._pen.polygon(outline, fill=(255, 140, 0, 110), outline=ROBOT, width=3)
            reach = max(reach, 14 + max(math.hypot(x - at[0], y - at[1]) for x, y in outline))
        else:
            self._pen.ellipse([at[0] - 9, at[1] - 9, at[0] + 9, at[1] + 9], fill=ROBOT, outline=_INK, width=1)
        self._arrow(at, robot.yaw_rad, reach, _HEADING)
        self._pen.ellipse([at[0] - 3, at[1] - 3, at[0] + 3, at[1] + 3], fill=_INK)

    def _draw_limb(self, limb: LimbSeen) -> None:
        """Draw a limb's shapes, the line from the link that holds it, and a dot at its joint."""
        if limb.outline and len(outline := self._pixels(np.array(limb.outline))) > 2:
            self._pen.polygon(outline, fill=(*_LIMB_FILL, 120), outline=LIMB, width=2)
        bone = self._pixels(np.array(limb.bone)) if limb.bone else []
        if len(bone) == 2:
            self._pen.line(bone, LIMB, 2)
            if limb.is_jointed:
                x, y = bone[1]
                self._pen.ellipse([x - 4, y - 4, x + 4, y + 4], fill="white", outline=LIMB, width=2)

    def _arrow(self, at: tuple[float, float], yaw_rad: float, length: float, colour: str) -> None:
        def off(turn: float, far: float) -> tuple[float, float]:
            return at[0] + far * math.cos(yaw_rad + turn), at[1] - far * math.sin(yaw_rad + turn)

        tip, neck = off(0, length), length - 16
        self._pen.line([at, off(0, neck + 2)], "white", 6)
        self._pen.line([at, off(0, neck + 2)], colour, 3)
        spread = math.atan2(6, neck)
        far = math.hypot(6, neck)
        self._pen.polygon([tip, off(spread, far), off(-spread, far)], fill=colour, outline="white")

    def _write(self, name: str, at: tuple[float, float], colour: str) -> None:
        """Write a name beside its mark, on the left if there is no room on the right."""
        text, font = _short(name), letters(_SMALL)
        wide = font.getlength(text)
        x = at[0] + 10 if at[0] + 14 + wide < self.image.width else at[0] - 12 - wide
        y = min(max(at[1] - 20, 0), self.image.height - 20)
        self._pen.rectangle([x - 2, y, x + wide + 2, y + 18], fill=(255, 255, 255, 215))
        self._pen.text((x, y), text, colour, font)

    def legend(self) -> list[tuple[str, str]]:
        """Return colour and meaning of what is drawn."""
        scene = self._scene
        found: list[tuple[str, str]] = []
        if scene.robot:
            found.append((ROBOT, "robot, arrow: heading"))
        if scene.limbs:
            found.append((LIMB, "links that joints move, dots: joints"))
        if scene.scans:
            found.append((SCAN, "laser scan"))
        several = len(scene.paths) > 1  # each has a colour of its own
        for index in range(len(scene.paths)):
            name = f" {_short(scene.path_names[index])}" if several and index < len(scene.path_names) else ""
            found.append((_PATHS[index % len(_PATHS)], f"path{name}"))
        if scene.zones:
            found.append((_ZONE, "keep-out zone"))
        if any(map(self._shows, scene.goals)):
            found.append((GOAL, "goal"))
        if any(map(self._shows, scene.places)):
            found.append((PLACE, "place"))
        outside = [mark for mark in scene.goals if not self._shows(mark)]
        found += [(GOAL, f"goal outside, at ({mark.x_m:.4g}, {mark.y_m:.4g})") for mark in outside[:_MOST_OUTSIDE]]
        if scene.grid and scene.grid.costs:
            colours = cost_colours()
            known = ((OCCUPIED, "lethal"), (TOUCHING, "inscribed"), (_MIDDLE_COST, "blue to red: cost"))
            found += [(hexadecimal(colours, value), meaning) for value, meaning in known]
        elif scene.grid:
            found += [
                (hexadecimal(map_colours(), value), words)
                for value, words in ((OCCUPIED, "occupied"), (UNKNOWN, "unknown"))
            ]
        return found


# ── axes ─────────────────────────────────────────────────────────────────────────────────────────────────────────


def _lines(span: Span, line_m: float) -> list[float]:
    return [number * line_m for number in range(math.ceil(span.low / line_m), math.floor(span.high / line_m) + 1)]


def _labelled(lines: Sequence[float], line_m: float, metres: float) -> list[tuple[float, str]]:
    """Return the lines that have a label, and the label: each line or every second line, including 0."""
    every = 1 if line_m / metres >= _LABEL_PX else 2
    chosen = [value for value in lines if round(value / line_m) % every == 0]
    if len(chosen) < 2:
        return [(value, f"{value:g}") for value in chosen]
    return list(zip(chosen, labels(chosen), strict=True))


def _line_style(at: float, line_m: float) -> tuple[tuple[int, int, int, int], int]:
    """Return colour and width: zero and every second line are stronger, so that lines can be counted."""
    number = round(at / line_m)
    if number == 0:
        return (200, 30, 30, 170), 2
    return (_STRONG_LINE if number % 2 == 0 else _LINE), 1


def _write_axes(
    whole: Image.Image,
    scene: Scene,
    metres: float,
    said: tuple[Sequence[tuple[float, str]], Sequence[tuple[float, str]]],
    ground: tuple[int, int, int],
) -> None:
    """Write labels on all four sides, so that every object is near a label."""
    left, width, height = ground
    pen, font = ImageDraw.Draw(whole), letters(_LARGE)
    right, bottom = left + width, _TOP + height
    pen.rectangle([left - 1, _TOP - 1, right, bottom], outline=_INK)
    for value, label in said[0]:
        at = left + (value - scene.x.low) / metres
        for y, anchor in ((bottom + _TICK, "ma"), (_TOP - _TICK, "md")):
            pen.text((at, y), label, _INK, font, anchor=anchor)
        pen.line([at, bottom, at, bottom + _TICK - 1], _INK)
    for value, label in said[1]:
        at = bottom - (value - scene.y.low) / metres
        pen.text((left - _GAP, at), label, _INK, font, anchor="rm")
        pen.text((right + _GAP, at), label, _INK, font, anchor="lm")
        pen.line([left - _TICK, at, left - 1, at], _INK)
    words = f"x [m] to the right, y [m] up, in the frame {_short(scene.frame)}"
    pen.text((left, bottom + _ROW + 2), words, _INK, letters(_SMALL), anchor="la")


def _rows(legend: Sequence[tuple[str, str]], width: int) -> list[list[tuple[str, str]]]:
    """Break the legend into rows."""
    rows: list[list[tuple[str, str]]] = [[]]
    used = 0.0
    for colour, text in legend:
        wide = 34 + letters(_SMALL).getlength(text)
        if rows[-1] and used + wide > width:
            rows.append([])
            used = 0.0
        rows[-1].append((colour, text))
        used += wide
    return rows


def _write_legend(whole: Image.Image, rows: Sequence[Sequence[tuple[str, str]]], top: int) -> None:
    pen, font = ImageDraw.Draw(whole), letters(_SMALL)
    for number, row in enumerate(rows):
        x, y = 10.0, top + number * _ROW
        for colour, text in row:
            pen.rectangle([x, y + 3, x + 12, y + 15], fill=colour, outline=_INK)
            pen.text((x + 17, y), text, _INK, font)
            x += 34 + font.getlength(text)


def _wide(label: str) -> float:
    return letters(_LARGE).getlength(label)


def _short(name: str) -> str:
    shown = "".join(sign if sign.isprintable() else "?" for sign in name)
    return shown if len(shown) <= _LONGEST_NAME else f"{shown[: _LONGEST_NAME - 1]}…"
