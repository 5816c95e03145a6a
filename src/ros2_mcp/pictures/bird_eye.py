"""Draw points from above: x to the right, y up, the highest point of each pixel on top."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from ros2_mcp.model.errors import BadData
from ros2_mcp.model.pictures import BirdEyeOptions, Picture, Place
from ros2_mcp.model.text import counted
from ros2_mcp.pictures.ground import ROOM_PX, Framed, Ground, has_axes, marks_in_words, with_axes
from ros2_mcp.pictures.raster import encoded, magnified
from ros2_mcp.world.clouds import Cloud

_COARSER = 1.1
"""The least factor by which the resolution is made coarser if a picture has too many bytes. The square root of the
excess usually fits at once, because bytes grow with the area."""

_DARKEST = 24
"""Least brightness of a point, so that a black point differs from the black background."""

_CORE = (0.05, 0.95)
"""Quantiles of x and y that bound the core of a cloud, which may have a tenth of outliers."""
_BEYOND = 3
"""Points farther from the core than this many times its extent are outliers, such as reflections, which would shrink
the rest of the picture to a few pixels. Lidars sample near surfaces more densely, so far walls are no outliers."""
_FEW = 20
"""Number of points below which quantiles are not meaningful."""


@dataclass(frozen=True, slots=True, kw_only=True)
class BirdEyeNumbers:
    """Scale, extent and colours of a picture in numbers.

    Pixel (left_px + column, top_px + row) has its corner at (x_min + column · m, y_max - row · m), where m is
    `metres_per_pixel`; pixels outside of that area are axes. `color_low` and `color_high` are the values at the ends of
    the colour scale; None for `rgb`.
    """

    shown: int
    resolution_m: float
    metres_per_pixel: float
    left_px: int
    top_px: int
    x_min_m: float
    x_max_m: float
    y_min_m: float
    y_max_m: float
    z_min_m: float
    z_max_m: float
    color_mode: str
    color_low: float | None
    color_high: float | None
    note: str


@dataclass(frozen=True, slots=True)
class BirdEye:
    """A picture from above, and what it shows in numbers."""

    picture: Picture
    numbers: BirdEyeNumbers


@dataclass(frozen=True, slots=True)
class _Coloured:
    rgb: NDArray[np.uint8]
    mode: str
    low: float | None = None
    high: float | None = None
    note: str = ""


def bird_eye(cloud: Cloud, options: BirdEyeOptions, robot: Place | None = None) -> BirdEye:
    """Draw a cloud from above, with axes and the robot (a place in the cloud's frame).

    The resolution is made coarser if the picture would be too large.

    Raises:
        BadData: if there is no point to show.
    """
    kept, far = _kept(cloud, options)
    xyz = cloud.xyz[kept]
    coloured = _coloured(cloud, kept, options)
    max_bytes, max_side = options.bounds.max_bytes, options.bounds.max_side
    side = max_side - ROOM_PX if has_axes(max_side) else max_side
    resolution = max(options.resolution_m, _finest(xyz, side))
    while True:
        cells, left, top = _pixels(xyz, coloured.rgb, resolution)
        pixels, times = magnified(cells, side)
        ground = Ground(left, top - len(cells) * resolution, resolution / times, Place(0, 0), robot)
        framed = with_axes(pixels, ground) if has_axes(max_side) else Framed(pixels, 0, 0)
        image = Image.fromarray(framed.pixels)
        data, _ = encoded(image, "exact", max_bytes)
        if len(data) <= max_bytes:
            break
        resolution *= max(_COARSER, math.sqrt(len(data) / max_bytes))
    pixel_m = resolution / times
    width_m, height_m = pixels.shape[1] * pixel_m, pixels.shape[0] * pixel_m
    colours = ""
    if coloured.low is not None:
        low, high = ("blue", "red") if options.colormap == "jet" else ("dark", "white")
        colours = f", {coloured.low:.4g} ({low}) to {coloured.high:.4g} ({high})"
    note = (
        f"From above, x to the right, y up, {pixel_m:.4g} m per pixel; {width_m:.4g} m × {height_m:.4g} m. "
        f"Colour: {coloured.mode}{colours}."
    )
    if has_axes(max_side):
        note += f" {marks_in_words(ground)}"
    coarser = f"The resolution is {resolution:.4g} m instead of {options.resolution_m:.4g} m, to fit the picture."
    numbers = BirdEyeNumbers(
        shown=len(xyz),
        resolution_m=resolution,
        metres_per_pixel=pixel_m,
        left_px=framed.left_px,
        top_px=framed.top_px,
        x_min_m=left,
        x_max_m=left + width_m,
        y_min_m=top - height_m,
        y_max_m=top,
        z_min_m=float(xyz[:, 2].min()),
        z_max_m=float(xyz[:, 2].max()),
        color_mode=coloured.mode,
        color_low=coloured.low,
        color_high=coloured.high,
        note=f"{far} {coarser if resolution > options.resolution_m else ''} {coloured.note}".strip(),
    )
    return BirdEye(Picture(data, "image/png", image.width, image.height, note), numbers)


def _kept(cloud: Cloud, options: BirdEyeOptions) -> tuple[NDArray[np.bool_], str]:
    """Return which points to show: the points within the limits, without outliers; and a note if there are outliers.

    Raises:
        BadData: if there is no such point.
    """
    limits = (
        (options.x_min_m, options.x_max_m),
        (options.y_min_m, options.y_max_m),
        (options.z_min_m, options.z_max_m),
    )
    kept: NDArray[np.bool_] = np.ones(len(cloud.xyz), np.bool_)
    for axis, (low, high) in enumerate(limits):
        kept &= cloud.xyz[:, axis] >= (-math.inf if low is None else low)
        kept &= cloud.xyz[:, axis] <= (math.inf if high is None else high)
    if not kept.any():
        raise BadData(
            f"No point to show: of {cloud.points} points, {cloud.not_finite} are not finite and the others are outside "
            "the limits asked for."
        )
    extent = _extent(cloud.xyz[kept, :2])
    within = kept & True
    for axis in (0, 1):
        if limits[axis] == (None, None) and extent is not None:
            within &= (cloud.xyz[:, axis] >= extent[0][axis]) & (cloud.xyz[:, axis] <= extent[1][axis])
    far = int(np.count_nonzero(kept & ~within))
    note = (
        f"Not shown: {counted(far, 'point')} far from the others; give xmin, xmax, ymin, ymax to show them."
        if far
        else ""
    )
    return within, note


def _extent(xy: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]] | None:
    """Return the lower and upper bounds of x and y without outliers; None if they cannot be determined."""
    if len(xy) < _FEW:
        return None
    low, high = np.quantile(xy, _CORE[0], axis=0, method="higher"), np.quantile(xy, _CORE[1], axis=0, method="lower")
    beyond = _BEYOND * float((high - low).max())
    return (low - beyond, high + beyond) if beyond > 0 else None


def _finest(xyz: NDArray[np.float64], max_side: int) -> float:
    """Return the resolution in m at which the cloud just fits, rounded up to two significant digits."""
    needed = float(np.ptp(xyz[:, :2], axis=0).max()) / (max_side - 2)
    if not needed:
        return 0.0
    digit = 10.0 ** (math.floor(math.log10(needed)) - 1)
    return math.ceil(needed / digit) * digit


def _pixels(
    xyz: NDArray[np.float64], rgb: NDArray[np.uint8], resolution: float
) -> tuple[NDArray[np.uint8], float, float]:
    """Return the picture, and x and y of its upper left corner, which are multiples of the resolution."""
    cells = np.floor(xyz[:, :2] / resolution).astype(np.int64)
    left, lowest = cells.min(axis=0)
    right, highest = cells.max(axis=0)
    pixels = np.zeros((highest - lowest + 1, right - left + 1, 3), np.uint8)
    upwards = np.argsort(xyz[:, 2], kind="stable")
    pixels[highest - cells[upwards, 1], cells[upwards, 0] - left] = rgb[upwards]
    return pixels, float(left * resolution), float((highest + 1) * resolution)


# ── colours ──────────────────────────────────────────────────────────────────────────────────────────────────────


def _coloured(cloud: Cloud, kept: NDArray[np.bool_], options: BirdEyeOptions) -> _Coloured:
    """Return the colour of each point; by height if the cloud lacks the requested field."""
    if options.color_mode == "rgb" and cloud.rgb is not None:
        return _Coloured(np.maximum(cloud.rgb[kept], _DARKEST), "rgb")
    values, mode = cloud.xyz[kept, 2], "height"
    if options.color_mode == "intensity" and cloud.intensity is not None:
        values, mode = cloud.intensity[kept], "intensity"
    note = "" if mode == options.color_mode else f"The cloud has no {options.color_mode}; colours show the height."
    finite = values[np.isfinite(values)]
    # Without 2 % at both ends, so that outliers do not use up the colour scale.
    low, high = (float(bound) for bound in np.percentile(finite, (2, 98))) if len(finite) else (0.0, 0.0)
    share = np.nan_to_num((values - low) / (high - low), nan=0.0) if high > low else np.full(len(values), 0.5)
    scaled = np.minimum(np.maximum(share, 0.0), 1.0)
    return _Coloured(_jet(scaled) if options.colormap == "jet" else _gray(scaled), mode, low, high, note)


def _jet(share: NDArray[np.float64]) -> NDArray[np.uint8]:
    """Map 0 to 1 to blue, cyan, green, yellow, red; without the dark ends, which would be hard to see."""
    parts = [1.5 - np.abs(0.5 + 3 * share - centre) for centre in (3, 2, 1)]
    return np.rint(255 * np.minimum(np.maximum(np.stack(parts, axis=1), 0), 1)).astype(np.uint8)


def _gray(share: NDArray[np.float64]) -> NDArray[np.uint8]:
    shades = np.rint(255 * (0.2 + 0.8 * share)).astype(np.uint8)
    return np.stack([shades] * 3, axis=1)
