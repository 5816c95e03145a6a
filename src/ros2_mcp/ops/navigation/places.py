"""`ros2_place_list` and `ros2_place_set`: named places of the robot."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field

from ros2_mcp.model import names
from ros2_mcp.model.errors import BadInput, NotFound
from ros2_mcp.model.text import named, quoted
from ros2_mcp.ops.navigation.known_places import NamedPlace, places_of
from ros2_mcp.ops.navigation.whereabouts import in_frame, whereabouts
from ros2_mcp.ops.results.results import EXACT
from ros2_mcp.robot import Robot
from ros2_mcp.robot.session import Session

_FARTHEST_M = 1e6
"""No robot drives farther."""


@dataclass(frozen=True, slots=True)
class PlaceEntry:
    """A place: metres and degrees in `frame`; `yaw_deg` null: any heading. `away_m`: from the robot, if known."""

    name: str
    frame: str
    x_m: float = field(metadata=EXACT)
    y_m: float = field(metadata=EXACT)
    yaw_deg: float | None = field(metadata=EXACT)
    away_m: float | None = None

    def summary(self) -> str:
        """Return one line."""
        heading = "" if self.yaw_deg is None else f", {self.yaw_deg:.0f}°"
        away = "" if self.away_m is None else f"; {self.away_m:.1f} m from the robot"
        return f"{quoted(self.name)}: ({self.x_m:.2f}, {self.y_m:.2f}){heading} in {named(self.frame)}{away}"


@dataclass(frozen=True, slots=True)
class PlaceList:
    """The stored places, and their file, if it exists."""

    places: Sequence[PlaceEntry]
    kept_in: str
    note: str = ""

    def summary(self) -> list[str]:
        """Return one line per place."""
        none = "No places are kept. ros2_place_set notes one."
        return (
            [*(place.summary() for place in self.places), self.note] if self.places else [f"{none} {self.note}".strip()]
        )


@dataclass(frozen=True, slots=True)
class PlaceKept:
    """What was done: `set`, `moved` or `removed`, and where the place was before."""

    done: str
    place: PlaceEntry
    before: PlaceEntry | None
    kept_in: str

    def summary(self) -> str:
        """Return one line."""
        before = f" Before: {self.before.summary()}." if self.before else ""
        return f"{self.done}: {self.place.summary()}.{before}"


@dataclass(frozen=True, slots=True, kw_only=True)
class PlaceRequest:
    """A place to set or remove. Without x and y (m) it is the robot's current pose."""

    name: str
    x_m: float | None = None
    y_m: float | None = None
    yaw_deg: float | None = None
    frame: str = "map"
    remove: bool = False


async def list_places(robot: Robot, pattern: str = "") -> PlaceList:
    """Return the places whose names match, with their distance from the robot.

    Raises:
        BadData: if the file of places cannot be read.
    """
    known = {place.name: place for place in places_of(robot).all()}
    chosen = [known[name] for name in names.matching(sorted(known), pattern)]
    where = await whereabouts(robot, "map") if chosen else None
    entries: list[PlaceEntry] = []
    for place in chosen:
        away = None
        if where and where.x_m is not None and where.y_m is not None and not where.trouble:
            at = await in_frame(robot, place.frame, place.x_m, place.y_m, "map")
            away = round(math.dist(at, (where.x_m, where.y_m)), 2) if at else None
        entries.append(_entry(place, away))
    shown = f"{len(known)} are kept, {len(chosen)} match." if len(known) > len(chosen) else ""
    return PlaceList(entries, _file(robot), shown)


async def set_place(robot: Robot, session: Session, request: PlaceRequest) -> PlaceKept:
    """Store or delete a place, and write that into the audit.

    Raises:
        BadInput: for an invalid name or invalid numbers.
        NotFound: if there is nothing to remove, or the robot's pose is unknown.
        BadData, RobotError: if the places cannot be read or written.
        Refused: under a policy in the mode observe.
    """
    robot.guard.check_keeping("places")
    if request.remove:
        gone = places_of(robot).remove(request.name)
        _audit(robot, session, "place removed", gone)
        return PlaceKept("removed", _entry(gone), None, _file(robot))
    place = await _place(robot, request)
    before = places_of(robot).set(place)
    _audit(robot, session, "place set", place)
    return PlaceKept("moved" if before else "set", _entry(place), before and _entry(before), _file(robot))


async def _place(robot: Robot, request: PlaceRequest) -> NamedPlace:
    frame = request.frame.strip().lstrip("/")
    if (request.x_m is None) != (request.y_m is None):
        raise BadInput("Only one of x and y is given.", "Give both, or neither for the robot's present place.")
    yaw = None if request.yaw_deg is None else math.radians(math.remainder(request.yaw_deg, 360.0))
    if request.x_m is not None and request.y_m is not None:
        if max(abs(request.x_m), abs(request.y_m)) > _FARTHEST_M:
            raise BadInput("That is farther than any robot goes.", "Give metres.")
        return NamedPlace(request.name.strip(), frame, request.x_m, request.y_m, yaw)
    where = await whereabouts(robot, frame)
    if where.x_m is None or where.y_m is None or where.trouble:
        raise NotFound(f"The robot's place is unknown: {where.trouble}", "Give x and y.")
    heading = where.yaw_rad if yaw is None else yaw
    return NamedPlace(request.name.strip(), frame, round(where.x_m, 4), round(where.y_m, 4), heading)


def _entry(place: NamedPlace, away_m: float | None = None) -> PlaceEntry:
    yaw = None if place.yaw_rad is None else round(math.degrees(place.yaw_rad), 1)
    return PlaceEntry(place.name, place.frame, place.x_m, place.y_m, yaw, away_m)


def _file(robot: Robot) -> str:
    return str(places_of(robot).kept_in or "")


def _audit(robot: Robot, session: Session, kind: str, place: NamedPlace) -> None:
    if robot.guard.audit:
        at = f"({place.x_m:g}, {place.y_m:g}) in {place.frame}"
        robot.guard.audit.note(kind, principal=session.principal.name, name=place.name, place=at)
