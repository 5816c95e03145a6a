"""Reduce point clouds for a web page: fewer points, two bytes per coordinate."""

from __future__ import annotations

import zlib
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from ros2_mcp.world.clouds import cloud_of

MOST_POINTS = 60_000
"""Points that a computer without a graphics card rotates smoothly."""
_FARTHEST_M = 2000.0
"""Distance from the sensor. No lidar sees as far, and one outlier would leave the other points no precision."""
_STEPS = 65535
_FIRST_CELLS = 500
"""Cells along the longest side in the first attempt of thinning."""
_COARSER = 1.4


@dataclass(frozen=True, slots=True, kw_only=True)
class PackedCloud:
    """A point cloud, packed for drawing.

    `data`, packed with zlib and little-endian, has x, y and z of each of `count` points in 16 bits (times `step`, plus
    `low`, in metres of the cloud's frame); then the colour of each point: three bytes (`rgb`) or one (`intensity`).
    `points` counts those of the message, of which one is kept in each cell of size `cell_m` (0: all are kept).
    """

    data: bytes
    count: int
    points: int
    low: Sequence[float]
    step: Sequence[float]
    colours: Literal["", "rgb", "intensity"]
    cell_m: float


def packed(message: Any, most: int = MOST_POINTS) -> PackedCloud:
    """Pack a PointCloud2 for drawing.

    Raises:
        BadData: as `cloud_of`.
    """
    cloud = cloud_of(message)
    near = np.flatnonzero((np.abs(cloud.xyz) < _FARTHEST_M).all(axis=1))
    kept, cell_m = _thinned(cloud.xyz[near], most)
    chosen = near[kept]
    xyz = cloud.xyz[chosen]
    low = xyz.min(axis=0) if len(xyz) else np.zeros(3)
    step = np.maximum((xyz.max(axis=0) - low) / _STEPS, 1e-9) if len(xyz) else np.ones(3)
    parts = [np.round((xyz - low) / step).astype("<u2").tobytes()]
    colours: Literal["", "rgb", "intensity"] = ""
    if cloud.rgb is not None:
        colours = "rgb"
        parts.append(cloud.rgb[chosen].tobytes())
    elif cloud.intensity is not None and len(xyz):
        colours = "intensity"
        parts.append(_bytes_of(cloud.intensity[chosen]).tobytes())
    return PackedCloud(
        data=zlib.compress(b"".join(parts), 1),
        count=len(xyz),
        points=cloud.points,
        low=[float(value) for value in low],
        step=[float(value) for value in step],
        colours=colours,
        cell_m=cell_m,
    )


def _thinned(xyz: NDArray[np.float64], most: int) -> tuple[NDArray[np.intp], float]:
    """Return the indices of the points to keep, and the cell size in m.

    The first point of each cell is kept, so that stationary objects do not flicker.
    """
    if len(xyz) <= most:
        return np.arange(len(xyz)), 0.0
    cell_m = max(float((xyz.max(axis=0) - xyz.min(axis=0)).max()) / _FIRST_CELLS, 1e-3)
    while True:
        cells = np.floor(xyz / cell_m).astype(np.int64)
        cells -= cells.min(axis=0)
        sizes = cells.max(axis=0) + 1
        numbers = (cells[:, 0] * sizes[1] + cells[:, 1]) * sizes[2] + cells[:, 2]
        _, first = np.unique(numbers, return_index=True)
        if len(first) <= most:
            return np.sort(first), cell_m
        cell_m *= _COARSER


def _bytes_of(values: NDArray[np.float64]) -> NDArray[np.uint8]:
    """Scale to 0 to 255 from the darkest to the brightest, without the outliers of 1 % at both ends."""
    finite = np.where(np.isfinite(values), values, 0.0)
    low, high = (float(value) for value in np.percentile(finite, (1, 99)))
    return (np.minimum(np.maximum((finite - low) / max(high - low, 1e-12), 0.0), 1.0) * 255).astype(np.uint8)
