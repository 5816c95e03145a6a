"""Finds the robot on its map by its scan: a search over positions and headings, and the last pose that was kept."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field

from ros2_mcp.model.aside import LARGE, aside, load
from ros2_mcp.model.errors import NotFound
from ros2_mcp.model.text import counted
from ros2_mcp.ops.navigation.last_pose import MapMark, last_pose_of
from ros2_mcp.ops.navigation.scan_fit import ScanFit, ScanOnMap, scan_on_map
from ros2_mcp.ops.navigation.targets import MAP_FRAME, Target
from ros2_mcp.ops.navigation.whereabouts import Whereabouts, whereabouts
from ros2_mcp.ops.results.results import EXACT, Report, reporting
from ros2_mcp.robot import Robot

FITS = 0.5
"""Least share of beams that must fit before a pose that nobody gave is published."""
_LESS, _BETTER = 0.25, 0.1
"""Decrease of the fit since the pose was kept that people and moved things explain, and difference between two fits by
which one pose is better."""
RADIUS_M = 3.0
"""Distance searched around a guess by default."""
_TURN_RAD = math.radians(60)
"""Angle searched on both sides of the heading of a guess: less than half of a right angle more, as rooms look alike
when turned by 90°."""
_MOVED_M, _TURNED_RAD = 0.05, math.radians(3)
"""A pose found for an older scan is not where a robot is that has moved by more than that meanwhile."""


@dataclass(frozen=True, slots=True)
class PoseFit:
    """A pose in the map (m, degrees), and the share of laser beams that fit from there. `through` is the share of beams
    that would pass through something occupied."""

    x_m: float = field(metadata=EXACT)
    y_m: float = field(metadata=EXACT)
    yaw_deg: float = field(metadata=EXACT)
    fit: float | None
    through: float

    def __str__(self) -> str:
        """Return the pose as it can be given to the tool, and how well it fits."""
        through = f", but {self.through:.0%} would pass through walls" if self.through >= 0.05 else ""
        fits = "fit not known" if self.fit is None else f"{self.fit:.0%} of the beams fit{through}"
        return f'{{"x": {self.x_m:.2f}, "y": {self.y_m:.2f}, "yaw_deg": {round(self.yaw_deg)}}}: {fits}'


@dataclass(frozen=True, slots=True)
class Found:
    """The poses that were found, the best first. `how` says how, and `doubt` why the first may not be the robot's ("":
    no doubt).
    """

    poses: Sequence[PoseFit]
    how: str
    doubt: str = ""


async def find_pose(robot: Robot, guess: Target | None, radius_m: float | None, report: Report) -> Found:
    """Search the map, or the part of it around a guess, for the poses from which the scan fits.

    Raises:
        NotFound: without a map, a scan, or a transform from the robot to its scanner.
    """
    await load("ros2_mcp.world.map_search")  # with numpy: not before it is needed
    from ros2_mcp.world.map_search import MOST_S, Area, search

    before = await whereabouts(robot, "odom")
    seen = await _seen(robot)
    area = None
    if guess:
        turn = math.pi if guess.yaw_rad is None else _TURN_RAD
        area = Area(guess.x_m, guess.y_m, radius_m or RADIUS_M, guess.yaw_rad, turn)
    async with reporting(report, MOST_S, "searching the map"):
        found = await aside(LARGE + 1, search, seen.grid, seen.hits, area, turn="search of a map")
    after = await whereabouts(robot, "odom")
    where = f"within {area.radius_m:g} m of ({area.x_m:g}, {area.y_m:g})" if area else "on the whole map"
    how = f"Searched {where} with {len(seen.hits)} beams in {found.took_s:.1f} s."
    poses = [_fit(pose.x_m, pose.y_m, pose.yaw_rad, pose.share, pose.through) for pose in found.poses]
    doubts: list[str] = []
    if not poses:
        return Found((), how, "there is no free cell of the map to stand on" if not area else "no pose was found there")
    best = found.poses[0]
    if best.rank < FITS:
        doubts.append("the scan fits nowhere well: it may be another map, or the robot is outside of what was searched")
    elif found.rivals:
        doubts.append(f"{counted(found.rivals, 'other pose fits', 'other poses fit')} nearly as well")
    if found.searched < 1:
        doubts.append(f"time was over after {found.searched:.0%} of the headings: search around a guess")
    if before.is_known and after.is_known and _has_moved(before, after):
        doubts.append("the robot moved during the search: let it stand, and search again")
    return Found(poses, how, "; ".join(doubts))


async def last_pose(robot: Robot, present: ScanFit | str) -> Found:
    """Return the last pose that was kept, with its age, and the fit of the scan there now; `present` is the fit where
    localisation has the robot.

    Raises:
        NotFound: if none was kept.
        BadData: if its file is damaged.
    """
    kept = last_pose_of(robot).read()
    seen = await scan_on_map(robot)
    how = f"The last pose kept is {_age(kept.age_s)} old; then {kept.fit:.0%} of the beams fitted."
    if isinstance(seen, str):
        pose = _fit(kept.x_m, kept.y_m, kept.yaw_rad, None, 0.0)
        return Found([pose], how, f"its fit now is not known: {seen}")
    fit: ScanFit = await seen.fit_at(kept.x_m, kept.y_m, kept.yaw_rad)
    doubts: list[str] = []
    if fit.of_all < max(FITS, kept.fit - _LESS):
        doubts.append("the scan does not fit there any more: the robot was moved, or the map changed")
    elif isinstance(present, ScanFit) and present.of_all > fit.of_all + _BETTER:
        doubts.append("where localisation has the robot now the scan fits better")
    if difference := kept.map.difference(MapMark.of(seen.map_topic, seen.grid)):
        doubts.append(difference)
    return Found([_fit(kept.x_m, kept.y_m, kept.yaw_rad, fit.of_all, 0.0)], how, "; ".join(doubts))


def _has_moved(before: Whereabouts, after: Whereabouts) -> bool:
    moved = math.hypot((after.x_m or 0.0) - (before.x_m or 0.0), (after.y_m or 0.0) - (before.y_m or 0.0))
    turned = abs(math.remainder((after.yaw_rad or 0.0) - (before.yaw_rad or 0.0), 2 * math.pi))
    return moved > _MOVED_M or turned > _TURNED_RAD


def _fit(x_m: float, y_m: float, yaw_rad: float, share: float | None, through: float) -> PoseFit:
    known = None if share is None else round(share, 3)
    # Rounded as the text shows it, so that the pose from the text is the same one: an approval is for exact values.
    return PoseFit(round(x_m, 2), round(y_m, 2), float(round(math.degrees(yaw_rad))), known, round(through, 3))


def _age(age_s: float) -> str:
    for unit_s, unit in ((86400, "day"), (3600, "hour"), (60, "minute")):
        if age_s >= unit_s:
            return counted(int(age_s // unit_s), unit)
    return counted(int(age_s), "second")


async def _seen(robot: Robot) -> ScanOnMap:
    seen = await scan_on_map(robot)
    if isinstance(seen, str):
        raise NotFound(f"The map cannot be searched: {seen}.", "It needs a map, a laser scan, and its transform.")
    if seen.grid.frame_id not in ("", MAP_FRAME):
        raise NotFound(f"{seen.map_topic} is in the frame {seen.grid.frame_id}, not in map.", "Give the pose.")
    return seen
