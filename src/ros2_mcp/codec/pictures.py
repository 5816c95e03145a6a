"""Messages that are pictures → PNG or JPEG, bounded in size, with a note that says what they show."""

from __future__ import annotations

import io
import struct
from collections.abc import Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image, UnidentifiedImageError

from ros2_mcp.codec.maps import map_raster
from ros2_mcp.codec.raster import Raster, depth_raster, raster_of, stretched
from ros2_mcp.model.errors import BadData, BadValue
from ros2_mcp.model.pictures import Picture

IMAGE = "sensor_msgs/msg/Image"
COMPRESSED_IMAGE = "sensor_msgs/msg/CompressedImage"
OCCUPANCY_GRID = "nav_msgs/msg/OccupancyGrid"
PICTURE_TYPES = frozenset({IMAGE, COMPRESSED_IMAGE, OCCUPANCY_GRID})

_MAX_PIXELS = 64_000_000
_SMALLEST_SIDE = 16
_SMALL_PIXELS = 160 * 120
_QUALITIES = (85, 70, 50)
_READ = ("JPEG", "PNG", "WEBP", "BMP", "TIFF")
_MIMES = {"JPEG": "image/jpeg", "PNG": "image/png"}
_DEPTH_HEADER = struct.Struct("<iff")


def picture_of(type_name: str, message: Any, *, max_side: int = 1568, max_bytes: int = 700_000) -> Picture:
    """The picture that a message carries, no side longer than `max_side` pixels, no more than `max_bytes` bytes.

    Raises:
        BadData: if the message is not a proper picture, naming what does not fit.
        BadValue: for a type that is no picture.
    """
    if type_name == IMAGE:
        return _encoded(raster_of(message), max_side, max_bytes)
    if type_name == OCCUPANCY_GRID:
        return _encoded(map_raster(message, max_side), max_side, max_bytes)
    if type_name == COMPRESSED_IMAGE:
        return _compressed(message, max_side, max_bytes)
    raise BadValue("", f"{type_name} is not a picture.", f"Pictures are {', '.join(sorted(PICTURE_TYPES))}.")


def _compressed(message: Any, max_side: int, max_bytes: int) -> Picture:
    described: str = message.format
    data = message.data.tobytes()
    if "compressedDepth" in described:
        return _encoded(_compressed_depth(described, data), max_side, max_bytes)
    image = _opened(data, described)
    note = f"{described or image.format}."
    if image.mode.startswith("I"):
        return _encoded(_deep_grey(image, described), max_side, max_bytes)
    if image.format in _MIMES and max(image.size) <= max_side and len(data) <= max_bytes:
        return Picture(data, _MIMES[image.format], *image.size, f"{note} As the robot sent it.")
    return _encoded(Raster(np.asarray(_plain(image)), note), max_side, max_bytes)


def _opened(data: bytes, described: str) -> Image.Image:
    """The picture in a file's bytes, completely read."""
    try:
        image = Image.open(io.BytesIO(data), formats=_READ)
        if image.width * image.height > _MAX_PIXELS:
            raise BadData(f"The picture has {image.width} × {image.height} pixels, too many to show.")
        image.load()
    except (UnidentifiedImageError, OSError, SyntaxError, ValueError, Image.DecompressionBombError) as error:
        raise BadData(
            f"{len(data)} bytes with the format {described[:60]!r} are not a whole picture: {str(error)[:120]}.",
            f"Formats that can be shown are {', '.join(_READ)}.",
        ) from error
    return image


def _compressed_depth(described: str, data: bytes) -> Raster:
    """What image_transport's compressed_depth sends: twelve bytes of header, then a PNG of 16 bits."""
    encoding = described.partition(";")[0].strip()
    if "rvl" in described.lower():
        raise BadData("Depth pictures compressed with RVL cannot be shown.", "Set the publisher's format to png.")
    if len(data) <= _DEPTH_HEADER.size:
        raise BadData(f"{len(data)} bytes are too few for a compressed depth picture.")
    _, scale, offset = _DEPTH_HEADER.unpack_from(data)
    values = np.asarray(_opened(data[_DEPTH_HEADER.size :], described)).astype(np.float64)
    return depth_raster(_metres(encoding, values, scale, offset), encoding)


def _metres(encoding: str, values: NDArray[Any], scale: float, offset: float) -> NDArray[Any]:
    if encoding != "32FC1":
        return values / 1000
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.where(values > 0, scale / (values - offset), np.nan)


def _deep_grey(image: Image.Image, described: str) -> Raster:
    values = np.asarray(image)
    encoding = described.partition(";")[0].strip()
    return (
        depth_raster(values / 1000, encoding) if encoding == "16UC1" else stretched(values, encoding or "16 bit grey")
    )


def _plain(image: Image.Image) -> Image.Image:
    return image if image.mode in ("L", "RGB") else image.convert("RGB")


def _encoded(raster: Raster, max_side: int, max_bytes: int) -> Picture:
    """The first of ever smaller encodings that fits; photographs as JPEG, what must stay exact as PNG."""
    whole = Image.fromarray(raster.pixels)
    for image in _sizes(whole, max_side, raster.is_photo):
        for data, mime in _encodings(image, raster.is_photo):
            if len(data) <= max_bytes:
                return Picture(data, mime, *image.size, raster.note + _shrunk(image, whole))
    raise BadData(f"The picture does not fit into {max_bytes} bytes at any size.")


def _shrunk(image: Image.Image, whole: Image.Image) -> str:
    if image.size == whole.size:
        return ""
    return f" Shown at {image.width} × {image.height} pixels instead of {whole.width} × {whole.height}."


def _sizes(whole: Image.Image, max_side: int, smooth: bool) -> Iterator[Image.Image]:
    """The picture at its size if that is allowed, then ever smaller."""
    side = max(whole.size)
    if side <= max_side:
        yield whole
        side = side * 3 // 4
    side = min(side, max_side)
    while side >= _SMALLEST_SIDE:
        yield _resized(whole, side / max(whole.size), smooth)
        side = side * 3 // 4


def _resized(whole: Image.Image, factor: float, smooth: bool) -> Image.Image:
    size = (max(1, round(whole.width * factor)), max(1, round(whole.height * factor)))
    if smooth:
        return whole.resize(size, Image.Resampling.BILINEAR, reducing_gap=2.0)
    return whole.resize(size, Image.Resampling.NEAREST)


def _encodings(image: Image.Image, is_photo: bool) -> Iterator[tuple[bytes, str]]:
    if not is_photo or image.width * image.height <= _SMALL_PIXELS:
        yield _saved(image, "PNG", compress_level=6), "image/png"
        if not is_photo:
            return
    for quality in _QUALITIES:
        yield _saved(image, "JPEG", quality=quality), "image/jpeg"


def _saved(image: Image.Image, file_format: str, **options: int) -> bytes:
    buffer = io.BytesIO()
    image.save(buffer, file_format, **options)
    return buffer.getvalue()
