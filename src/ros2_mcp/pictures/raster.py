"""The one finishing step of every picture: pixels become a PNG or JPEG within bounds, with a note what they show."""

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
"""Pixels. Nothing can be made out on a smaller picture."""
_SMALL_PIXELS = 160 * 120
"""Photographs up to this size become PNG if it fits: JPEG blurs what is only a few pixels large."""
_QUALITIES = (85, 70, 50)
"""Of JPEG; below 50 a smaller picture shows more than a worse one."""
_COLOURS = (128, 16)
"""Of a drawing that is too large as it is; 16 still tell the twelve curves of a plot apart."""
_MAGNIFIED_SIDE = 400
"""Pixels. Cells of small grids are drawn larger, up to this side: vision models see little in tiny pictures."""


@dataclass(frozen=True, slots=True)
class Raster:
    """Pixels, height × width or height × width × 3 (RGB), and in words what they show and what was done to them.

    A `photo` may become JPEG; of what is `exact` each pixel stays what it is or is left out; a `drawing` may lose
    colours.
    """

    pixels: Pixels
    note: str
    kind: Literal["photo", "exact", "drawing"] = "photo"


def finished(raster: Raster, bounds: Bounds) -> Picture:
    """The picture: at its own size if it keeps to the bounds so, else smaller.

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
    """File and MIME type: the first of the encodings for that kind that fits, else the last of them."""
    files = _encodings(image, kind)
    file = next(files)
    while len(file[0]) > max_bytes and (smaller := next(files, None)):
        file = smaller
    return file


def magnified(pixels: Pixels, max_side: int) -> tuple[Pixels, int]:
    """Small pixels drawn as larger squares, and how many times larger; 1 where they are large enough."""
    times = max(1, min(_MAGNIFIED_SIDE, max_side) // max(pixels.shape[:2]))
    return pixels.repeat(times, axis=0).repeat(times, axis=1), times


def _shrunk(image: Image.Image, whole: Image.Image) -> str:
    if image.size == whole.size:
        return ""
    return f" Shown at {image.width} × {image.height} pixels instead of {whole.width} × {whole.height}."


def _sizes(whole: Image.Image, max_side: int, kind: str) -> Iterator[Image.Image]:
    """The picture at its size if that is allowed, then ever smaller."""
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
