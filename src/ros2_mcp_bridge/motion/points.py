"""The points of a sensor_msgs/msg/PointCloud2, read with the standard library alone. No ROS."""

from __future__ import annotations

import math
import struct
from collections.abc import Iterator
from typing import Any

# The most points of a cloud that are read, evenly spread. Reading one costs 1 µs, so that a cloud of a depth camera
# (640 × 480, of which every 8th column of every 8th row is read, 0.9° apart) takes 5 ms of the ROS thread.
MOST_POINTS = 6000
# The format letters of the module struct for `datatype` of sensor_msgs/msg/PointField: FLOAT32 and FLOAT64.
_LETTERS = {7: "f", 8: "d"}


def places(cloud: Any) -> Iterator[tuple[float, float, float]]:
    """Yield x, y and z (m) of the finite points of a cloud, in its own frame: of all points, or of about `MOST_POINTS`.

    Raises:
        ValueError: if it has no x, y and z of floating point, or fewer bytes than its header says.
    """
    fields = {field.name: field for field in cloud.fields}
    if not all(name in fields and fields[name].datatype in _LETTERS for name in "xyz"):
        raise ValueError("a cloud has to have x, y and z")
    order = ">" if cloud.is_bigendian else "<"
    readers = [struct.Struct(order + _LETTERS[fields[name].datatype]) for name in "xyz"]
    offsets = [int(fields[name].offset) for name in "xyz"]
    data = memoryview(cloud.data).cast("B")
    rows, columns, step, row_step = cloud.height, cloud.width, cloud.point_step, cloud.row_step
    if not rows or not columns:
        return
    last = (
        (rows - 1) * row_step
        + (columns - 1) * step
        + max(offset + reader.size for offset, reader in zip(offsets, readers, strict=True))
    )
    if last > len(data):
        raise ValueError("a cloud has fewer bytes than its header says")
    every_row, every_column = _strides(rows, columns)
    (read_x, read_y, read_z), (at_x, at_y, at_z) = (reader.unpack_from for reader in readers), offsets
    for row in range(0, rows * row_step, max(1, every_row * row_step)):
        for at in range(row, row + columns * step, max(1, every_column * step)):
            (x,), (y,), (z,) = read_x(data, at + at_x), read_y(data, at + at_y), read_z(data, at + at_z)
            if math.isfinite(x + y + z):
                yield x, y, z


def _strides(rows: int, columns: int) -> tuple[int, int]:
    """Return the strides of rows and columns to read. They are equal if the cloud is an image."""
    excess = rows * columns / MOST_POINTS
    if excess <= 1:
        return 1, 1
    every_row = min(rows, math.ceil(math.sqrt(excess)))
    looked_at = math.ceil(rows / every_row)
    return every_row, math.ceil(columns * looked_at / MOST_POINTS)
