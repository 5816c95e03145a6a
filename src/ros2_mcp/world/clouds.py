"""Read sensor_msgs/msg/PointCloud2 of any layout as arrays of its points."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ros2_mcp.model.errors import BadData
from ros2_mcp.model.text import named, quoted

_KINDS = {1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 8: "f8"}
_INTENSITIES = ("intensity", "intensities", "i", "reflectivity")
_FARTHEST_M = 1e9
"""Some drivers mark missing points with huge numbers instead of NaN; no sensor sees a million kilometres."""
_PACKED = ("rgb", "rgba")
"""Fields with three or four colours packed in one number, as in PCL."""

# Fields that an error about a cloud names: enough to see what kind of cloud it is.
_MAX_NAMED = 10


@dataclass(frozen=True, slots=True)
class Cloud:
    """The points with finite coordinates (within a million kilometres), in metres.

    `points` counts all points of the message, `not_finite` the omitted ones. `intensity` has one number for each point,
    `rgb` is n × 3; None if the cloud has no such field.
    """

    xyz: NDArray[np.float64]
    intensity: NDArray[np.float64] | None
    rgb: NDArray[np.uint8] | None
    points: int
    not_finite: int


def cloud_of(message: Any) -> Cloud:
    """Return the points of a cloud.

    Raises:
        BadData: if the data does not fit the declared layout, or the cloud lacks x, y or z.
    """
    names = [field.name for field in message.fields]
    if not {"x", "y", "z"} <= set(names):
        raise BadData(
            f"The cloud has no x, y and z; its fields are {', '.join(map(named, names[:_MAX_NAMED])) or 'none'}."
        )
    rows = _rows(message)
    xyz = np.stack([rows[name].astype(np.float64).ravel() for name in "xyz"], axis=1)
    finite = (np.abs(xyz) < _FARTHEST_M).all(axis=1)
    intensity = next((rows[name].astype(np.float64).ravel() for name in _INTENSITIES if name in names), None)
    rgb = _rgb(rows, names)
    return Cloud(
        xyz[finite],
        None if intensity is None else intensity[finite],
        None if rgb is None else rgb[finite],
        len(xyz),
        int(len(xyz) - finite.sum()),
    )


@dataclass(frozen=True, slots=True)
class Points:
    """Points of a cloud as (x, y, z, further fields) in the units of the message.

    Every `stride`-th of the `finite` points is taken, up to the limit; `total` counts all points of the cloud.
    """

    rows: Sequence[tuple[float, ...]]
    stride: int
    finite: int
    total: int


def points_of(message: Any, fields: Sequence[str], stride: int | None, limit: int) -> Points:
    """Return the points with finite coordinates as Python numbers; float32 is rounded to seven digits.

    Args:
        message: a PointCloud2, or an object with its fields; `data` is an array of uint8.
        fields: names of further fields of each point; a packed rgb is the integer 0xRRGGBB.
        stride: 2 takes every second point. None: the smallest stride with which all points fit into `limit`.
        limit: the maximum number of points.

    Raises:
        BadData: if the data does not fit the declared layout, or the cloud lacks x, y, z or one of the fields.
    """
    names = [field.name for field in message.fields]
    shown = ", ".join(map(named, names[:_MAX_NAMED])) or "none"
    if missing := [name for name in ("x", "y", "z", *fields) if name not in names]:
        raise BadData(f"The cloud has no field {quoted(missing[0])}; its fields are {shown}.")
    rows: NDArray[Any] = np.ravel(_rows(message))
    xyz = np.stack([rows[name].astype(np.float64) for name in "xyz"], axis=1)
    finite = np.flatnonzero((np.abs(xyz) < _FARTHEST_M).all(axis=1))
    stride = stride or max(1, -(-len(finite) // limit))
    taken = rows[finite[::stride][:limit]]
    columns = [_numbers(taken[name]) for name in ("x", "y", "z", *fields)]
    return Points(list(zip(*columns, strict=True)), stride, len(finite), len(rows))


def _numbers(values: NDArray[Any]) -> list[Any]:
    plain: list[Any] = values.tolist()
    is_float32 = values.dtype.kind == "f" and values.dtype.itemsize == 4
    return [float(f"{value:.7g}") for value in plain] if is_float32 else plain


def _rows(message: Any) -> NDArray[Any]:
    """Return the points as a structured array of shape height × width, without padding."""
    point, height, width = message.point_step, message.height, message.width
    row = message.row_step if height > 1 else width * point
    order = ">" if message.is_bigendian else "<"
    formats = {field.name: order + _kind(field) for field in message.fields}
    offsets = {field.name: field.offset for field in message.fields}
    outside = [name for name in formats if offsets[name] + np.dtype(formats[name]).itemsize > point]
    if outside:
        raise BadData(f"The field {quoted(outside[0])} of the cloud ends beyond point_step, which is {point}.")
    if row < width * point:
        raise BadData(f"A row of {width} points of {point} bytes needs {width * point} bytes, but row_step is {row}.")
    needed = row * (height - 1) + width * point if height and width else 0
    if len(message.data) < needed:
        raise BadData(f"data has {len(message.data)} bytes, but {height} × {width} points take {needed}.")
    if not needed:
        height = width = 0
    layout: Any = {
        "names": list(formats),
        "formats": list(formats.values()),
        "offsets": list(offsets.values()),
        "itemsize": point,
    }
    return np.ndarray((height, width), np.dtype(layout), np.ascontiguousarray(message.data), 0, (row, point))


def _kind(field: Any) -> str:
    """Return the NumPy type of a field's (first) number; packed colours are read as integers."""
    if field.datatype not in _KINDS:
        raise BadData(f"The field {quoted(field.name)} of the cloud has the unknown datatype {field.datatype}.")
    kind = _KINDS[field.datatype]
    return "u4" if field.name in _PACKED and kind.endswith("4") else kind


def _rgb(rows: NDArray[Any], names: list[str]) -> NDArray[np.uint8] | None:
    for name in _PACKED:
        if name in names and rows.dtype[name].itemsize == 4:
            packed = rows[name].ravel()
            return np.stack([(packed >> shift) & 0xFF for shift in (16, 8, 0)], axis=1).astype(np.uint8)
    if {"r", "g", "b"} <= set(names) and all(rows.dtype[name] == np.uint8 for name in "rgb"):
        return np.stack([rows[name].ravel() for name in "rgb"], axis=1)
    return None
