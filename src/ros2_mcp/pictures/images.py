"""Convert camera and depth images (sensor_msgs/msg/Image, CompressedImage) to 8-bit grey or RGB."""

from __future__ import annotations

import io
import struct
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image, UnidentifiedImageError

from ros2_mcp.model.errors import BadData
from ros2_mcp.model.pictures import Bounds, Picture
from ros2_mcp.model.text import named, quoted
from ros2_mcp.pictures.labels import label_raster
from ros2_mcp.pictures.raster import Pixels, Raster

_MAX_PIXELS = 64_000_000
"""Pixels of the largest compressed image that is unpacked: 192 MB as RGB. A file of a few kB may claim far more."""
_READ = ("JPEG", "PNG", "WEBP", "BMP", "TIFF")
_MIMES = {"JPEG": "image/jpeg", "PNG": "image/png"}
_DEPTH_HEADER = struct.Struct("<iff")  # format, and the two parameters of the quantisation


_Show = Callable[[NDArray[Any], str], Raster]


@dataclass(frozen=True, slots=True)
class _Layout:
    dtype: str
    channels: int
    show: _Show


def image_raster(message: Any, _: Bounds) -> Raster:
    """Convert an Image to pixels.

    Raises:
        BadData: for an encoding that cannot be shown, or data that does not fit width, height and step.
    """
    encoding: str = message.encoding
    if encoding in _NV:
        return _nv(message, _NV[encoding])
    layout = _LAYOUTS.get(encoding.lower()) or _LAYOUTS.get(encoding)
    if layout is None:
        raise BadData(
            f"Images with the encoding {quoted(encoding)} cannot be shown.",
            f"Known are {', '.join(_LAYOUTS)}, nv12, nv21.",
        )
    return layout.show(_rows(message, layout.dtype, layout.channels), encoding)


def may_be_depth(message: Any) -> bool:
    """Return whether an Image or CompressedImage declares the encoding of a depth image."""
    if hasattr(message, "format"):
        return "compressedDepth" in message.format or message.format.partition(";")[0].strip() in _DEPTHS
    return message.encoding in _DEPTHS


def depth_of(message: Any) -> NDArray[np.float64] | None:
    """Return the distances of a depth image along its optical axis in m, height × width; NaN where invalid.

    The image may be compressed. None if it is no depth image: another encoding, or 16-bit labels.

    Raises:
        BadData: if its data does not fit width, height and step, or is not a complete image.
    """
    if hasattr(message, "format"):
        if "compressedDepth" not in message.format:
            return _depth_in_file(message.format, message.data.tobytes())
        metres = _compressed_metres(message.format, message.data.tobytes())
        return np.where(np.isfinite(metres) & (metres > 0), metres, np.nan)
    if message.encoding not in _DEPTHS:
        return None
    dtype, metres_each = _DEPTHS[message.encoding]
    values = _rows(message, dtype, 1)[:, :, 0]
    if dtype == "u2" and label_raster(values, message.encoding) is not None:
        return None
    metres = values.astype(np.float64) * metres_each
    return np.where(np.isfinite(metres) & (metres > 0), metres, np.nan)


def _depth_in_file(described: str, data: bytes) -> NDArray[np.float64] | None:
    """Return the distances in a PNG or TIFF declared as a depth image; None for any other image."""
    raw = described.partition(";")[0].strip()
    if raw not in _DEPTHS or "jp" in described.partition(";")[2].lower():
        return None
    image = _opened(data, described)
    if image.mode not in ("F", "I", "I;16", "I;16B"):
        return None
    values = np.asarray(image)
    if raw == "16UC1" and label_raster(values, raw) is not None:
        return None
    metres = values.astype(np.float64) * (1.0 if image.mode == "F" else _DEPTHS[raw][1])
    return np.where(np.isfinite(metres) & (metres > 0), metres, np.nan)


def _depth_raster(metres: NDArray[Any], encoding: str) -> Raster:
    """Draw distances as grey: the nearest 2 % white, the farthest 2 % dark, invalid distances black.

    The 2 % at both ends are clipped, so that outliers do not use up the scale.
    """
    valid = np.isfinite(metres) & (metres > 0)
    share = 1 - float(np.count_nonzero(valid)) / metres.size
    pixels = np.zeros(metres.shape, np.uint8)
    if share == 1:
        return Raster(pixels, f"Depth ({named(encoding)}): no valid distance.", kind="exact")
    distances = metres[valid]
    near, far = (float(bound) for bound in np.percentile(distances, (2, 98)))
    scaled = (np.minimum(np.maximum(distances, near), far) - near) / max(far - near, 1e-9)
    pixels[valid] = np.rint(255 - 205 * scaled).astype(np.uint8)
    note = (
        f"Depth ({named(encoding)}): {distances.min():.3f} m to {distances.max():.3f} m; "
        f"white is {near:.3f} m or nearer, dark grey {far:.3f} m or farther, black invalid ({share:.1%})."
    )
    return Raster(pixels, note, kind="exact")


