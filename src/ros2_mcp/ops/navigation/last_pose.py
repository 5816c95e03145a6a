"""The robot's last pose on its map, stored in its state folder, because a restart of the robot's software forgets it.

A pose is stored only where the scan fits the map: what a localiser reports right after its start may be anywhere.
"""

from __future__ import annotations

import asyncio
import hashlib
import math
import time
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import asdict, dataclass
from time import monotonic
from typing import TYPE_CHECKING, Any

from ros2_mcp.guard.state import StateFolder
from ros2_mcp.model.errors import NotFound, RobotError
from ros2_mcp.ops.navigation.scan_fit import ScanOnMap, scan_on_map
from ros2_mcp.ops.navigation.state_files import damaged, read_state, write_state
from ros2_mcp.ops.navigation.targets import MAP_FRAME
from ros2_mcp.ops.navigation.whereabouts import whereabouts
from ros2_mcp.robot import Robot
from ros2_mcp.robot.kept import Kept

if TYPE_CHECKING:
    from ros2_mcp.world.occupancy import OccupancyGrid

FILE = "last_pose.json"
_FITS = 0.5
"""Least share of beams that fit. A localised robot has 0.7 or more, even among people; a lost one 0.4 or less."""
_MAP_KEPT_S = 300.0
_MOST_S = 3.0
"""Longest time for a note: it must not delay a navigation's answer if the scanner is silent."""


@dataclass(frozen=True, slots=True)
class MapMark:
    """What tells one map from another: its topic, its size, its place, and a digest of its cells."""

    topic: str
    width: int
    height: int
    resolution_m: float
    x_m: float
    y_m: float
    digest: str

    @classmethod
    def of(cls, topic: str, grid: OccupancyGrid) -> MapMark:
        """Return the mark of a map."""
        height, width = grid.cells.shape
        at_x, at_y = round(grid.corner.x_m, 4), round(grid.corner.y_m, 4)
        digest = hashlib.sha256(grid.cells.tobytes()).hexdigest()[:16]
        return cls(topic, width, height, round(grid.resolution_m, 6), at_x, at_y, digest)

    def difference(self, other: MapMark) -> str:
        """Say how the present map differs from this map; "" if it is the same."""
        if self.digest == other.digest and (self.x_m, self.y_m) == (other.x_m, other.y_m):
            return ""
        before, now = (f"{one.width} × {one.height} cells of {one.resolution_m:g} m" for one in (self, other))
        if before == now and (self.x_m, self.y_m) == (other.x_m, other.y_m):
            return "the map has changed since"
        return f"the map is another one: then {before} from ({self.x_m:g}, {self.y_m:g}), now {now} from " + (
            f"({other.x_m:g}, {other.y_m:g})"
        )


@dataclass(frozen=True, slots=True)
class KeptPose:
    """A pose in the frame `map` (m, radians), the time (UNIX), the share of beams that fitted then, and its map."""

    x_m: float
    y_m: float
    yaw_rad: float
    at: float
    fit: float
    map: MapMark

    @property
    def age_s(self) -> float:
        """Seconds since then, by this computer's clock."""
        return max(0.0, time.time() - self.at)


class LastPose(Kept):
    """The last pose of one robot; in memory only without a folder."""

    def __init__(self, folder: StateFolder | None = None) -> None:
        self._folder = folder
        self._in_memory: KeptPose | None = None
        self._seen: ScanOnMap | None = None
        self._seen_at = 0.0

    async def seen(self, robot: Robot) -> ScanOnMap | str:
        """Return a current scan, and the map to compare it with. The map is read again only after some minutes: a large
        one takes seconds over a slow network.
        """
        known = self._seen if monotonic() - self._seen_at < _MAP_KEPT_S else None
        seen = await scan_on_map(robot, known)
        if isinstance(seen, ScanOnMap) and known is None:
            self._seen, self._seen_at = seen, monotonic()
        return seen

    def forget_map(self) -> None:
        """Read the map again for the next pose."""
        self._seen = None

    def read(self) -> KeptPose:
        """Return the stored pose.

        Raises:
            NotFound: if there is none.
            BadData: if the file is damaged.
        """
        value = read_state(self._folder, FILE, "the last pose") if self._folder else None
        if value is None:
            if self._in_memory:
                return self._in_memory
            raise NotFound(
                "No last pose is kept for this robot.",
                "Poses are kept after ros2_nav_localize and ros2_navigate; search=true looks for it on the map.",
            )
        try:
            return _pose(value)
        except (ValueError, KeyError, TypeError) as error:
            assert self._folder
            raise damaged(self._folder, FILE, "the last pose", error) from error

    def write(self, pose: KeptPose) -> None:
        """Store a pose.

        Raises:
            RobotError: if it cannot be written.
        """
        self._in_memory = pose
        if self._folder:
            write_state(self._folder, FILE, asdict(pose), "last pose")


def last_pose_of(robot: Robot) -> LastPose:
    """Return the last pose of a robot; in memory only if it was built without a folder."""
    return robot.kept.get(LastPose, LastPose)


async def note_last_pose(robot: Robot) -> bool:
    """Store where the robot is now, if its scan fits the map there, and return whether it was stored. Raises no
    `RobotError`; a policy in the mode observe keeps nothing."""
    if robot.guard.mode == "observe":
        return False
    with suppress(RobotError, asyncio.TimeoutError):
        return await asyncio.wait_for(_note(robot), _MOST_S)
    return False


async def _note(robot: Robot) -> bool:
    where, seen = await asyncio.gather(whereabouts(robot, MAP_FRAME), last_pose_of(robot).seen(robot))
    if where.x_m is None or where.y_m is None or where.yaw_rad is None or where.trouble:
        return False
    if not isinstance(seen, ScanOnMap) or seen.base != where.base:
        return False
    fit = await seen.fit_at(where.x_m, where.y_m, where.yaw_rad)
    if fit.of_all < _FITS:
        return False
    mark = MapMark.of(seen.map_topic, seen.grid)
    pose = KeptPose(
        round(where.x_m, 4), round(where.y_m, 4), round(where.yaw_rad, 5), time.time(), round(fit.of_all, 3), mark
    )
    last_pose_of(robot).write(pose)
    return True


def _pose(value: Mapping[str, Any]) -> KeptPose:
    numbers = [float(value[name]) for name in ("x_m", "y_m", "yaw_rad", "at", "fit")]
    if not all(map(math.isfinite, numbers)):
        raise ValueError("a number is not finite")
    of: Mapping[str, Any] = value["map"]
    whole = int(of["width"]), int(of["height"])
    placed = float(of["resolution_m"]), float(of["x_m"]), float(of["y_m"])
    x_m, y_m, yaw_rad, at, fit = numbers
    return KeptPose(x_m, y_m, yaw_rad, at, fit, MapMark(str(of["topic"]), *whole, *placed, str(of["digest"])))
