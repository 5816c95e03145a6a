"""Named places of a robot, stored in the robot's state folder so that they outlive the server."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, cast

from ros2_mcp.guard.state import StateFolder
from ros2_mcp.model.errors import BadInput, NotFound
from ros2_mcp.model.names import did_you_mean
from ros2_mcp.model.text import is_unicode, listed, quoted
from ros2_mcp.ops.navigation.state_files import damaged, read_state, write_state
from ros2_mcp.robot import Robot
from ros2_mcp.robot.kept import Kept

FILE = "places.json"
MOST_PLACES = 1000
"""More than a building has rooms; the file stays below 200 kB."""
MOST_CHARACTERS = 80
"""Longest name: as long as a quotation in our texts."""
_MOST_NAMED = 15
"""Number of names in an error; ros2_place_list shows all."""


@dataclass(frozen=True, slots=True)
class NamedPlace:
    """A pose on the ground with a name: x and y in m in `frame`, yaw in radians counter-clockwise from the x axis; None
    allows any heading."""

    name: str
    frame: str
    x_m: float
    y_m: float
    yaw_rad: float | None = None


class Places(Kept):
    """The places of one robot. Without a folder they are kept in memory only.

    The file is read on each access, since other servers of the same user may have changed it.
    """

    def __init__(self, folder: StateFolder | None = None) -> None:
        self._folder = folder
        self._in_memory: dict[str, NamedPlace] = {}

    @property
    def kept_in(self) -> Path | None:
        """The file, or None."""
        return self._folder.path / FILE if self._folder else None

    def all(self) -> Sequence[NamedPlace]:
        """Return every place, sorted by name.

        Raises:
            BadData: if the file cannot be read.
        """
        return [place for _, place in sorted(self._read().items())]

    def find(self, name: str) -> NamedPlace:
        """Return a place by its name. Case is ignored if that leaves only one place.

        Raises:
            NotFound: with the nearest name.
            BadData: as `all`.
        """
        known, name = self._read(), name.strip()
        alike = [place for place in known.values() if place.name.lower() == name.lower()]
        if found := known.get(name) or (alike[0] if len(alike) == 1 else None):
            return found
        kept = f"Kept places: {listed(sorted(known), _MOST_NAMED)}." if known else "No place is kept yet."
        by_numbers = "Give x and y, which ros2_scene shows; ros2_place_set keeps a place by its name."
        hint = did_you_mean(name, list(known), by_numbers)
        raise NotFound(f"There is no place {quoted(name)}. {kept}", hint)

    def set(self, place: NamedPlace) -> NamedPlace | None:
        """Store a place; return the former place of that name, or None.

        Raises:
            BadInput: for an invalid name, numbers that are not finite, or too many places.
            BadData: as `all`.
            RobotError: if it cannot be written.
        """
        name = place.name.strip()
        if not name or len(name) > MOST_CHARACTERS or not is_unicode(name) or not name.isprintable():
            raise BadInput(
                f"{quoted(name) if name else 'An empty string'} is not a valid name for a place.",
                f"Give 1 to {MOST_CHARACTERS} printable characters.",
            )
        if not all(map(math.isfinite, (place.x_m, place.y_m, place.yaw_rad or 0.0))):
            raise BadInput("A place has finite numbers.")
        known = self._read()
        former = known.get(name)
        if former is None and len(known) >= MOST_PLACES:
            raise BadInput(f"{MOST_PLACES} places are kept already.", "Remove one: ros2_place_set with remove=true.")
        known[name] = NamedPlace(name, place.frame, place.x_m, place.y_m, place.yaw_rad)
        self._write(known)
        return former

    def remove(self, name: str) -> NamedPlace:
        """Delete a place and return it; raises as `find` and `set`."""
        place, known = self.find(name), self._read()
        known.pop(place.name, None)
        self._write(known)
        return place

    def _read(self) -> dict[str, NamedPlace]:
        if self._folder is None:
            return dict(self._in_memory)
        value = read_state(self._folder, FILE, "places")
        if value is None:
            return {}
        try:
            return {name: _place(name, fields) for name, fields in value["places"].items()}
        except (ValueError, KeyError, TypeError, AttributeError) as error:
            raise damaged(self._folder, FILE, "places", error) from error

    def _write(self, places: Mapping[str, NamedPlace]) -> None:
        self._in_memory = dict(places)
        if self._folder:
            kept = {name: _fields(place) for name, place in places.items()}
            write_state(self._folder, FILE, {"places": kept}, "places")


def places_of(robot: Robot) -> Places:
    """Return the places of a robot; in memory only if it was built without a folder for them."""
    return robot.kept.get(Places, Places)


def _fields(place: NamedPlace) -> dict[str, Any]:
    fields = asdict(place)
    del fields["name"]
    return fields


def _place(name: str, fields: object) -> NamedPlace:
    values = cast("Mapping[str, Any]", fields)
    yaw = values.get("yaw_rad")
    place = NamedPlace(
        name, str(values["frame"]), float(values["x_m"]), float(values["y_m"]), None if yaw is None else float(yaw)
    )
    if not all(map(math.isfinite, (place.x_m, place.y_m, place.yaw_rad or 0.0))):
        raise ValueError(f"{name!r} has numbers that are not finite")
    return place