def _labels_or(show: Callable[[NDArray[Any], str], Raster], *, any_value: bool = False) -> _Show:
    """Return a function that draws labels if the values look like labels, else calls `show` with the channel."""

    def shown(pixels: NDArray[Any], encoding: str) -> Raster:
        plane = pixels[:, :, 0]
        return label_raster(plane, encoding, any_value=any_value) or show(plane, encoding)

    return shown


def _stretched(values: NDArray[Any], encoding: str) -> Raster:
    """Stretch grey values of more than eight bits from their minimum to their maximum."""
    low, high = int(values.min()), int(values.max())
    pixels = np.rint((values.astype(np.float64) - low) * (255 / max(high - low, 1))).astype(np.uint8)
    return Raster(pixels, f"{named(encoding)}: black is {low}, white is {high}.")


def _rows(message: Any, dtype: str, channels: int, rows: int = 0) -> NDArray[Any]:
    """Return the data as rows × width × channels, without the padding at the end of each row."""
    kind: np.dtype[Any] = np.dtype((">" if message.is_bigendian else "<") + dtype)
    width, height = message.width, rows or message.height
    row = width * channels * kind.itemsize
    step = message.step or row
    if not row or not height:
        raise BadData(f"The image is empty: {width} × {message.height} pixels.")
    if step < row:
        raise BadData(f"A row of {width} pixels ({message.encoding}) needs {row} bytes, but step is {step}.")
    if len(message.data) < step * (height - 1) + row:
        raise BadData(
            f"data has {len(message.data)} bytes, but step × height is {step} × {height} = {step * height} "
            f"({message.encoding}, {width} × {message.height} pixels)."
        )
    offsets = (step, channels * kind.itemsize, kind.itemsize)
    return np.ndarray((height, width, channels), kind, np.ascontiguousarray(message.data), 0, offsets)


def _grey(plane: NDArray[Any], encoding: str) -> Raster:
    return Raster(np.ascontiguousarray(plane), f"{encoding}.")


def _colour(*order: int) -> Callable[[NDArray[Any], str], Raster]:
    """Return a function that draws RGB; `order` are the indices of red, green and blue in a pixel."""

    def show(pixels: NDArray[Any], encoding: str) -> Raster:
        dropped = " without its alpha" if pixels.shape[2] == 4 else ""
        in_order = order == tuple(range(pixels.shape[2]))  # each copy costs a tenth of the JPEG encoding
        return Raster(_to_8_bit(pixels if in_order else np.take(pixels, order, axis=2)), f"{encoding}{dropped}.")

    return show


