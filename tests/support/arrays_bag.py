"""A recording with clouds, maps and pictures of every size, made without ROS: what programs take apart."""

from __future__ import annotations

import base64
from pathlib import Path
from typing import Any

import numpy as np

from ros2_mcp.bags.stored import StoredTopic
from ros2_mcp.bags.writer import BagWriter
from ros2_mcp.model.samples import Sample
from support.made_windows import encoded

START_NS = 1_700_000_000_000_000_000
CLOUD, GRID, IMAGE = "sensor_msgs/msg/PointCloud2", "nav_msgs/msg/OccupancyGrid", "sensor_msgs/msg/Image"
POINT = np.dtype([("x", "<f4"), ("y", "<f4"), ("z", "<f4"), ("intensity", "<f4"), ("ring", "<u2")])
LARGE_POINTS = 200_000
"""3.6 MB, more than a program is given whole."""
LARGE_SIDE = 1200
"""Cells: 1.44 million of them."""


def points(count: int) -> np.ndarray[Any, Any]:
    """Number n is at (n / 10, 1, 0.5), of intensity n and ring n % 16."""
    made = np.zeros(count, POINT)
    numbers = np.arange(count)
    made["x"], made["y"], made["z"] = numbers / 10, 1.0, 0.5
    made["intensity"], made["ring"] = numbers, numbers % 16
    return made


def cloud(made: np.ndarray[Any, Any]) -> dict[str, Any]:
    kinds = {"f": 7, "u": 4}
    fields = [
        {"name": name, "offset": made.dtype.fields[name][1], "datatype": kinds[made.dtype[name].kind], "count": 1}
        for name in made.dtype.names
    ]
    return {
        "header": {"frame_id": "lidar"},
        "height": 1,
        "width": len(made),
        "fields": fields,
        "point_step": made.dtype.itemsize,
        "row_step": made.nbytes,
        "data": base64.b64encode(made.tobytes()).decode(),
    }


def grid(cells: np.ndarray[Any, Any], resolution_m: float, origin: dict[str, Any]) -> dict[str, Any]:
    height, width = cells.shape
    info = {"resolution": resolution_m, "width": width, "height": height, "origin": origin}
    return {"header": {"frame_id": "map"}, "info": info, "data": cells.ravel().tolist()}


def small_cells() -> np.ndarray[Any, Any]:
    """20 wide, 10 high: free, unknown in the lowest row, and a wall of 100 in column 15."""
    cells = np.zeros((10, 20), np.int8)
    cells[0], cells[:, 15] = -1, 100
    return cells


def arrays_bag(folder: Path) -> Path:
    """Writes the recording."""
    broken = points(20)
    broken["x"][3], broken["y"][4] = np.nan, np.inf
    turned = {"position": {"x": 1.0, "y": 2.0}, "orientation": {"z": np.sin(np.pi / 4), "w": np.cos(np.pi / 4)}}
    large = np.zeros((LARGE_SIDE, LARGE_SIDE), np.int8)
    large[1000, 200] = 100
    depth = np.arange(12, dtype="<u2") * 1000
    values: dict[str, tuple[str, dict[str, Any]]] = {
        "/points": (CLOUD, cloud(broken)),
        "/large_points": (CLOUD, cloud(points(LARGE_POINTS))),
        "/map": (GRID, grid(small_cells(), 0.1, {"position": {"x": -1.0, "y": 0.0}})),
        "/turned_map": (GRID, grid(small_cells(), 0.1, turned)),
        "/large_map": (GRID, grid(large, 0.05, {"position": {"x": 0.0, "y": 0.0}})),
        "/depth": (IMAGE, {"height": 3, "width": 4, "step": 8, "encoding": "16UC1", "data": list(depth.tobytes())}),
        "/large_image": (
            IMAGE,
            {"height": 1080, "width": 1920, "step": 3 * 1920, "encoding": "rgb8", "data": _picture()},
        ),
    }
    folder.mkdir()
    writer = BagWriter(folder, folder.name)
    for topic, (kind, _) in values.items():
        writer.add_topic(StoredTopic(topic, kind, None, "", "", ""))
    for number, (topic, (kind, value)) in enumerate(values.items(), 1):
        at_ns = START_NS + number * 100_000_000
        writer.write(topic, Sample(at_ns, at_ns, number, encoded(kind, value)))
    writer.close()
    return folder


def _picture() -> str:
    pixels = np.zeros((1080, 1920, 3), np.uint8)
    pixels[500, 700] = (10, 20, 30)
    return base64.b64encode(pixels.tobytes()).decode()
