"""Files of maps as Nav2's map server reads and writes them: a PGM image, and a YAML file beside it."""

# pyright: basic
from __future__ import annotations

from pathlib import Path

import numpy as np

FREE_GREY, OCCUPIED_GREY, UNKNOWN_GREY = 254, 0, 205


def write(path, cells, resolution, origin):
    """Write a map of int8 cells (rows, columns), row 0 at the smallest y, with its corner in m."""
    image = np.full(cells.shape, UNKNOWN_GREY, np.uint8)
    image[(cells >= 0) & (cells <= 25)] = FREE_GREY
    image[cells >= 65] = OCCUPIED_GREY
    path = Path(path)
    rows, columns = cells.shape
    path.with_suffix(".pgm").write_bytes(b"P5\n%d %d\n255\n" % (columns, rows) + image[::-1].tobytes())
    path.with_suffix(".yaml").write_text(
        f"image: {path.name}.pgm\nmode: trinary\nresolution: {resolution}\norigin: [{origin[0]}, {origin[1]}, 0]\n"
        "negate: 0\noccupied_thresh: 0.65\nfree_thresh: 0.25\n",
        encoding="utf-8",
    )


def read(path):
    """Return the cells, the resolution and the corner of a map.

    Raises:
        FileNotFoundError: if there is no such YAML file.
        KeyError, ValueError: if it lacks what is needed.
        OSError: if the image cannot be read.
    """
    path = Path(path)
    lines = (line.partition(":") for line in path.read_text(encoding="utf-8").splitlines() if ":" in line)
    said = {name.strip(): value.strip() for name, _, value in lines}
    resolution = float(said["resolution"])
    x, y, *_ = (float(part) for part in said["origin"].strip("[]").split(","))
    kind, columns, rows, _, pixels = (path.parent / said["image"]).read_bytes().split(maxsplit=4)
    if kind != b"P5":
        raise OSError("no PGM image")
    image = np.frombuffer(pixels, np.uint8).reshape(int(rows), int(columns))[::-1]
    cells = np.full(image.shape, -1, np.int8)
    cells[image >= 192] = 0
    cells[image <= 89] = 100
    cells[image == UNKNOWN_GREY] = -1
    return cells, resolution, (x, y)
