"""Compares the scan with the map at the robot's estimated pose. A large deviation alone does not mean a wrong pose."""

from __future__ import annotations

import math
from collections.abc import Iterator

from ros2_mcp.ops.navigation.checks.check import MAP, NavCheck
from ros2_mcp.ops.navigation.checks.collision_monitor import hits_in
from ros2_mcp.ops.navigation.evidence import POSE, SCAN, NavEvidence, NavFinding

_LEAST_HITS = 40
_LOST = 0.4
"""Share of the beams that fit. A well localised robot has 0.7 or more, even with people and boxes around it."""
_FITS = 0.6
"""Share that fits if only the heading was wrong: a wrong place fits so well by no turn."""
_TURNS = [math.radians(degrees) for degrees in range(-175, 181, 5) if abs(degrees) > 10]
_WIDE_M = 1.5
"""More than the standard deviation of any settled localisation; a new initial pose has 0.5 m."""


def _find(evidence: NavEvidence) -> Iterator[NavFinding]:
    frames, grids = evidence.frames, evidence.grids
    grid = grids.map if grids else None
    if frames is None:
        return
    from ros2_mcp.world.map_fit import NEAR_M, MapFit  # with numpy: not before it is needed

    deviation = deviation_m(evidence)
    scans = [one for one in evidence.of(SCAN) if one.messages]
    share: float | None = None
    count, where = 0, ""
    if grid is not None and scans and (base := frames.tree.base):
        located = frames.tree.newest(grid.frame_id, base)
        hits = hits_in(frames, base, scans[0].messages[-1][1])
        if located is not None and len(hits) >= _LEAST_HITS:
            x, y, _ = located.pose.translation
            where = f", ({x:.2f}, {y:.2f})"
            fit, yaw = MapFit(grid), located.pose.yaw_rad
            share, count = fit.share(hits, x, y, yaw)
            if share < _LOST:
                turned_share, turn = max((fit.share(hits, x, y, yaw + turn)[0], turn) for turn in _TURNS)
                if turned_share >= _FITS:
                    yield _turned(math.degrees(turn), share, turned_share, count)
                    return
    if share is not None and count >= _LEAST_HITS and share < _LOST:
        told = f" AMCL's own deviation is {deviation:.2f} m." if deviation else ""
        yield NavFinding(
            rank="stops everything",
            subject="localisation",
            cause=f"Localisation is lost: the scan does not fit the map at the pose it is believed to have{where}.",
            proof=f"{share:.0%} of {count} beams end within {NEAR_M} m of something on the map.{told}",
            remedy="ros2_nav_localize(search=true) finds its pose by the scan and publishes it on /initialpose; or "
            "load the map of this place.",
        )
    elif share is None and deviation is not None and deviation > _WIDE_M:
        yield NavFinding(
            rank="stops some goals",
            subject="localisation",
            cause="Localisation does not know where the robot is.",
            proof=f"Its standard deviation is {deviation:.2f} m; the scan could not be compared with the map.",
            remedy="Give it an initial pose, or let the robot turn where it sees walls.",
        )


def _turned(degrees: float, share: float, turned_share: float, count: int) -> NavFinding:
    return NavFinding(
        rank="stops everything",
        subject="localisation",
        cause=f"The scan fits the map only if it is turned by {degrees:.0f}°: the heading of its pose is wrong, "
        "or its lidar is turned against its transform.",
        proof=f"{share:.0%} of {count} beams end near something on the map; turned, {turned_share:.0%} do.",
        remedy="ros2_nav_probe moves a little and shows which. If the heading is wrong: give an initial pose "
        "(ros2_nav_localize); if the lidar is turned: correct the yaw of its joint.",
    )


def deviation_m(evidence: NavEvidence) -> float | None:
    """The larger standard deviation in x or y of the localiser's pose, in m; None if it is not published."""
    for one in evidence.of(POSE):
        if (message := one.newest) is not None:
            variance = max(float(message.pose.covariance[0]), float(message.pose.covariance[7]))
            return math.sqrt(variance) if variance >= 0 and math.isfinite(variance) else None
    return None


CHECK = NavCheck(("frames", "heard", "grids"), _find, MAP)
