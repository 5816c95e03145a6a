"""Read mesh files (STL, COLLADA, OBJ) as triangles, few and small enough for a web page to draw."""

from __future__ import annotations

import re
import zlib
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any, TypeAlias
from xml.etree import ElementTree

import numpy as np
from numpy.typing import NDArray

from ros2_mcp.model.errors import BadData
from ros2_mcp.model.text import quoted

Vertices: TypeAlias = NDArray[np.float64]
Triangles: TypeAlias = NDArray[np.int64]

MOST_BYTES = 30_000_000
"""Size of one file; the largest meshes of known robots have 10 MB."""
_MOST_TRIANGLES = 1_000_000
_DEEPEST = 50
"""Nesting depth of the nodes of a COLLADA scene."""
_MOST_PLACED = 2000
"""Instances of geometries in one COLLADA scene."""
_STL_HEADER, _STL_TRIANGLE = 84, 50
_STL_ROW = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])
_STEPS = 65535
_FIRST_CELLS = 400
"""Cells along the longest side in the first attempt to make a mesh coarser."""
_COARSER = 1.4
_FARTHEST = 1e6


@dataclass(frozen=True, slots=True)
class Part:
    """Triangles of one colour (red, green, blue, 0 to 255; None: no colour), as indices of their vertices."""

    vertices: Vertices
    triangles: Triangles
    rgb: tuple[int, int, int] | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class PackedMesh:
    """A mesh, packed for drawing.

    `data`, packed with zlib and little-endian, has three vertex indices (32 bits each) for each of `triangles`; then x,
    y and z (16 bits each, times `step`, plus `low`) for each of `vertices`; then, if it `has_colours`, three bytes for
    each vertex. `of_triangles` is the number of triangles in the file, of which some are omitted if there are too many.
    """

    data: bytes
    vertices: int
    triangles: int
    of_triangles: int
    low: list[float]
    step: list[float]
    has_colours: bool


def parts_of(data: bytes, suffix: str) -> list[Part]:
    """Parse a mesh file with this suffix.

    Raises:
        BadData: if the file cannot be read, or is too large.
    """
    if len(data) > MOST_BYTES:
        raise BadData(f"It has more than {MOST_BYTES / 1e6:.0f} MB.")
    try:
        parts = _READERS[suffix.lower()](data)
    except KeyError as error:
        raise BadData(f"Meshes that end with {quoted(suffix)} cannot be read.") from error
    except (ValueError, IndexError, OverflowError, RecursionError) as error:
        raise BadData(f"It is damaged: {quoted(str(error))}.") from error
    checked = [_checked(part) for part in parts]
    found = [part for part in checked if len(part.triangles)]
    if not found:
        raise BadData("It has no triangle.")
    if sum(len(part.triangles) for part in found) > _MOST_TRIANGLES:
        raise BadData(f"It has more than {_MOST_TRIANGLES} triangles.")
    return found


def packed_mesh(parts: list[Part], most: int) -> PackedMesh:
    """Pack meshes for drawing, with at most `most` triangles: in a finer mesh, vertices near each other are merged."""
    vertices = np.concatenate([part.vertices for part in parts])
    begins = np.cumsum([0, *(len(part.vertices) for part in parts)])
    triangles = np.concatenate([part.triangles + begin for part, begin in zip(parts, begins, strict=False)])
    of_part = np.repeat(np.arange(len(parts)), [len(part.vertices) for part in parts])
    used = vertices[np.unique(triangles)]
    low, size = used.min(axis=0), np.ptp(used, axis=0)
    step = np.maximum(size / _STEPS, 1e-12)
    kept, corners = _merged(vertices, triangles, of_part, low, step)
    cell = max(float(size.max()) / _FIRST_CELLS, 1e-12)
    while len(corners) > most:
        kept, corners = _merged(vertices, triangles, of_part, low, np.full(3, cell))
        cell *= _COARSER
    steps = _steps((vertices[kept] - low) / step).astype("<u2")
    has_colours = any(part.rgb is not None for part in parts)
    colours = np.array([part.rgb or (200, 200, 200) for part in parts], np.uint8)[of_part[kept]]
    data = corners.astype("<u4").tobytes() + steps.tobytes() + (colours.tobytes() if has_colours else b"")
    return PackedMesh(
        data=zlib.compress(data, 1),
        vertices=len(kept),
        triangles=len(corners),
        of_triangles=len(triangles),
        low=[float(value) for value in low],
        step=[float(value) for value in step],
        has_colours=has_colours,
    )


def _merged(
    vertices: Vertices, triangles: Triangles, of_part: NDArray[np.int64], low: Vertices, cell: Vertices
) -> tuple[NDArray[np.intp], Triangles]:
    """Return the first vertex in each cell, and the triangles between these vertices that still have an area."""
    at = _steps((vertices - low) / cell)
    number = ((of_part * (_STEPS + 1) + at[:, 0]) * (_STEPS + 1) + at[:, 1]) * (_STEPS + 1) + at[:, 2]
    _, first, cells = np.unique(number, return_index=True, return_inverse=True)
    corners = cells[triangles]
    one, two, three = corners[:, 0], corners[:, 1], corners[:, 2]
    corners = corners[(one != two) & (two != three) & (one != three)]
    seen, renumbered = np.unique(corners, return_inverse=True)
    return first[seen], _rows(renumbered, 3)


