"""Points seen from above: x to the right, y up, the highest point of each pixel on top."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from ros2_mcp.codec.clouds import Cloud
from ros2_mcp.codec.raster import encoded, magnified
from ros2_mcp.model.errors import BadData
from ros2_mcp.model.pictures import BirdEyeOptions, Picture

_COARSER = 1.1
"""By how much at least, where a picture has too many bytes; mostly their square root says it at once."""


@dataclass(frozen=True, slots=True)
class BirdEye:
    """The picture and what it shows: pixel (column, row) begins at (x_min + column · m, y_max - row · m), where m is
    `metres_per_pixel`. `low` and `high` are the values at the ends of the colours; None for `rgb`."""

    picture: Picture
    shown: int
    resolution_m: float
    metres_per_pixel: float
    x_min_m: float
    x_max_m: float
    y_min_m: float
    y_max_m: float
    z_min_m: float
    z_max_m: float
    color_mode: str
    low: float | None
    high: float | None
    note: str


@dataclass(frozen=True, slots=True)
class _Coloured:
    rgb: NDArray[np.uint8]
    mode: str
    low: float | None = None
    high: float | None = None
    note: str = ""


def bird_eye(cloud: Cloud, options: BirdEyeOptions) -> BirdEye:
    """The cloud from above. The resolution is made coarser where the picture would be too large.

    Raises:
        BadData: if no point is left to show.
    """
    kept = _within(cloud, options)
    if not kept.any():
        raise BadData(
            f"No point to show: of {cloud.points} points, {cloud.not_finite} are not finite and the others are outside "
            "the heights asked for."
        )
    xyz = cloud.xyz[kept]
    coloured = _coloured(cloud, kept, options)
    max_bytes = options.bounds.max_bytes
    resolution = max(options.resolution_m, _finest(xyz, options.bounds.max_side))
    while True:
        cells, left, top = _pixels(xyz, coloured.rgb, resolution)
        pixels, times = magnified(cells, options.bounds.max_side)
        image = Image.fromarray(pixels)
        data, _ = encoded(image, "exact", max_bytes)
        if len(data) <= max_bytes:
            break
        resolution *= max(_COARSER, math.sqrt(len(data) / max_bytes))
    return _described(xyz, coloured, options, image, data, (left, top, resolution, resolution / times))


def _described(
    xyz: NDArray[np.float64],
    coloured: _Coloured,
    options: BirdEyeOptions,
    image: Image.Image,
    data: bytes,
    scale: tuple[float, float, float, float],
) -> BirdEye:
    left, top, resolution, pixel_m = scale
    coarser = (
        f"The resolution is {resolution:.4g} m instead of {options.resolution_m:.4g} m, to fit the picture."
        if resolution > options.resolution_m
        else ""
    )
    colours = "" if coloured.low is None else f", {coloured.low:.4g} ({_names(options)[0]}) to {coloured.high:.4g} "
    colours += f"({_names(options)[1]})" if colours else ""
    note = (
        f"From above, x to the right, y up, {pixel_m:.4g} m per pixel; "
        f"{image.width * pixel_m:.4g} m × {image.height * pixel_m:.4g} m. Colour: {coloured.mode}{colours}."
    )
    low, high = xyz[:, 2].min(), xyz[:, 2].max()
    return BirdEye(
        Picture(data, "image/png", image.width, image.height, note),
        len(xyz),
        resolution,
        pixel_m,
        left,
        left + image.width * pixel_m,
        top - image.height * pixel_m,
        top,
        float(low),
        float(high),
        coloured.mode,
        coloured.low,
        coloured.high,
        f"{coarser} {coloured.note}".strip(),
    )


def _names(options: BirdEyeOptions) -> tuple[str, str]:
    return ("blue", "red") if options.colormap == "jet" else ("dark", "white")


def _within(cloud: Cloud, options: BirdEyeOptions) -> NDArray[np.bool_]:
    z = cloud.xyz[:, 2]
    low = -math.inf if options.z_min_m is None else options.z_min_m
    high = math.inf if options.z_max_m is None else options.z_max_m
    return (z >= low) & (z <= high)


def _finest(xyz: NDArray[np.float64], max_side: int) -> float:
    """The resolution at which the cloud just fits, two significant digits rounded up."""
    needed = float(np.ptp(xyz[:, :2], axis=0).max()) / (max_side - 2)
    if not needed:
        return 0.0
    digit = 10.0 ** (math.floor(math.log10(needed)) - 1)
    return math.ceil(needed / digit) * digit


def _pixels(
    xyz: NDArray[np.float64], rgb: NDArray[np.uint8], resolution: float
) -> tuple[NDArray[np.uint8], float, float]:
    """The picture, and x and y of its upper left corner, which are whole multiples of the resolution."""
    cells = np.floor(xyz[:, :2] / resolution).astype(np.int64)
    left, lowest = cells.min(axis=0)
    right, highest = cells.max(axis=0)
    pixels = np.zeros((highest - lowest + 1, right - left + 1, 3), np.uint8)
    upwards = np.argsort(xyz[:, 2], kind="stable")
    pixels[highest - cells[upwards, 1], cells[upwards, 0] - left] = rgb[upwards]
    return pixels, float(left * resolution), float((highest + 1) * resolution)


# ── colours ──────────────────────────────────────────────────────────────────────────────────────────────────────


def _coloured(cloud: Cloud, kept: NDArray[np.bool_], options: BirdEyeOptions) -> _Coloured:
    """The colour of each point; by height where the cloud has not what was asked for."""
    if options.color_mode == "rgb" and cloud.rgb is not None:
        return _Coloured(np.maximum(cloud.rgb[kept], 24), "rgb")
    values, mode = cloud.xyz[kept, 2], "height"
    if options.color_mode == "intensity" and cloud.intensity is not None:
        values, mode = cloud.intensity[kept], "intensity"
    note = "" if mode == options.color_mode else f"The cloud has no {options.color_mode}; colours show the height."
    finite = values[np.isfinite(values)]
    low, high = (float(bound) for bound in np.percentile(finite, (2, 98))) if len(finite) else (0.0, 0.0)
    share = np.nan_to_num((values - low) / (high - low), nan=0.0) if high > low else np.full(len(values), 0.5)
    scaled = np.minimum(np.maximum(share, 0.0), 1.0)
    return _Coloured(_jet(scaled) if options.colormap == "jet" else _gray(scaled), mode, low, high, note)


def _jet(share: NDArray[np.float64]) -> NDArray[np.uint8]:
    """Blue, cyan, green, yellow, red; without the dark ends, which would be hard to see."""
    parts = [1.5 - np.abs(0.5 + 3 * share - centre) for centre in (3, 2, 1)]
    return np.rint(255 * np.minimum(np.maximum(np.stack(parts, axis=1), 0), 1)).astype(np.uint8)


def _gray(share: NDArray[np.float64]) -> NDArray[np.uint8]:
    shades = np.rint(255 * (0.2 + 0.8 * share)).astype(np.uint8)
    return np.stack([shades] * 3, axis=1)
