"""Compares the scan with the map at the robot's estimated pose. A large deviation alone does not mean a wrong pose."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import TYPE_CHECKING, Any

from ros2_mcp.ops.navigation.checks.check import MAP, NavCheck
from ros2_mcp.ops.navigation.checks.collision_monitor import hits_in
from ros2_mcp.ops.navigation.evidence import POSE, SCAN, NavEvidence, NavFinding

if TYPE_CHECKING:
    from ros2_mcp.world.costmap import CostGrid

_NEAR_M = 0.15
"""Tolerance between the end of a beam and the map: noise of the scanner, a cell, and an ordinary localisation error."""
_OCCUPIED = 65
"""Occupancy from which a cell counts as occupied: the default threshold of map_server (0.65)."""
_LEAST_HITS = 40
_LOST = 0.4
"""Share of the beams that fit. A well localised robot has 0.7 or more, even with people and boxes around it."""
_WIDE_M = 1.5
"""More than the standard deviation of any settled localisation; a new initial pose has 0.5 m."""


def _find(evidence: NavEvidence) -> Iterator[NavFinding]:
    frames, grids = evidence.frames, evidence.grids
    grid = grids.map if grids else None
    if frames is None:
        return
    deviation = deviation_m(evidence)
    scans = [one for one in evidence.of(SCAN) if one.messages]
    share: float | None = None
    count = 0
    if grid is not None and scans and (base := frames.tree.base):
        located = frames.tree.newest(grid.frame_id, base)
        hits = hits_in(frames, base, scans[0].messages[-1][1])
        if located is not None and len(hits) >= _LEAST_HITS:
            x, y, _ = located.pose.translation
            share, count = share_that_fits(grid, hits, x, y, located.pose.yaw_rad)
    if share is not None and count >= _LEAST_HITS and share < _LOST:
        told = f" AMCL's own deviation is {deviation:.2f} m." if deviation else ""
        yield NavFinding(
            rank="stops everything",
            subject="localisation",
            cause="Localisation is lost: the scan does not fit the map where the robot believes to be.",
            proof=f"{share:.0%} of {count} beams end within {_NEAR_M} m of what the map has there.{told}",
            remedy="Give it an initial pose (/initialpose) where the robot really is; or load the map of this place.",
        )
    elif share is None and deviation is not None and deviation > _WIDE_M:
        yield NavFinding(
            rank="stops some goals",
            subject="localisation",
            cause="Localisation does not know where the robot is.",
            proof=f"Its standard deviation is {deviation:.2f} m; the scan could not be compared with the map.",
            remedy="Give it an initial pose, or let the robot turn where it sees walls.",
        )


def deviation_m(evidence: NavEvidence) -> float | None:
    """The larger standard deviation in x or y of the localiser's pose, in m; None if it is not published."""
    for one in evidence.of(POSE):
        if (message := one.newest) is not None:
            variance = max(float(message.pose.covariance[0]), float(message.pose.covariance[7]))
            return math.sqrt(variance) if variance >= 0 and math.isfinite(variance) else None
    return None


def share_that_fits(
    grid: CostGrid, hits: list[tuple[float, float]], x_m: float, y_m: float, yaw_rad: float
) -> tuple[float, int]:
    """Return the share of beam ends near an occupied cell of the map, and the number of beams it is based on.

    Beams that end outside the map do not count. If all of them do, the share is 0 of all beams: the estimated pose is
    outside the map.
    """
    import numpy as np

    near = _near_occupied(grid)
    cos, sin = math.cos(yaw_rad), math.sin(yaw_rad)
    points: Any = np.asarray(hits)
    in_map_x, in_map_y = x_m + cos * points[:, 0] - sin * points[:, 1], y_m + sin * points[:, 0] + cos * points[:, 1]
    turned = grid.corner.yaw_rad
    dx, dy = in_map_x - grid.corner.x_m, in_map_y - grid.corner.y_m
    columns = np.floor((math.cos(turned) * dx + math.sin(turned) * dy) / grid.resolution_m).astype(int)
    rows = np.floor((math.cos(turned) * dy - math.sin(turned) * dx) / grid.resolution_m).astype(int)
    height, width = grid.cells.shape
    on_map = (rows >= 0) & (rows < height) & (columns >= 0) & (columns < width)
    if not on_map.any():
        return 0.0, len(hits)  # the estimated pose is outside the map
    return float(near[rows[on_map], columns[on_map]].mean()), int(on_map.sum())


def _near_occupied(grid: CostGrid) -> Any:
    """Return for each cell whether an occupied cell is within `_NEAR_M`."""
    import numpy as np

    occupied: Any = grid.cells >= _OCCUPIED
    reach = max(1, round(_NEAR_M / grid.resolution_m))
    near = occupied.copy()
    for axis in (0, 1):
        spread = near.copy()
        for step in range(1, reach + 1):
            for way in (step, -step):
                spread |= _moved(near, way, axis)
        near = spread
    return np.asarray(near)


def _moved(cells: Any, by: int, axis: int) -> Any:
    import numpy as np

    found = np.zeros_like(cells)
    there, here = (slice(by, None), slice(None, -by)) if by > 0 else (slice(None, by), slice(-by, None))
    index = (there, slice(None)) if axis == 0 else (slice(None), there)
    source = (here, slice(None)) if axis == 0 else (slice(None), here)
    found[index] = cells[source]
    return found


CHECK = NavCheck(("frames", "heard", "grids"), _find, MAP)
