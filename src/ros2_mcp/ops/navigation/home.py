"""The place named home, and where the robot stood when this server first moved it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, cast

from ros2_mcp.model.errors import NotFound
from ros2_mcp.ops.navigation.known_places import places_of
from ros2_mcp.ops.navigation.targets import Target, targets_of
from ros2_mcp.ops.navigation.whereabouts import Whereabouts
from ros2_mcp.robot import Robot
from ros2_mcp.robot.kept import Kept

HOME = "home"


class FirstStood(Kept):
    """The robot's pose when the first navigation of this server began. It is only reported: this server never drives
    there by itself, because the robot may have been localised anew since.
    """

    def __init__(self) -> None:
        self.where: Whereabouts | None = None

    def note(self, where: Whereabouts) -> None:
        """Remember the first pose."""
        if self.where is None and where.is_known and not where.trouble:
            self.where = where


def targets_in(robot: Robot, to: object) -> Sequence[Target]:
    """Return the targets as `targets_of`, with the robot's places. Where no place is named home, the error says how to
    name one."""
    places = places_of(robot)
    try:
        return targets_of(to, places)
    except NotFound as error:
        if _asks_for_home(to) and not any(place.name.lower() == HOME for place in places.all()):
            raise NotFound(error.message, f"{_how(robot)} {error.hint or ''}".rstrip()) from error
        raise


def _how(robot: Robot) -> str:
    first = robot.kept.get(FirstStood, FirstStood).where
    told = ""
    if first and first.x_m is not None and first.y_m is not None:
        told = (
            f" When this server's first navigation began, the robot stood at ({first.x_m:.2f}, {first.y_m:.2f}) in "
            f"{first.frame}."
        )
    return f'Home is a place like any other: ros2_place_set(name="home") saves the robot\'s pose as home.{told}'


def _asks_for_home(to: object) -> bool:
    several = cast("list[object]", to) if isinstance(to, list) else [to]
    named = [cast("Mapping[str, Any]", one).get("place") for one in several if isinstance(one, Mapping)]
    return any(isinstance(name, str) and name.strip().lower() == HOME for name in named)
