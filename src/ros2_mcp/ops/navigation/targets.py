"""Targets to drive to: the name of a place, a pose, or a list of them."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, cast

from ros2_mcp.model.errors import BadInput, BadValue
from ros2_mcp.model.names import did_you_mean
from ros2_mcp.model.text import excerpt, quoted
from ros2_mcp.ops.navigation.known_places import Places

MOST_TARGETS = 100
"""A longer tour is probably a mistake."""
MAP_FRAME = "map"
"""The world-fixed frame of REP 105."""
_FARTHEST_M = 1e6
_KEYS = ("x", "y", "yaw_deg", "frame")
"""The fields of a pose. A target with `place` has no other field."""
_HINT = 'Give {"place": "its name"} or {"x": 1.0, "y": 2.0, "yaw_deg": 90, "frame": "map"} (m, degrees).'


@dataclass(frozen=True, slots=True)
class Target:
    """A pose to drive to: m in `frame`, radians; yaw None: any heading. `name` is that of the place, or ""."""

    name: str
    frame: str
    x_m: float
    y_m: float
    yaw_rad: float | None

    def __str__(self) -> str:
        at = f"({self.x_m:.2f}, {self.y_m:.2f})"
        return f"{quoted(self.name)} {at}" if self.name else at

    def pose(self) -> dict[str, Any]:
        """Return the pose as a geometry_msgs/msg/PoseStamped. The stamp 0 makes tf2 use the newest transform."""
        half = (self.yaw_rad or 0.0) / 2
        return {
            "header": {"frame_id": self.frame},
            "pose": {
                "position": {"x": self.x_m, "y": self.y_m},
                "orientation": {"z": math.sin(half), "w": math.cos(half)},
            },
        }

    def facing_from(self, x_m: float, y_m: float) -> Target:
        """Return this target with the heading of arrival from the given point (m), if any heading is allowed."""
        if self.yaw_rad is not None:
            return self
        dx, dy = self.x_m - x_m, self.y_m - y_m
        return replace(self, yaw_rad=math.atan2(dy, dx) if math.hypot(dx, dy) > 0.05 else 0.0)


def targets_of(to: object, places: Places) -> Sequence[Target]:
    """Return the target poses that an argument describes.

    Raises:
        BadInput: for anything else, saying how it is written.
        NotFound: for an unknown place; suggests the nearest name.
    """
    if isinstance(to, list):
        several = cast("list[object]", to)
        if not several or len(several) > MOST_TARGETS:
            raise BadInput(f"Give 1 to {MOST_TARGETS} places; this list has {len(several)}.", _HINT)
        return [_target(one, places) for one in several]
    return [_target(to, places)]


def _target(to: object, places: Places) -> Target:
    if not isinstance(to, Mapping):
        raise BadInput(f"{excerpt(to)} is not a place.", _HINT)
    given = cast("Mapping[str, object]", to)
    if isinstance(name := given.get("place"), str) and len(given) == 1:
        place = places.find(name)
        return Target(place.name, place.frame, place.x_m, place.y_m, place.yaw_rad)
    for key in given:
        if key not in _KEYS:
            raise BadInput(f"A pose has no field {quoted(str(key))}.", did_you_mean(str(key), list(_KEYS), _HINT))
    if "x" not in given or "y" not in given:
        raise BadInput("A pose needs x and y.", _HINT)
    yaw = given.get("yaw_deg")
    frame = given.get("frame", MAP_FRAME)
    if not isinstance(frame, str) or not frame.strip():
        raise BadValue("frame", "the name of a coordinate frame is expected.", _HINT)
    return Target(
        "",
        frame.strip().lstrip("/"),
        _number("x", given["x"]),
        _number("y", given["y"]),
        None if yaw is None else math.radians(math.remainder(_number("yaw_deg", yaw), 360.0)),
    )


def _number(key: str, value: object) -> float:
    if isinstance(value, bool) or not isinstance(value, (int, float)) or not math.isfinite(value):
        raise BadValue(key, "a finite number is expected.", _HINT)
    if abs(value) > _FARTHEST_M:
        raise BadValue(key, f"{value:g} m is too far: the limit is {_FARTHEST_M:g} m.", _HINT)
    return float(value)
