"""Interpretation of a sensor's message in a few numbers and in words: near obstacles, and free directions."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field

from ros2_mcp.model.text import named

SECTORS = ("front", "front left", "left", "rear left", "rear", "rear right", "right", "front right")
"""Sectors of 45° each, from x towards y; the front is from -22.5° to 22.5°."""
SECTOR_RAD = 2 * math.pi / len(SECTORS)
_ON_REQUEST = {"on_request": True}
"""As in `ops/results/results.py`: a field that is omitted if it is None."""


@dataclass(frozen=True, slots=True, kw_only=True)
class ScanMeaning:
    """A laser scan, seen from the origin of `seen_from`: the robot's base, or the scanner if its mount is not known.

    `is_base` is true in the first case. Bearings are in degrees from straight ahead, left positive. `nearest_m` is null
    if there is no obstacle within `range_max_m`, the scanner's range. `free_m` is the free distance in each sector of
    45°, at most about `range_max_m`; null if the scan does not cover the sector. `invalid` of the `beams` carry no
    information.
    """

    seen_from: str
    is_base: bool
    nearest_m: float | None
    nearest_bearing_deg: float | None
    nearest_x_m: float | None
    nearest_y_m: float | None
    free_m: Mapping[str, float | None]
    range_max_m: float
    beams: int
    invalid: int
    note: str = field(default="")

    def __str__(self) -> str:
        """Return two sentences for the model, and the note."""
        return " ".join(filter(None, (self._nearest(), self._free(), self.note)))

    def _nearest(self) -> str:
        if self.nearest_m is None or self.nearest_bearing_deg is None:
            return (
                f"No obstacle within {self.range_max_m:.2f} m in its field of view."
                if self.beams > self.invalid
                else ""
            )
        side = sector_of(self.nearest_bearing_deg)
        return f"Nearest obstacle {self.nearest_m:.2f} m {bearing_in_words(self.nearest_bearing_deg)} ({side})."

    def _free(self) -> str:
        seen = [f"{name} {metres:.2f}" for name, metres in self.free_m.items() if metres is not None]
        unseen = [name for name, metres in self.free_m.items() if metres is None]
        if not seen:
            return "No side is covered by valid beams."
        not_seen = f"; not seen: {', '.join(unseen)}" if unseen else ""
        where = f"from the origin of {named(self.seen_from)} by side (45° each) in metres"
        return f"Free distance {where}: {', '.join(seen)}{not_seen}."


@dataclass(frozen=True, slots=True, kw_only=True)
class DepthMeaning:
    """A point cloud or a depth image, seen from the origin of `seen_from`: the robot's base, or the sensor.

    The sensor is used (`is_base` false) if its mount is not known, with x forward, y to the left, z up. `nearest_m` is
    the horizontal distance of the nearest point that is 0.1 to 2 m above the ground, with its bearing in degrees (left
    positive) and its position; null if there is none. `ground_z_m` is the height of the ground, `ground_share` the
    share of points in it; null if no ground is seen. The extent is that of all points without the outermost hundredth.
    `invalid` of the `points` have no position. A depth image without a camera info has only `nearest_m` (along the
    optical axis) and `note`.
    """

    seen_from: str
    is_base: bool
    nearest_m: float | None = None
    nearest_bearing_deg: float | None = None
    nearest_x_m: float | None = None
    nearest_y_m: float | None = None
    nearest_z_m: float | None = None
    ground_z_m: float | None = None
    ground_share: float | None = None
    x_min_m: float | None = None
    x_max_m: float | None = None
    y_min_m: float | None = None
    y_max_m: float | None = None
    z_min_m: float | None = None
    z_max_m: float | None = None
    points: int = 0
    invalid: int = 0
    note: str = field(default="")

    def __str__(self) -> str:
        """Return up to four sentences for the model, and the note."""
        return " ".join(filter(None, (self._nearest(), self._ground(), self._extent(), self.note)))

    def _nearest(self) -> str:
        if self.nearest_m is None:
            return "" if self.x_min_m is None else "Nothing above the ground is in view."
        if self.nearest_bearing_deg is None:
            return f"Nearest distance {self.nearest_m:.2f} m."
        side = f"{bearing_in_words(self.nearest_bearing_deg)} ({sector_of(self.nearest_bearing_deg)})"
        return f"Nearest thing above the ground {self.nearest_m:.2f} m {side}, at a height of {self.nearest_z_m:.2f} m."

    def _ground(self) -> str:
        if self.ground_z_m is None:
            return "" if self.x_min_m is None else "No ground is seen."
        return f"Ground at z = {self.ground_z_m:.2f} m ({self.ground_share:.0%} of the points)."

    def _extent(self) -> str:
        if self.x_min_m is None:
            return ""
        spans = ((self.x_min_m, self.x_max_m), (self.y_min_m, self.y_max_m), (self.z_min_m, self.z_max_m))
        words = ", ".join(f"{axis} {low:.2f} to {high:.2f}" for axis, (low, high) in zip("xyz", spans, strict=True))
        return f"Extent in metres: {words}."


@dataclass(frozen=True, slots=True, kw_only=True)
class Meaning:
    """The interpretation of the newest message: `scan` of a laser scan, `depth` of a point cloud or a depth image.

    `unknown` says why there is none, if the header and the data of the message contradict each other.
    """

    scan: ScanMeaning | None = field(default=None, metadata=_ON_REQUEST)
    depth: DepthMeaning | None = field(default=None, metadata=_ON_REQUEST)
    unknown: str = field(default="", metadata=_ON_REQUEST)

    def __str__(self) -> str:
        """Return the interpretation in words."""
        return str(self.scan or self.depth or self.unknown)


def bearing_in_words(degrees: float) -> str:
    """Describe a bearing: `straight ahead`, `35° to the left`, `straight behind`."""
    if round(abs(degrees)) in (0, 180):
        return "straight behind" if abs(degrees) > 90 else "straight ahead"
    return f"{abs(degrees):.0f}° to the {'left' if degrees > 0 else 'right'}"


def sector_of(degrees: float) -> str:
    """Return the sector of a bearing."""
    return SECTORS[math.floor(degrees / math.degrees(SECTOR_RAD) + 0.5) % len(SECTORS)]
