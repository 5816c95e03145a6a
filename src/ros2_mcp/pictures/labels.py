"""Draw images whose values are labels, such as segmentation classes: one colour per label."""

from __future__ import annotations

import colorsys
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ros2_mcp.pictures.raster import Raster

_DARK = 64
"""Labels begin at 1: as grey, values below this would all look black, and as distances they are nearer than a depth
camera sees."""
_VOID = 255
"""The label of unclassified pixels, by the convention of Cityscapes and others."""
_PATCHES = 0.8
"""Labels form patches: at least this share of pixels equals the right neighbour. In a dark photograph, sensor noise
prevents that."""
_MOST = 256
"""More distinct values are probably measurements."""
_NAMED = 16
"""Labels that the note names with their colours; the others have small shares."""
_GOLDEN = 0.618034
"""Step around the colour circle: it keeps neighbouring labels distinct, however many there are."""


def label_raster(values: NDArray[Any], encoding: str, *, any_value: bool = False) -> Raster | None:
    """Draw labels in colours, 0 black and 255 grey; return None if the image does not look like labels.

    With `any_value` labels may have any value, as in 32-bit images, which are made for labels.
    """
    if not any_value and not ((values < _DARK) | (values == _VOID)).all():
        return None
    labels, counts = np.unique(values, return_counts=True)
    is_blank = not ((labels != 0) & (labels != _VOID)).any()
    if is_blank or len(labels) > _MOST or _alike(values) < _PATCHES:
        return None
    colours = np.array([_colour(int(label)) for label in labels], np.uint8)
    pixels = colours[np.searchsorted(labels, values)]
    largest = np.argsort(-counts, kind="stable")[:_NAMED]
    told = [f"{labels[i]} #{bytes(colours[i]).hex()} {counts[i] / values.size:.1%}" for i in largest]
    more = f" and {len(labels) - len(told)} more" if len(labels) > len(told) else ""
    return Raster(pixels, f"{encoding}, labels: each value in its colour: {', '.join(told)}{more}.", kind="exact")


def _alike(values: NDArray[Any]) -> float:
    """Return the share of pixels that equal their right neighbour."""
    return np.count_nonzero(values[:, 1:] == values[:, :-1]) / max(values[:, 1:].size, 1)


def _colour(label: int) -> tuple[int, ...]:
    if label in (0, _VOID):
        return (0, 0, 0) if label == 0 else (128, 128, 128)
    shade = 1.0 if label % 2 else 0.7
    return tuple(round(255 * part) for part in colorsys.hsv_to_rgb(label * _GOLDEN % 1, 0.8, shade))
