"""A person's picks on a page: a place on the map, a point in 3D, a box in a picture, a time in a plot."""

from __future__ import annotations

import json
import math
import os
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass
from dataclasses import replace as changed
from time import time
from typing import Any, Literal, cast

from ros2_mcp.guard.state import StateFolder
from ros2_mcp.model.errors import BadInput, RobotError
from ros2_mcp.model.text import named
from ros2_mcp.model.times import iso_time
from ros2_mcp_common.files import PLAIN, replace

FILE = "picked.json"
"""File in the robot's state folder with what was picked in a browser, for the servers of the same user."""
MOST_PICKS = 8
"""Picks of one page: as many as a person can distinguish; the oldest are dropped."""
MOST_VALUES = 12
"""Values of one time: a plot draws six curves."""
_MOST_NAME = 200
_MOST_UNIT = 20
_MOST_BYTES = 40_000
_KEPT_S = 86_400.0
"""Seconds after which picks made in a browser are ignored: a day later they are no longer meant."""
_MOST_M = 1e6
_MOST_S = 1e11
_MOST_PIXELS = 100_000
_OCCUPIED = 65
"""Percent from which a cell of a map is occupied, as in ROS's map server."""

Kind = Literal["place", "point", "box", "time"]


@dataclass(frozen=True, slots=True, kw_only=True)
class PickedValue:
    """The value of one curve of a plot at a time."""

    name: str
    value: float
    unit: str


@dataclass(frozen=True, slots=True, kw_only=True)
class Pick:
    """One pick of a person. `time` is the time of the picked data, `age_s` the age of the data when it was picked.

    A `place` on the map and a `point` of a cloud or scan have metres in `frame`; a point also has `view_xyz_m`, its
    position in `view_frame`, the frame of the view. A `box` has `box_px` (left, top, right, bottom, inclusive) in an
    image of size `image_size_px` (width, height), and in a depth image the median `depth_m`. A `time` of a plot has
    `values`. `about` is a further description.
    """

    kind: Kind
    time: str
    age_s: float | None = None
    topic: str = ""
    frame: str = ""
    x_m: float | None = None
    y_m: float | None = None
    z_m: float | None = None
    view_frame: str = ""
    view_xyz_m: Sequence[float] = ()
    box_px: Sequence[int] = ()
    image_size_px: Sequence[int] = ()
    depth_m: float | None = None
    values: Sequence[PickedValue] = ()
    about: str = ""

    def summary(self) -> str:
        """Describe the pick in one line."""
        return _SUMMARIES[self.kind](self)

    def is_same_box(self, other: Pick) -> bool:
        """Return whether both are the same part of the same picture."""
        return self.kind == "box" and (self.topic, self.time, self.box_px) == (other.topic, other.time, other.box_px)

    def with_depth(self, depth_m: float | None, about: str) -> Pick:
        """Return the same box with the depth there."""
        return changed(self, depth_m=depth_m, about=about)


@dataclass(frozen=True, slots=True, kw_only=True)
class PickedInBrowser:
    """The picks on a page of `ros2-mcp view` that shows `subject`, and their time (Unix time, s)."""

    subject: str
    at_s: float
    picks: Sequence[Pick]


# ── in words ─────────────────────────────────────────────────────────────────────────────────────────────────────


def _place_in_words(pick: Pick) -> str:
    about = f": {pick.about}" if pick.about else ""
    return f"Picked on the map at {pick.time}: {_metres((pick.x_m, pick.y_m))} in {named(pick.frame)}{about}."


def _point_in_words(pick: Pick) -> str:
    where = f"{_metres((pick.x_m, pick.y_m, pick.z_m))} in {named(pick.frame)}"
    if pick.view_frame and pick.view_frame != pick.frame:
        where += f", {_metres(pick.view_xyz_m)} in {named(pick.view_frame)}"
    return f"Picked in 3D: a point of {named(pick.topic)} of {pick.time}{_old(pick)}, at {where}."


