"""What a message of a sensor means, in a few numbers and in words: what is near, and where it is free."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field

from ros2_mcp.model.text import named

SECTORS = ("front", "front left", "left", "rear left", "rear", "rear right", "right", "front right")
"""Of 45° each, from x towards y; the front is from -22.5° to 22.5°."""
SECTOR_RAD = 2 * math.pi / len(SECTORS)
_ON_REQUEST = {"on_request": True}
"""As in `ops/results/results.py`: a field that is left out where it is None."""


@dataclass(frozen=True, slots=True, kw_only=True)
class ScanMeaning:
    """What a laser scan says, seen from the origin of `seen_from`: the robot's base, or the scan's own frame where its
    mount is not known (`is_base` false).

    Bearings in degrees from straight ahead, to the left positive. `nearest_m` is null where nothing is within
    `reach_m`, as far as the scanner sees. `free_m` is the free distance of each sector of 45°, at most about `reach_m`;
    null where the scan does not cover it. Of `beams`, `invalid` tell nothing.
    """

    seen_from: str
    is_base: bool
    nearest_m: float | None
    nearest_bearing_deg: float | None
    nearest_x_m: float | None
    nearest_y_m: float | None
    free_m: Mapping[str, float | None]
    reach_m: float
    beams: int
    invalid: int
    note: str = field(default="")

    def __str__(self) -> str:
        """Two sentences."""
        return " ".join(filter(None, (self._nearest(), self._free(), self.note)))

    def _nearest(self) -> str:
        if self.nearest_m is None or self.nearest_bearing_deg is None:
            return f"No obstacle within {self.reach_m:.2f} m in its field of view." if self.beams > self.invalid else ""
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
    """What a point cloud or a depth image says, seen from the origin of `seen_from`: the robot's base, or (`is_base`
    false) the sensor's place, x forward, y to the left, z up, where its mount is not known.

    `nearest_m` is the horizontal distance of the nearest thing that stands 0.1 to 2 m above the ground, with its
    bearing in degrees (left positive) and its place; null where there is none. `ground_z_m` is the height of the
    ground, with the share of points that lie in it; null where none is seen. The extent is that of all points but the
    outermost hundredth. Of `points`, `invalid` have no place. Of a depth image without a camera info only `nearest_m`
    (along the optical axis) and `note` are told.
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
        """Up to four sentences."""
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
    """What the newest message says: `scan` of a laser scan, `depth` of a point cloud or a depth image; or `unknown`:
    why it says nothing, where its header and its data contradict each other.
    """

    scan: ScanMeaning | None = field(default=None, metadata=_ON_REQUEST)
    depth: DepthMeaning | None = field(default=None, metadata=_ON_REQUEST)
    unknown: str = field(default="", metadata=_ON_REQUEST)

    def __str__(self) -> str:
        """In words."""
        return str(self.scan or self.depth or self.unknown)


def bearing_in_words(degrees: float) -> str:
    """`straight ahead`, `35° to the left`, `straight behind`."""
    if round(abs(degrees)) in (0, 180):
        return "straight behind" if abs(degrees) > 90 else "straight ahead"
    return f"{abs(degrees):.0f}° to the {'left' if degrees > 0 else 'right'}"


def sector_of(degrees: float) -> str:
    """The sector in which a bearing lies."""
    return SECTORS[math.floor(degrees / math.degrees(SECTOR_RAD) + 0.5) % len(SECTORS)]
