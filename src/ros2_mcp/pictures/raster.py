"""The final step of every picture: encode pixels as PNG or JPEG within bounds, with a note."""

from __future__ import annotations

import io
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from ros2_mcp.model.errors import BadData
from ros2_mcp.model.pictures import Bounds, Picture

Pixels = NDArray[np.uint8]

_SMALLEST_SIDE = 16
"""Pixels. Nothing is recognisable in a smaller picture."""
_SMALL_PIXELS = 160 * 120
"""Photographs up to this size become PNG if it fits: JPEG would blur details of a few pixels."""
_QUALITIES = (85, 70, 50)
"""JPEG qualities; below 50 a smaller picture shows more than a worse picture."""
_COLOURS = (128, 16)
"""Numbers of colours for a drawing that is too large; 16 still distinguish the twelve curves of a plot."""
_MAGNIFIED_SIDE = 400
"""Pixels. Cells of small grids are magnified up to this side: vision models see little in tiny pictures."""


@dataclass(frozen=True, slots=True)
class Raster:
    """Pixels, height × width or height × width × 3 (RGB), and a note on what they show and how they were processed.

    A `photo` may become JPEG; the pixels of an `exact` raster are kept or dropped, but never blended; a `drawing` may
    lose colours.
    """

    pixels: Pixels
    note: str
    kind: Literal["photo", "exact", "drawing"] = "photo"


def finished(raster: Raster, bounds: Bounds) -> Picture:
    """Encode a raster at its own size if that is within the bounds, otherwise smaller.

    Raises:
        BadData: if it does not fit at any size.
    """
    whole = Image.fromarray(raster.pixels)
    for image in _sizes(whole, bounds.max_side, raster.kind):
        data, mime = encoded(image, raster.kind, bounds.max_bytes)
        if len(data) <= bounds.max_bytes:
            return Picture(data, mime, *image.size, raster.note + _shrunk(image, whole), whole.size)
    raise BadData(f"The picture does not fit into {bounds.max_bytes} bytes at any size.")


def encoded(image: Image.Image, kind: str, max_bytes: int) -> tuple[bytes, str]:
    """Return file and MIME type of the first encoding for that kind that fits, otherwise of the last encoding."""
    files = _encodings(image, kind)
    file = next(files)
    while len(file[0]) > max_bytes and (smaller := next(files, None)):
        file = smaller
    return file


def magnified(pixels: Pixels, max_side: int) -> tuple[Pixels, int]:
    """Magnify small pixels; return them and the factor, 1 if they are large enough."""
    times = max(1, min(_MAGNIFIED_SIDE, max_side) // max(pixels.shape[:2]))
    return pixels.repeat(times, axis=0).repeat(times, axis=1), times


def _shrunk(image: Image.Image, whole: Image.Image) -> str:
    if image.size == whole.size:
        return ""
    return f" Shown at {image.width} × {image.height} pixels instead of {whole.width} × {whole.height}."


def _sizes(whole: Image.Image, max_side: int, kind: str) -> Iterator[Image.Image]:
    """Yield the picture at its own size, if allowed, then ever smaller."""
    side = max(whole.size)
    if side <= max_side:
        yield whole
        side = side * 3 // 4
    side = min(side, max_side)
    while side >= _SMALLEST_SIDE:
        factor = side / max(whole.size)
        size = (max(1, round(whole.width * factor)), max(1, round(whole.height * factor)))
        if kind == "exact":
            yield whole.resize(size, Image.Resampling.NEAREST)
        else:
            yield whole.resize(size, Image.Resampling.BILINEAR, reducing_gap=2.0)
        side = side * 3 // 4


def _encodings(image: Image.Image, kind: str) -> Iterator[tuple[bytes, str]]:
    if kind != "photo" or image.width * image.height <= _SMALL_PIXELS:
        yield _saved(image, "PNG"), "image/png"
    if kind == "drawing":
        for colours in _COLOURS:
            yield _saved(image.quantize(colours), "PNG"), "image/png"
    if kind == "photo":
        for quality in _QUALITIES:
            yield _saved(image, "JPEG", quality=quality), "image/jpeg"


def _saved(image: Image.Image, file_format: str, **options: int) -> bytes:
    buffer = io.BytesIO()
    image.save(buffer, file_format, **options)
    return buffer.getvalue()
