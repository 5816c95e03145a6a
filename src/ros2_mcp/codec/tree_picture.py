"""The tree of frames as a picture: a row for each frame, set in by its depth, with a line from its parent."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from PIL import Image, ImageDraw

from ros2_mcp.codec.plot import letters
from ros2_mcp.codec.raster import Raster

MOST_ROWS = 100
"""More become too small to be read on 1568 pixels."""
_ROW, _STEP, _EDGE, _GAP = 15, 22, 8, 14
"""Pixels: the height of a row, how far a child is set in, the margin, and between a name and what is said of it."""
_LEAST_WIDTH = 320
_WHITE, _INK, _GREY, _LINE = "#ffffff", "#202020", "#707070", "#a0a0a0"
COLOURS = {"moving": "#1a7f37", "static": "#3b5bdb", "problem": "#c92a2a", "root": "#202020"}
"""What the colours of names mean."""


@dataclass(frozen=True, slots=True)
class TreeRow:
    """One frame: its name, how deep it is, what is said of its edge, and one of the keys of `COLOURS`."""

    name: str
    depth: int
    said: str
    kind: str


def tree_raster(rows: Sequence[TreeRow]) -> Raster:
    """The rows as a drawing, the first `MOST_ROWS` of them."""
    shown = rows[:MOST_ROWS]
    font = letters()

    def right_of(row: TreeRow) -> float:
        return _EDGE + row.depth * _STEP + font.getlength(row.name) + _GAP + font.getlength(row.said)

    width = round(max([_LEAST_WIDTH, *(right_of(row) + _EDGE for row in shown)]))
    image = Image.new("RGB", (width, 2 * _EDGE + _ROW * len(shown)), _WHITE)
    pen = ImageDraw.Draw(image)
    last_at: dict[int, int] = {}
    for number, row in enumerate(shown):
        left, middle = _EDGE + row.depth * _STEP, _EDGE + _ROW * number + _ROW // 2
        if row.depth:
            stem = left - _STEP + 6
            top = last_at.get(row.depth - 1, middle) + _ROW // 2
            pen.line([(stem, top), (stem, middle), (left - 3, middle)], _LINE)
        last_at[row.depth] = middle
        pen.text((left, middle), row.name, COLOURS[row.kind], font, anchor="lm")
        colour = COLOURS["problem"] if row.kind == "problem" else _GREY
        pen.text((left + font.getlength(row.name) + _GAP, middle), row.said, colour, font, anchor="lm")
    more = f" The first {MOST_ROWS} of {len(rows)} frames." if len(rows) > len(shown) else ""
    return Raster(np.asarray(image), f"Frames: green moving, blue static, red with a problem.{more}", kind="drawing")