def _steps(values: Vertices) -> NDArray[np.int64]:
    return np.minimum(np.maximum(np.floor(values + 0.5), 0), _STEPS).astype(np.int64)


def _rows(values: Any, width: int) -> Any:
    """Reshape to rows of `width` numbers; raises `ValueError` if the last row is incomplete."""
    return values.reshape(-1, width)


def _checked(part: Part) -> Part:
    """Return the part without triangles whose corners are not finite; raises `BadData` for a missing corner."""
    vertices, triangles = part.vertices, part.triangles
    if len(triangles) and not (triangles.min() >= 0 and triangles.max() < len(vertices)):
        raise BadData("A triangle refers to a missing corner.")
    is_place: Any = (np.abs(vertices) < _FARTHEST).all(axis=1)
    return Part(np.where(is_place[:, None], vertices, 0.0), triangles[is_place[triangles].all(axis=1)], part.rgb)


# ── STL and OBJ ──────────────────────────────────────────────────────────────────────────────────────────────────


def _stl(data: bytes) -> list[Part]:
    count = int.from_bytes(data[80:84], "little")
    if len(data) >= _STL_HEADER and len(data) == _STL_HEADER + count * _STL_TRIANGLE:
        corners = _rows(np.frombuffer(data, _STL_ROW, count, _STL_HEADER)["corners"], 3).astype(np.float64)
    elif data.lstrip()[:5].lower() == b"solid":
        words = re.findall(rb"vertex\s+(\S+)\s+(\S+)\s+(\S+)", data)
        corners = _rows(np.array(words, dtype="S32").astype(np.float64), 3)
    else:
        raise ValueError("it is not an STL file, or is truncated")
    whole = len(corners) // 3 * 3
    return [Part(corners[:whole], _rows(np.arange(whole), 3))]


def _obj(data: bytes) -> list[Part]:
    vertices: list[list[float]] = []
    triangles: list[tuple[int, int, int]] = []
    for line in data.decode("utf-8", "replace").splitlines():
        kind, _, rest = line.strip().partition(" ")
        if kind == "v":
            vertices.append([float(word) for word in rest.split()[:3]])
        elif kind == "f":
            numbers = [int(word.partition("/")[0]) for word in rest.split()]
            corners = [number - 1 if number > 0 else len(vertices) + number for number in numbers]
            triangles += [(corners[0], corners[at], corners[at + 1]) for at in range(1, len(corners) - 1)]
    return [Part(_rows(np.array(vertices, np.float64), 3), _rows(np.array(triangles, np.int64), 3))]


# ── COLLADA ──────────────────────────────────────────────────────────────────────────────────────────────────────


def _dae(data: bytes) -> list[Part]:
    """Return the scene in metres. Its `up_axis` is ignored, as in RViz: descriptions are made to look right there."""
    if b"<!DOCTYPE" in data or b"<!ENTITY" in data:
        raise ValueError("it declares a document type")
    try:
        root = ElementTree.fromstring(data)
    except ElementTree.ParseError as error:
        raise ValueError(f"it is not valid XML: {error}") from error
    return _Collada(root).parts()


