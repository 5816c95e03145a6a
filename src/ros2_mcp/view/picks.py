"""What the person has picked on a page: a place, in metres of a frame."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, cast

from ros2_mcp.model.errors import BadInput
from ros2_mcp.model.text import named
from ros2_mcp.model.times import iso_time

MOST_PICKS = 8
"""Of one page: as many as a person keeps apart; the oldest give way."""
_MOST_NAME = 200
_MOST_M = 1e6
_MOST_S = 1e11
_OCCUPIED = 65
"""Percent: from here on a map's cell is taken for occupied, as ROS's map server does."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Pick:
    """A place that a person has picked: metres in the frame `frame`, and when, in the time that was shown.

    `about` says what the grid has there, or is empty.
    """

    panel: str
    frame: str
    x_m: float
    y_m: float
    time: str
    about: str

    def summary(self) -> str:
        """One line."""
        about = f": {self.about}" if self.about else ""
        where = f"({self.x_m:.2f}, {self.y_m:.2f}) m in {named(self.frame)}"
        return f"Picked on the {self.panel} at {self.time}: {where}{about}."


def picks_of(given: Any) -> Sequence[Pick]:
    """The picks that a page's JSON is. Raises `BadInput` for what is none."""
    if not isinstance(given, list):
        raise BadInput("These are no picks.")
    return [_pick(one) for one in cast("list[Any]", given)[-MOST_PICKS:]]


def _pick(given: Any) -> Pick:
    try:
        fields = cast("Mapping[str, Any]", dict(given))
        x_m, y_m, at_s = _number(fields["x"], _MOST_M), _number(fields["y"], _MOST_M), _number(fields["at_s"], _MOST_S)
        grid = str(fields.get("grid") or "")[:_MOST_NAME]
        about = f"{_cell(int(fields['cell']), is_cost=bool(fields.get('costs')))} on {named(grid)}" if grid else ""
        return Pick(
            panel="map",
            frame=str(fields["frame"])[:_MOST_NAME],
            x_m=round(x_m, 3),
            y_m=round(y_m, 3),
            time=iso_time(round(at_s * 1e9)),
            about=about,
        )
    except (KeyError, TypeError, ValueError, OverflowError) as error:
        raise BadInput("This is no pick.", str(error)) from error


def _number(value: Any, most: float) -> float:
    if isinstance(value, bool) or not isinstance(value, (int, float)) or not math.isfinite(value):
        raise TypeError("a number is expected")
    if abs(value) > most:
        raise ValueError("this is too large")
    return float(value)


def _cell(value: int, *, is_cost: bool) -> str:
    if not 0 <= value <= 100:
        return "unknown"
    if is_cost:
        return f"cost {value} of 100"
    return "occupied" if value >= _OCCUPIED else "free"