def _box_in_words(pick: Pick) -> str:
    left, top, right, bottom = pick.box_px
    width, height = pick.image_size_px
    frame = f", frame {named(pick.frame)}" if pick.frame else ""
    about = f": {pick.about}" if pick.about else ""
    box = f"pixels x {left} to {right}, y {top} to {bottom} of {width} × {height}"
    return f"Picked in the picture {named(pick.topic)} of {pick.time}{_old(pick)}: {box}{frame}{about}."


def _time_in_words(pick: Pick) -> str:
    values = ", ".join(
        f"{named(one.name)} = {one.value:.6g}{f' {one.unit}' if one.unit else ''}" for one in pick.values
    )
    return f"Picked in the plot of {named(pick.topic)}: {pick.time}{_old(pick)}: {values or 'no value'}."


_SUMMARIES: Mapping[Kind, Callable[[Pick], str]] = {
    "place": _place_in_words,
    "point": _point_in_words,
    "box": _box_in_words,
    "time": _time_in_words,
}


def _metres(numbers: Sequence[float | None]) -> str:
    return f"({', '.join(f'{number or 0.0:.2f}' for number in numbers)}) m"


def _old(pick: Pick) -> str:
    return f" ({pick.age_s:.1f} s old then)" if pick.age_s else ""


# ── kept for the servers ─────────────────────────────────────────────────────────────────────────────────────────


def keep(folder: StateFolder, subject: str, picks: Sequence[Pick]) -> None:
    """Store the picks, in place of earlier picks. Raises `RobotError` if the folder cannot be written."""
    kept = {"subject": subject, "at_s": time(), "picks": [asdict(pick) for pick in picks]}
    try:
        at = folder.make()
        draft = at / f"{FILE}.{os.getpid()}"
        draft.write_text(json.dumps(kept), encoding="utf-8")
        replace(draft, at / FILE)
    except OSError as error:
        raise RobotError(f"What was picked cannot be kept for the agent: {error}.") from error


def kept(folder: StateFolder) -> PickedInBrowser | None:
    """Return what was recently picked in a browser; None if nothing was, or the file is not valid."""
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
    kind = given["kind"]
    if kind not in _SUMMARIES:
        raise ValueError("there is no such pick")
    is_box = kind == "box"
    x_m, y_m, z_m = (_maybe(given[name], _MOST_M) for name in ("x_m", "y_m", "z_m"))
    return Pick(
        kind=kind,
        time=_name(given["time"]),
        age_s=_maybe(given["age_s"], _MOST_S),
        topic=_name(given["topic"]),
        frame=_name(given["frame"]),
        x_m=x_m,
        y_m=y_m,
        z_m=z_m,
        view_frame=_name(given["view_frame"]),
        view_xyz_m=_numbers(given["view_xyz_m"], _MOST_M, 3 if given["view_xyz_m"] else 0),
        box_px=_pixels(given["box_px"], 4) if is_box else (),
        image_size_px=_pixels(given["image_size_px"], 2) if is_box else (),
        depth_m=_maybe(given["depth_m"], _MOST_M),
        values=_values(given["values"]),
        about=_name(given["about"]),
    )


# ── told by a page ───────────────────────────────────────────────────────────────────────────────────────────────


def picks_of(given: Any) -> Sequence[Pick]:
    """Parse a page's JSON into picks. Raises `BadInput` if it is not valid."""
    if not isinstance(given, list):
        raise BadInput("These are not picks.")
    return [_pick(one) for one in cast("list[Any]", given)[-MOST_PICKS:]]


def _pick(given: Any) -> Pick:
    try:
        fields = cast("Mapping[str, Any]", dict(given))
        return _KINDS[fields.get("kind", "place")](fields)
    except (KeyError, TypeError, ValueError, OverflowError) as error:
        raise BadInput("This is not a pick.", str(error)) from error