class _Collada:
    def __init__(self, root: ElementTree.Element) -> None:
        self._root = root
        self._by_id = {one.get("id", ""): one for one in root.iter() if one.get("id")}
        unit = root.find("{*}asset/{*}unit")
        self._metre = float(unit.get("meter", "1")) if unit is not None else 1.0
        self._placed = 0
        self._triangles = 0

    def parts(self) -> list[Part]:
        scene = self._named(self._root.find("{*}scene/{*}instance_visual_scene"), "url")
        scale = np.eye(4) * np.array([self._metre, self._metre, self._metre, 1.0])
        return [part for node in _all(scene, "node") for part in self._of_node(node, scale, 0)]

    def _named(self, element: ElementTree.Element | None, key: str) -> ElementTree.Element | None:
        return None if element is None else self._by_id.get(element.get(key, "").removeprefix("#"))

    def _of_node(self, node: ElementTree.Element, outer: NDArray[np.float64], depth: int) -> Iterator[Part]:
        if depth > _DEEPEST:
            raise ValueError("its nodes are nested too deep")
        pose = outer
        for step in node:
            if (matrix := _matrix(step)) is not None:
                pose = pose @ matrix
        for instance in _all(node, "instance_geometry"):
            self._placed += 1
            if self._placed > _MOST_PLACED:
                raise ValueError("it places too many geometries")
            colours = {
                one.get("symbol", ""): self._colour(self._named(one, "target"))
                for one in instance.iter()
                if _tag(one) == "instance_material"
            }
            geometry = self._named(instance, "url")
            mesh = None if geometry is None else geometry.find("{*}mesh")
            for part in () if mesh is None else self._of_mesh(mesh, colours):
                yield Part(part.vertices @ np.transpose(pose[:3, :3]) + pose[:3, 3], part.triangles, part.rgb)
        for inner in _all(node, "node"):
            yield from self._of_node(inner, pose, depth + 1)
        for instance in _all(node, "instance_node"):
            self._placed += 1
            inner = self._named(instance, "url")
            if inner is not None and self._placed <= _MOST_PLACED:
                yield from self._of_node(inner, pose, depth + 1)

    def _of_mesh(self, mesh: ElementTree.Element, colours: Mapping[str, tuple[int, int, int] | None]) -> Iterator[Part]:
        for primitive in mesh:
            kind = _tag(primitive)
            if kind not in ("triangles", "polylist", "polygons"):
                continue
            inputs = list(_all(primitive, "input"))
            stride = 1 + max((int(one.get("offset", "0")) for one in inputs), default=0)
            vertex = next((one for one in inputs if one.get("semantic") == "VERTEX"), None)
            vertices = self._vertices(vertex)
            offset = int(vertex.get("offset", "0")) if vertex is not None else 0
            if vertices is None or not 0 <= offset < stride <= 64:
                continue
            rows = [_rows(_numbers(one).astype(np.int64), stride)[:, offset] for one in _all(primitive, "p")]
            counts = primitive.find("{*}vcount") if kind == "polylist" else None
            triangles = _triangles(kind, rows, None if counts is None else _numbers(counts).astype(np.int64))
            self._triangles += len(triangles)
            if self._triangles > _MOST_TRIANGLES:
                raise ValueError(f"it has more than {_MOST_TRIANGLES} triangles")
            yield Part(vertices, triangles, colours.get(primitive.get("material", "")))

    def _vertices(self, vertex: ElementTree.Element | None) -> Vertices | None:
        vertices = self._named(vertex, "source")
        given = next((one for one in _all(vertices, "input") if one.get("semantic") == "POSITION"), None)
        source = self._named(given, "source")
        numbers = None if source is None else source.find("{*}float_array")
        return None if numbers is None else _rows(_numbers(numbers), 3)

    def _colour(self, material: ElementTree.Element | None) -> tuple[int, int, int] | None:
        instance = None if material is None else material.find("{*}instance_effect")
        effect = self._named(instance, "url")
        for one in () if effect is None else effect.iter():
            colour = one.find("{*}color") if _tag(one) == "diffuse" else None
            if colour is not None:
                red, green, blue = (round(min(max(float(part), 0.0), 1.0) * 255) for part in _numbers(colour)[:3])
                return red, green, blue
        return None


def _triangles(kind: str, rows: list[NDArray[np.int64]], counts: NDArray[np.int64] | None) -> Triangles:
    """Split polygons into fans of triangles."""
    if kind == "triangles":
        return np.concatenate([np.empty((0, 3), np.int64), *(_rows(row[: len(row) // 3 * 3], 3) for row in rows)])
    polygons = rows
    if counts is not None:
        if not rows or counts.min(initial=0) < 0 or int(counts.sum()) > len(rows[0]):
            raise ValueError("its polygons have more corners than it tells")
        polygons = np.split(rows[0], np.cumsum(counts))[:-1]
    fans = [(one[0], one[at], one[at + 1]) for one in polygons for at in range(1, len(one) - 1)]
    return _rows(np.array(fans, np.int64), 3)


def _matrix(step: ElementTree.Element) -> NDArray[np.float64] | None:
    """Return one transform of a node as a 4 × 4 matrix; None if the element is not a transform."""
    kind, made = _tag(step), np.eye(4)
    if kind == "matrix":
        return _rows(_numbers(step), 4)
    if kind == "translate":
        made[:3, 3] = _numbers(step)[:3]
    elif kind == "scale":
        made[:3, :3] = np.eye(3) * _numbers(step)[:3]
    elif kind == "rotate":
        x, y, z, degrees = _numbers(step)[:4]
        angle, length = np.radians(degrees), float(np.linalg.norm((x, y, z))) or 1.0
        x, y, z = x / length, y / length, z / length
        skew = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
        made[:3, :3] = np.eye(3) + np.sin(angle) * skew + (1 - np.cos(angle)) * skew @ skew
    else:
        return None
    return made


def _tag(element: ElementTree.Element) -> str:
    return element.tag.rpartition("}")[2]


def _all(element: ElementTree.Element | None, tag: str) -> Iterator[ElementTree.Element]:
    return iter(()) if element is None else (one for one in element if _tag(one) == tag)


def _numbers(element: ElementTree.Element) -> NDArray[np.float64]:
    return np.array((element.text or "").split(), np.float64)


_READERS: Mapping[str, Any] = {".stl": _stl, ".dae": _dae, ".obj": _obj}
SUFFIXES = tuple(_READERS)
"""File name suffixes that can be read."""
