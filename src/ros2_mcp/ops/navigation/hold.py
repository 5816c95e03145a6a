"""A paused navigation: where the robot stands, and how far it was moved meanwhile."""

from __future__ import annotations

import asyncio
import math
from dataclasses import dataclass
from time import monotonic

from ros2_mcp.ops.navigation.targets import MAP_FRAME
from ros2_mcp.ops.navigation.whereabouts import Whereabouts, whereabouts
from ros2_mcp.ops.stop.judge import Observation
from ros2_mcp.ops.stop.observe import observe_still
from ros2_mcp.robot import Robot

MOST_PAUSED_S = 3600.0
"""A navigation that is paused for longer was forgotten, and must not begin to move hours later."""
_STANDS_S = 10.0
"""Longest wait for the robot to stand: it brakes within a second or two, unless something else drives it."""
_MOVED_M, _MOVED_DEG = 0.15, 10.0
"""AMCL's estimate of a robot that stands varies by some centimetres and degrees."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Hold:
    """Since when the robot holds (monotonic), where it stood by its transforms in map and odom, and how that was
    measured."""

    since: float
    where: Whereabouts
    odometry: Whereabouts
    seen: Observation

    @property
    def sentence(self) -> str:
        """Whether the robot stands, and where."""
        state = "The robot stands" if self.seen.stands else "NOT MEASURED whether the robot stands"
        if self.seen.is_moving:
            state = "THE ROBOT STILL MOVES, though its goal was cancelled"
        at = f" at ({self.where.x_m:.2f}, {self.where.y_m:.2f}) in {self.where.frame}" if self.where.is_known else ""
        return f"{state}{at}. {self.seen.sentence}"


@dataclass(frozen=True, slots=True, kw_only=True)
class Shift:
    """How far the robot is from where it was paused: m and degrees in map, m by odometry; null where not known."""

    map_m: float | None
    turned_deg: float | None
    odometry_m: float | None

    @property
    def is_moved(self) -> bool:
        """Whether it was moved, or is localised elsewhere."""
        far = max(self.map_m or 0.0, self.odometry_m or 0.0)
        return far > _MOVED_M or abs(self.turned_deg or 0.0) > _MOVED_DEG

    @property
    def sentence(self) -> str:
        """What was measured."""
        if self.map_m is None:
            return "Whether it was moved meanwhile is not known: there is no pose in the map."
        turned = "" if self.turned_deg is None else f" and {abs(self.turned_deg):.0f}°"
        told = f"{self.map_m:.2f} m{turned} from where it was paused"
        if not self.is_moved:
            return f"It was not moved meanwhile ({told})."
        wheels = "" if self.odometry_m is None else f" By odometry it came {self.odometry_m:.2f} m."
        carried = self.odometry_m is not None and self.odometry_m <= _MOVED_M < self.map_m
        why = " Its wheels did not turn: it was carried, or localised anew." if carried else ""
        return f"IT WAS MOVED meanwhile: it is {told}.{wheels}{why}"


class Pausing:
    """The state shared by a navigation and the tool that pauses it."""

    def __init__(self) -> None:
        self.requested = asyncio.Event()
        self.resumed = asyncio.Event()
        self.hold: Hold | None = None

    def begin(self) -> None:
        """Have the navigation pause."""
        self.requested.set()

    def resume(self) -> None:
        """Let it go on."""
        self.requested.clear()
        self.resumed.set()

    async def until_resumed(self, robot: Robot) -> bool:
        """Hold until the navigation is resumed; return False if that takes too long."""
        self.hold = await hold_of(robot)
        try:
            await asyncio.wait_for(self.resumed.wait(), MOST_PAUSED_S)
        except asyncio.TimeoutError:
            return False
        finally:
            self.hold = None
            self.resumed.clear()
        return True


async def hold_of(robot: Robot) -> Hold:
    """Wait until the robot stands, and record where. Raises no `RobotError`."""
    end = monotonic() + _STANDS_S
    while (seen := await observe_still(robot)).is_moving and monotonic() < end:
        pass
    where, odometry = await asyncio.gather(whereabouts(robot, MAP_FRAME), whereabouts(robot, "odom"))
    return Hold(since=monotonic(), where=where, odometry=odometry, seen=seen)


async def shift_since(robot: Robot, hold: Hold) -> Shift:
    """Measure how far the robot is from where it was paused. Raises no `RobotError`."""
    where, odometry = await asyncio.gather(whereabouts(robot, MAP_FRAME), whereabouts(robot, "odom"))
    turned = None
    if where.yaw_rad is not None and hold.where.yaw_rad is not None:
        turned = round(math.degrees(math.remainder(where.yaw_rad - hold.where.yaw_rad, 2 * math.pi)), 1)
    return Shift(map_m=_apart(hold.where, where), turned_deg=turned, odometry_m=_apart(hold.odometry, odometry))


def _apart(one: Whereabouts, other: Whereabouts) -> float | None:
    if one.x_m is None or one.y_m is None or other.x_m is None or other.y_m is None:
        return None
    return round(math.hypot(other.x_m - one.x_m, other.y_m - one.y_m), 3)
