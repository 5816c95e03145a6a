"""The tree of frames as a picture: a row for each frame, set in by its depth, with a line from its parent."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from textwrap import wrap

import numpy as np
from PIL import Image, ImageDraw

from ros2_mcp.pictures.plot import letters
from ros2_mcp.pictures.raster import Raster

MOST_ROWS = 100
"""More become too small to be read on 1568 pixels."""
_ROW, _STEP, _EDGE, _GAP = 15, 22, 8, 14
"""Pixels: the height of a row, how far a child is set in, the margin, and between a name and what is said of it."""
_LEAST_WIDTH = 320
_MOST_SAID = 80
"""Characters of a line of what is said of a frame: longer ones make the picture too wide to be read."""
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
    """The rows as a drawing, the first `MOST_ROWS` of them; what is said of a frame is wrapped, and not cut off."""
    shown = rows[:MOST_ROWS]
    font = letters()
    said = [wrap(row.said, _MOST_SAID) or [""] for row in shown]

    def left_of(row: TreeRow) -> float:
        """Where what is said of it begins."""
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