def _place(fields: Mapping[str, Any]) -> Pick:
    x_m, y_m = (_number(fields[name], _MOST_M) for name in ("x", "y"))
    grid = _name(fields.get("grid") or "")
    about = f"{_cell(int(fields['cell']), is_cost=bool(fields.get('costs')))} on {named(grid)}" if grid else ""
    return Pick(
        kind="place",
        time=iso_time(round(_number(fields["at_s"], _MOST_S) * 1e9)),
        topic=grid,
        frame=_name(fields["frame"]),
        x_m=round(x_m, 3),
        y_m=round(y_m, 3),
        about=about,
    )


def _point(fields: Mapping[str, Any]) -> Pick:
    x_m, y_m, z_m = _numbers(fields["xyz"], _MOST_M, 3)
    time_of, age_s = _when(fields)
    return Pick(
        kind="point",
        time=time_of,
        age_s=age_s,
        topic=_name(fields["topic"]),
        frame=_name(fields["frame"]),
        x_m=x_m,
        y_m=y_m,
        z_m=z_m,
        view_frame=_name(fields["in_frame"]),
        view_xyz_m=_numbers(fields["in"], _MOST_M, 3),
    )


def _box(fields: Mapping[str, Any]) -> Pick:
    left, top, right, bottom = _pixels(fields["box"], 4)
    width, height = _pixels(fields["size"], 2)
    if not (left <= right < width and top <= bottom < height):
        raise ValueError("the box is not within the picture")
    time_of, age_s = _when(fields)
    return Pick(
        kind="box",
        time=time_of,
        age_s=age_s,
        topic=_name(fields["topic"]),
        frame=_name(fields["frame"]),
        box_px=(left, top, right, bottom),
        image_size_px=(width, height),
    )


def _plot_time(fields: Mapping[str, Any]) -> Pick:
    time_of, age_s = _when(fields)
    topic, values = _name(fields["topic"]), _values(fields["values"])
    return Pick(kind="time", time=time_of, age_s=age_s, topic=topic, values=values)


_KINDS: Mapping[str, Callable[[Mapping[str, Any]], Pick]] = {
    "place": _place,
    "point": _point,
    "box": _box,
    "time": _plot_time,
}


def _when(fields: Mapping[str, Any]) -> tuple[str, float]:
    """Return the time of the picked data, and how old it was when picked."""
    at_s, now_s = _number(fields["at_s"], _MOST_S), _number(fields["now_s"], _MOST_S)
    return iso_time(round(at_s * 1e9)), round(max(now_s - at_s, 0.0), 1)


def _name(value: Any) -> str:
    if not isinstance(value, str):
        raise TypeError("a text is expected")
    return value[:_MOST_NAME]


def _number(value: Any, most: float) -> float:
    if isinstance(value, bool) or not isinstance(value, (int, float)) or not math.isfinite(value):
        raise TypeError("a number is expected")
    if abs(value) > most:
        raise ValueError("this is too large")
    return float(value)


def _maybe(value: Any, most: float) -> float | None:
    return None if value is None else _number(value, most)


def _numbers(value: Any, most: float, count: int) -> Sequence[float]:
    found = cast("list[Any]", value) if isinstance(value, list) else []
    if len(found) != count:
        raise ValueError(f"{count} numbers are expected")
    return [round(_number(one, most), 3) for one in found]


def _pixels(value: Any, count: int) -> Sequence[int]:
    found = [int(one) for one in _numbers(value, _MOST_PIXELS, count)]
    if min(found) < 0:
        raise ValueError("a pixel begins at 0")
    return tuple(found)


def _values(value: Any) -> Sequence[PickedValue]:
    if not isinstance(value, list):
        raise TypeError("values are expected")
    return [
        PickedValue(
            name=_name(one["name"]), value=_number(one["value"], math.inf), unit=_name(one["unit"])[:_MOST_UNIT]
        )
        for one in cast("list[Any]", value)[:MOST_VALUES]
    ]


def _cell(value: int, *, is_cost: bool) -> str:
    if not 0 <= value <= 100:
        return "unknown"
    if is_cost:
        return f"cost {value} of 100"
    return "occupied" if value >= _OCCUPIED else "free"
