"""Draw the tree of frames: a row for each frame, indented by its depth, with a line from its parent."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from textwrap import wrap

import numpy as np
from PIL import Image, ImageDraw

from ros2_mcp.pictures.plot import letters
from ros2_mcp.pictures.raster import Raster

MOST_ROWS = 100
"""More rows would be too small to read on 1568 pixels."""
_ROW, _STEP, _EDGE, _GAP = 15, 22, 8, 14
"""Pixels: the height of a row, the indentation of a child, the margin, and the gap between a name and its text."""
_LEAST_WIDTH = 320
_MOST_SAID = 80
"""Characters of a line of a frame's text: longer lines make the picture too wide to read."""
_WHITE, _INK, _GREY, _LINE = "#ffffff", "#202020", "#707070", "#a0a0a0"
COLOURS = {"moving": "#1a7f37", "static": "#3b5bdb", "problem": "#c92a2a", "root": "#202020"}
"""The colours of names."""


@dataclass(frozen=True, slots=True)
class TreeRow:
    """One frame: its name, its depth, a text about its edge, and a key of `COLOURS`."""

    name: str
    depth: int
    said: str
    kind: str


def tree_raster(rows: Sequence[TreeRow]) -> Raster:
    """Draw the first `MOST_ROWS` rows; long texts of frames are wrapped."""
    shown = rows[:MOST_ROWS]
    font = letters()
    said = [wrap(row.said, _MOST_SAID) or [""] for row in shown]

    def left_of(row: TreeRow) -> float:
        """Return where the text of a row begins, in pixels."""
        return _EDGE + row.depth * _STEP + font.getlength(row.name) + _GAP

    rights = [left_of(row) + max(map(font.getlength, lines)) for row, lines in zip(shown, said, strict=True)]
    width = round(max([_LEAST_WIDTH, *(right + _EDGE for right in rights)]))
    image = Image.new("RGB", (width, 2 * _EDGE + _ROW * sum(map(len, said))), _WHITE)
    pen = ImageDraw.Draw(image)
    last_at: dict[int, int] = {}
    middle = _EDGE + _ROW // 2
    for row, lines in zip(shown, said, strict=True):
        left = _EDGE + row.depth * _STEP
        if row.depth:
            stem = left - _STEP + 6
            top = last_at.get(row.depth - 1, middle) + _ROW // 2
            pen.line([(stem, top), (stem, middle), (left - 3, middle)], _LINE)
        last_at[row.depth] = middle
        pen.text((left, middle), row.name, COLOURS[row.kind], font, anchor="lm")
        colour = COLOURS["problem"] if row.kind == "problem" else _GREY
        for line in lines:
            pen.text((left_of(row), middle), line, colour, font, anchor="lm")
            middle += _ROW
    more = f" The first {MOST_ROWS} of {len(rows)} frames." if len(rows) > len(shown) else ""
    return Raster(np.asarray(image), f"Frames: green moving, blue static, red with a problem.{more}", kind="drawing")