def _bayer(red: int, blue: int) -> Callable[[NDArray[Any], str], Raster]:
    """Return a function that merges each 2 × 2 Bayer square; `red` and `blue` are their indices in it, row by row."""

    def show(pixels: NDArray[Any], encoding: str) -> Raster:
        plane = _to_8_bit(pixels[:, :, 0])
        height, width = (side // 2 * 2 for side in plane.shape)
        if not height or not width:
            raise BadData(f"A Bayer image of {plane.shape[1]} × {plane.shape[0]} pixels has no full square.")
        square = [plane[row:height:2, column:width:2] for row in (0, 1) for column in (0, 1)]
        one, other = (square[place].astype(np.uint16) for place in range(4) if place not in (red, blue))
        green = ((one + other) // 2).astype(np.uint8)
        return Raster(
            np.dstack((square[red], green, square[blue])), f"{named(encoding)}, at half its size, simply demosaiced."
        )

    return show


def _yuv_422(luma: int) -> Callable[[NDArray[Any], str], Raster]:
    """Return a function for YUV 4:2:2: two bytes per pixel, luma at index `luma`, chroma of two pixels in the other."""

    def show(pixels: NDArray[Any], encoding: str) -> Raster:
        width = pixels.shape[1] // 2 * 2
        chroma = pixels[:, :width, 1 - luma]
        u, v = (np.repeat(chroma[:, start::2], 2, axis=1) for start in (0, 1))
        return Raster(_yuv_to_rgb(pixels[:, :width, luma], u, v), f"{encoding}.")

    return show


def _nv(message: Any, order: tuple[int, int]) -> Raster:
    """Convert NV12 or NV21: a plane of luma, then interleaved chroma at half the size."""
    height, width = message.height // 2 * 2, message.width // 2 * 2
    planes = _rows(message, "u1", 1, rows=message.height + (message.height + 1) // 2)[:, :width, 0]
    chroma = planes[message.height :][: height // 2]
    u, v = (chroma[:, place::2].repeat(2, axis=0).repeat(2, axis=1) for place in order)
    return Raster(_yuv_to_rgb(planes[:height], u, v), f"{message.encoding}.")


def _yuv_to_rgb(y: NDArray[Any], u: NDArray[Any], v: NDArray[Any]) -> Pixels:
    luma = (y.astype(np.float32) - 16) * 1.164
    blue, red = u.astype(np.float32) - 128, v.astype(np.float32) - 128
    rgb = np.dstack((luma + 1.596 * red, luma - 0.392 * blue - 0.813 * red, luma + 2.017 * blue))
    return np.minimum(np.maximum(np.rint(rgb), 0), 255).astype(np.uint8)


def _to_8_bit(pixels: NDArray[Any]) -> Pixels:
    return pixels.astype(np.uint8, copy=False) if pixels.itemsize == 1 else (pixels >> 8).astype(np.uint8)


# ── compressed images ────────────────────────────────────────────────────────────────────────────────────────────


def compressed_raster(message: Any, bounds: Bounds) -> Raster | Picture:
    """Convert a sensor_msgs/msg/CompressedImage; return the original file if it is within the bounds.

    Raises:
        BadData: if it is not a complete image in a format that can be shown.
    """
    described: str = message.format
    data = message.data.tobytes()
    if "compressedDepth" in described:
        return _compressed_depth(described, data)
    image = _opened(data, described)
    note = f"{named(described) if described else image.format}."
    raw = described.partition(";")[0].strip()
    if image.mode == "F":  # only TIFF has floating-point pixels
        values = np.asarray(image).astype(np.float64)
        return _depth_raster(values, raw) if raw in _DEPTHS else _stretched_floats(values, raw or "32FC1")
    if raw in _WIDE and image.mode in ("L", "RGB"):
        note = f"{note} {_lost(raw, image.format)}"
    if image.mode.startswith("I"):  # grey of more than eight bits
        values = np.asarray(image)
        if labels := label_raster(values, raw or "16 bit grey"):
            return labels
        if raw == "16UC1":
            return _depth_raster(values / 1000, raw)
        return _stretched(values, raw or "16 bit grey")
    labels = label_raster(np.asarray(image), named(described)) if (image.format, image.mode) == ("PNG", "L") else None
    if labels is not None:
        return labels
    if image.format in _MIMES and max(image.size) <= bounds.max_side and len(data) <= bounds.max_bytes:
        return Picture(data, _MIMES[image.format], *image.size, f"{note} As the robot sent it.")
    return Raster(np.asarray(image if image.mode in ("L", "RGB") else image.convert("RGB")), note)


def _lost(raw: str, file_format: str | None) -> str:
    """Describe the loss if a raw type of more than eight bits was put into an 8-bit file."""
    what = "distances are lost" if raw in _DEPTHS else "values are lost"
    right = "compressedDepth, or png" if raw in _DEPTHS else "png"
    return f"{raw} in {file_format} of 8 bits: its {what}, brightness is none. The publisher has to send {right}."


def _stretched_floats(values: NDArray[Any], encoding: str) -> Raster:
    """Stretch floating-point grey values from their minimum to their maximum."""
    finite = values[np.isfinite(values)]
    if not len(finite):
        return Raster(np.zeros(values.shape, np.uint8), f"{named(encoding)}: no finite value.")
    low, high = float(finite.min()), float(finite.max())
    scaled = (np.nan_to_num(values, nan=low, posinf=high, neginf=low) - low) / max(high - low, 1e-9)
    return Raster(np.rint(scaled * 255).astype(np.uint8), f"{named(encoding)}: black is {low:g}, white is {high:g}.")


def _unreadable(data: bytes, described: str) -> BadData:
    """Return the error for bytes that are not an image; the library's own errors would not help."""
    words = described.lower()
    if not data:
        return BadData(f"0 bytes with the format {quoted(described)} are not a whole picture: it is empty.", _FORMATS)
    codec = next((name for sign, name in _VIDEO.items() if sign in words), "")
    if codec or data.startswith(_ANNEX_B):
        what = f"{codec or 'H.264 or H.265'} is a video: a message alone is not a whole picture"
        return BadData(f"{what} ({len(data)} bytes, format {quoted(described)}).", _VIDEO_HINT)
    is_begun = any(data.startswith(start) for start in _STARTS)
    why = "they are damaged, or end too early" if is_begun else "they begin as none does"
    return BadData(f"{len(data)} bytes with the format {quoted(described)} are not a whole picture: {why}.", _FORMATS)


_FORMATS = f"Formats that can be shown are {', '.join(_READ)}."
_VIDEO = {
    "h264": "H.264",
    "h.264": "H.264",
    "avc": "H.264",
    "h265": "H.265",
    "hevc": "H.265",
    "av1": "AV1",
    "vp9": "VP9",
    "vp8": "VP8",
    "theora": "Theora",
    "ffmpeg": "ffmpeg's stream",
    "x264": "H.264",
}
"""Words in `format` that mean video."""
_VIDEO_HINT = "Read the raw image, or let the publisher offer compressed pictures (jpeg, png), too."
_ANNEX_B = (b"\0\0\0\1", b"\0\0\1")
"""The first bytes of an H.264 or H.265 stream."""
_STARTS = (b"\xff\xd8", b"\x89PNG", b"RIFF", b"BM", b"II*\0", b"MM\0*")


def _opened(data: bytes, described: str) -> Image.Image:
    """Decode the image in a file's bytes completely."""
    try:
        image = Image.open(io.BytesIO(data), formats=_READ)
        if image.width * image.height > _MAX_PIXELS:
            raise BadData(f"The picture is too large to show: {image.width} × {image.height} pixels.")
        image.load()
    except Image.DecompressionBombError as error:
        raise BadData("The picture is too large to show.") from error
    except (UnidentifiedImageError, OSError, SyntaxError, ValueError, struct.error) as error:
        raise _unreadable(data, described) from error
    return image


def _compressed_depth(described: str, data: bytes) -> Raster:
    """Draw a message of image_transport's compressed_depth."""
    return _depth_raster(_compressed_metres(described, data), described.partition(";")[0].strip())


def _compressed_metres(described: str, data: bytes) -> NDArray[np.float64]:
    """Return the distances in m, height × width, from a header of twelve bytes and a 16-bit PNG."""
    if "rvl" in described.lower():
        raise BadData("Depth pictures compressed with RVL cannot be shown.", "Set the publisher's format to png.")
    if len(data) <= _DEPTH_HEADER.size:
        raise BadData(f"A compressed depth picture of {len(data)} bytes is incomplete.")
    _, scale, offset = _DEPTH_HEADER.unpack_from(data)
    values = np.asarray(_opened(data[_DEPTH_HEADER.size :], described)).astype(np.float64)
    if described.partition(";")[0].strip() != "32FC1":
        return values / 1000
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.where(values > 0, scale / (values - offset), np.nan)


# ── encodings of images ──────────────────────────────────────────────────────────────────────────────────────────

_DEPTHS = {"32FC1": ("f4", 1.0), "16UC1": ("u2", 0.001)}
"""Encodings of depth images by REP 118: type of a number, and metres per unit."""
_WIDE = (*_DEPTHS, "mono16", "16SC1", "32SC1")
"""Raw types whose values are lost in an 8-bit file."""
_BAYER = {"rggb": (0, 3), "bggr": (3, 0), "gbrg": (2, 1), "grbg": (1, 2)}
_NV = {"nv12": (0, 1), "nv21": (1, 0)}
_LAYOUTS: Mapping[str, _Layout] = {
    "rgb8": _Layout("u1", 3, _colour(0, 1, 2)),
    "rgba8": _Layout("u1", 4, _colour(0, 1, 2)),
    "bgr8": _Layout("u1", 3, _colour(2, 1, 0)),
    "bgra8": _Layout("u1", 4, _colour(2, 1, 0)),
    "rgb16": _Layout("u2", 3, _colour(0, 1, 2)),
    "bgr16": _Layout("u2", 3, _colour(2, 1, 0)),
    "8UC3": _Layout("u1", 3, _colour(2, 1, 0)),
    "8UC4": _Layout("u1", 4, _colour(2, 1, 0)),
    "mono8": _Layout("u1", 1, _labels_or(_grey)),
    "8UC1": _Layout("u1", 1, _labels_or(_grey)),
    "mono16": _Layout("u2", 1, _labels_or(_stretched)),
    "16UC1": _Layout(
        "u2", 1, _labels_or(lambda plane, encoding: _depth_raster(plane.astype(np.float32) / 1000, encoding))
    ),
    "8SC1": _Layout("i1", 1, _labels_or(_stretched, any_value=True)),
    "16SC1": _Layout("i2", 1, _labels_or(_stretched, any_value=True)),
    "32SC1": _Layout("i4", 1, _labels_or(_stretched, any_value=True)),
    "32FC1": _Layout("f4", 1, lambda pixels, encoding: _depth_raster(pixels[:, :, 0].astype(np.float64), encoding)),
    "yuv422": _Layout("u1", 2, _yuv_422(1)),
    "uyvy": _Layout("u1", 2, _yuv_422(1)),
    "yuv422_yuy2": _Layout("u1", 2, _yuv_422(0)),
    "yuyv": _Layout("u1", 2, _yuv_422(0)),
    **{f"bayer_{name}8": _Layout("u1", 1, _bayer(*places)) for name, places in _BAYER.items()},
    **{f"bayer_{name}16": _Layout("u2", 1, _bayer(*places)) for name, places in _BAYER.items()},
}
