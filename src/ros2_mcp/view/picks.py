"""What the person has picked on a page: a place, in metres of a frame."""

from __future__ import annotations

import json
import math
import os
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from time import time
from typing import Any, cast

from ros2_mcp.guard.state import StateFolder
from ros2_mcp.model.errors import BadInput, RobotError
from ros2_mcp.model.text import named
from ros2_mcp.model.times import iso_time
from ros2_mcp_bridge.files import PLAIN, replace

FILE = "picked.json"
"""In the robot's state folder: what was picked in a browser, for the servers of the same user."""
MOST_PICKS = 8
"""Of one page: as many as a person keeps apart; the oldest give way."""
_MOST_NAME = 200
_MOST_BYTES = 20_000
_KEPT_S = 86_400.0
"""What was picked in a browser yesterday is not meant today."""
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


@dataclass(frozen=True, slots=True, kw_only=True)
class PickedInBrowser:
    """What was picked on a page of `ros2-mcp view`, of `subject`, and when (Unix time, s)."""

    subject: str
    at_s: float
    picks: Sequence[Pick]


def keep(folder: StateFolder, subject: str, picks: Sequence[Pick]) -> None:
    """Keeps what was picked, in place of what was before. Raises `RobotError` where the folder cannot be written."""
    kept = {"subject": subject, "at_s": time(), "picks": [asdict(pick) for pick in picks]}
    try:
        at = folder.make()
        draft = at / f"{FILE}.{os.getpid()}"
        draft.write_text(json.dumps(kept), encoding="utf-8")
        replace(draft, at / FILE)
    except OSError as error:
        raise RobotError(f"What was picked cannot be kept for the agent: {error}.") from error


def kept(folder: StateFolder) -> PickedInBrowser | None:
    """What was picked in a browser of late; None if nothing was, or what stands there is none of ours."""
    try:
        descriptor = os.open(folder.path / FILE, os.O_RDONLY | PLAIN)
        with os.fdopen(descriptor, "rb") as opened:
            found = json.loads(opened.read(_MOST_BYTES + 1))
        at_s = _number(found["at_s"], _MOST_S)
        picks = [_kept_pick(one) for one in found["picks"][-MOST_PICKS:]]
        subject = str(found["subject"])[:_MOST_NAME]
    except (OSError, ValueError, KeyError, TypeError):
        return None
    is_new = 0 <= time() - at_s < _KEPT_S
    return PickedInBrowser(subject=subject, at_s=at_s, picks=picks) if picks and is_new else None


def _kept_pick(given: Mapping[str, Any]) -> Pick:
    words = {name: str(given[name])[:_MOST_NAME] for name in ("panel", "frame", "time", "about")}
    return Pick(x_m=_number(given["x_m"], _MOST_M), y_m=_number(given["y_m"], _MOST_M), **words)


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
