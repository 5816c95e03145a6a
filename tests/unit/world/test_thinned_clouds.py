"""Clouds for drawing: how many points, and how exactly."""

from __future__ import annotations

import zlib
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from ros2_mcp.world.thinned_clouds import MOST_POINTS, packed


def cloud(xyz: Any, intensity: Any = None) -> Any:
    """A PointCloud2 as it is decoded."""
    columns = [xyz] if intensity is None else [xyz, np.asarray(intensity)[:, None]]
    data = np.concatenate(columns, axis=1).astype("<f4")
    names = ["x", "y", "z", "intensity"][: data.shape[1]]
    fields = [SimpleNamespace(name=name, offset=4 * at, datatype=7, count=1) for at, name in enumerate(names)]
    step = 4 * len(names)
    flat = np.frombuffer(data.tobytes(), np.uint8)
    return SimpleNamespace(
        fields=fields, height=1, width=len(data), point_step=step, row_step=len(flat), is_bigendian=False, data=flat
    )


def test_few_points_are_all_there_to_a_fraction_of_a_millimetre() -> None:
    xyz = np.random.default_rng(7).uniform(-10, 10, (5000, 3))
    made = packed(cloud(xyz, np.arange(5000)))
    data = zlib.decompress(made.data)
    assert (made.count, made.colours, made.cell_m, len(data)) == (5000, "intensity", 0.0, 5000 * 7)
    read = np.frombuffer(data, "<u2", 15000).reshape(-1, 3) * np.array(made.step) + np.array(made.low)
    assert np.abs(read - xyz).max() < 3e-4
    shades = np.frombuffer(data, np.uint8, offset=30000)
    assert (np.diff(shades.astype(int)) >= 0).all() and (shades[0], shades[-1]) == (0, 255)


def test_many_points_are_thinned_evenly_and_the_same_each_time() -> None:
    xyz = np.random.default_rng(7).uniform(0, 20, (400_000, 3))
    made = packed(cloud(xyz))
    assert MOST_POINTS / 4 < made.count <= MOST_POINTS and made.points == 400_000 and made.cell_m > 0
    assert packed(cloud(xyz)).data == made.data
    read = np.frombuffer(zlib.decompress(made.data), "<u2").reshape(-1, 3) * np.array(made.step) + np.array(made.low)
    counts, _ = np.histogram(read[:, 0], 8, (0, 20))
    assert counts.min() > 0.9 * counts.max()


@pytest.mark.parametrize("points", [[], [[np.nan, 0, 0]], [[1e8, 0, 0]], [[1, 2, 3]], [[1, 2, 3]] * 3])
def test_clouds_of_nothing_or_of_one_place(points: list[list[float]]) -> None:
    made = packed(cloud(np.array(points, float).reshape(-1, 3)))
    assert made.count == (len(points) if points and points[0] == [1, 2, 3] else 0)
    assert all(np.isfinite([*made.low, *made.step]))
