"""Missions of the simulated autopilot: their items, and which of them are supported. Pure Python, no ROS.

Numbers of commands, frames and results are those of MAVLink (https://mavlink.io/en/messages/common.html).
"""

# pyright: basic
from __future__ import annotations

import math
from dataclasses import dataclass

WAYPOINT, LOITER_UNLIMITED, LOITER_TIME, RETURN, LAND, TAKEOFF, CHANGE_SPEED = 16, 17, 19, 20, 21, 22, 178
START_MISSION, ARM_DISARM, SET_MODE = 300, 400, 176
TAKEN = (WAYPOINT, LOITER_UNLIMITED, LOITER_TIME, RETURN, LAND, TAKEOFF, CHANGE_SPEED)
ABOVE_SEA, ABOVE_HOME = (0, 5), (3, 6)
"""MAVLink frames whose heights are above sea level, and those whose heights are above home."""
MOST_ITEMS = 700

HOME_LATITUDE, HOME_LONGITUDE, HOME_ALTITUDE = 47.397742, 8.545594, 488.0
"""Home in degrees, and m above sea level: a meadow near Zurich."""
_METRES_PER_DEGREE = math.radians(1.0) * 6378137.0


@dataclass(frozen=True)
class Item:
    """One item: `parameters` are its first four, `x` and `y` are m east and north of home (NaN without a position), `z`
    m above home."""

    command: int
    parameters: tuple[float, float, float, float]
    x: float
    y: float
    z: float


def metres(latitude, longitude):
    """Return the m east and north of home of a point in degrees."""
    x = (longitude - HOME_LONGITUDE) * _METRES_PER_DEGREE * math.cos(math.radians(HOME_LATITUDE))
    return x, (latitude - HOME_LATITUDE) * _METRES_PER_DEGREE


def degrees(x, y):
    """Return latitude and longitude in degrees of a point x m east and y m north of home."""
    longitude = HOME_LONGITUDE + x / (_METRES_PER_DEGREE * math.cos(math.radians(HOME_LATITUDE)))
    return HOME_LATITUDE + y / _METRES_PER_DEGREE, longitude


def item_of(command, frame, parameters, latitude, longitude, altitude):
    """Return the item for a waypoint's numbers; raises `ValueError` with the reason for one that is not supported."""
    if command not in TAKEN:
        raise ValueError(f"command {command} is not supported")
    if frame not in (*ABOVE_SEA, *ABOVE_HOME):
        raise ValueError(f"frame {frame} is not supported")
    if not all(math.isfinite(number) for number in (latitude, longitude, altitude)):
        raise ValueError("its place is not finite")
    # A take-off or landing without a position happens at the present position.
    has_place = bool(latitude or longitude)
    x, y = metres(latitude, longitude) if has_place else (math.nan, math.nan)
    z = altitude - HOME_ALTITUDE if frame in ABOVE_SEA else altitude
    return Item(command, tuple(parameters), x, y, z)
