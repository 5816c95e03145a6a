"""Draw axes in metres around a view from above, with the origin of the frame and the robot."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from PIL import Image, ImageDraw

from ros2_mcp.model.pictures import Place
from ros2_mcp.pictures.plot import Span, labels, letters, ticks, width_of
from ros2_mcp.pictures.raster import Pixels

ROOM_PX = 120
"""Upper bound of the pixels that axes add to a side: labels of nine characters on the left, half a label on the
right."""
_LEAST_SIDE = 300
"""Pixels. Smaller pictures have no room for axes."""
_FARTHEST_M = 1e9
"""Metres. Labels of ticks beyond it would look alike; only broken maps have such coordinates."""
_TOP, _RIGHT, _BOTTOM, _GAP, _TICK = 24, 24, 46, 10, 6
"""Pixels around the ground: above (a line of text), right (half a label), below (two lines); from a label to its tick;
and the length of a tick."""
_BETWEEN_X, _BETWEEN_Y = 80, 40
"""Approximate pixels between ticks: the width of a label in x, and what the eye follows easily in y."""
_ARROW, _ROBOT = 36, 13
"""Pixels: length of the arrows at the origin, and from the robot's centre to its tip: easily seen, yet small against a
room."""
_INK, _PAPER, _X, _Y, ROBOT_COLOUR = "#222222", "#ffffff", "#e02020", "#10a030", "#ff8c00"


@dataclass(frozen=True, slots=True)
class Ground:
    """The coordinates of a view from above: the coordinates of its lower left corner, and metres per pixel.

    `origin` is the pose of the frame's own origin in these coordinates; `robot` that of the robot, if known. `axes`
    names the coordinates.
    """

    x_min_m: float
    y_min_m: float
    metres_per_pixel: float
    origin: Place
    robot: Place | None = None
    axes: tuple[str, str] = ("x", "y")


@dataclass(frozen=True, slots=True)
class Framed:
    """A picture with its axes, and the position of the upper left pixel of the ground in it."""

    pixels: Pixels
    left_px: int
    top_px: int


def has_axes(max_side: int) -> bool:
    """Return whether a picture of that size has room for axes."""
    return max_side >= _LEAST_SIDE


def with_axes(pixels: Pixels, ground: Ground) -> Framed:
    """Add axes, arrows at the origin, and the robot, if they lie within the ground."""
    height, width = pixels.shape[:2]
    metres = ground.metres_per_pixel
    finite = math.isfinite(ground.x_min_m + ground.y_min_m + metres)
    if not finite or metres <= 0 or max(abs(ground.x_min_m), abs(ground.y_min_m)) > _FARTHEST_M:
        return Framed(pixels, 0, 0)
    x = Span(ground.x_min_m, ground.x_min_m + width * metres)
    y = Span(ground.y_min_m, ground.y_min_m + height * metres)
    x_ticks, y_ticks = ticks(x, width // _BETWEEN_X), ticks(y, height // _BETWEEN_Y)
    left = math.ceil(max(map(width_of, labels(y_ticks)))) + _GAP + _TICK
    image = Image.new("RGB", (left + width + _RIGHT, _TOP + height + _BOTTOM), _PAPER)
    image.paste(Image.fromarray(pixels).convert("RGB"), (left, _TOP))
    pen = ImageDraw.Draw(image)
    bottom, right = _TOP + height, left + width
    pen.rectangle([left - 1, _TOP - 1, right, bottom], outline=_INK)
    for value, label in zip(x_ticks, labels(x_ticks), strict=True):
        at = left + (value - x.low) / metres
        pen.line([at, bottom, at, bottom + _TICK], _INK)
        pen.text((at, bottom + _TICK + 1), label, _INK, letters(), anchor="ma")
    for value, label in zip(y_ticks, labels(y_ticks), strict=True):
        at = bottom - (value - y.low) / metres
        pen.line([left - 1 - _TICK, at, left - 1, at], _INK)
        pen.text((left - _GAP, at), label, _INK, letters(), anchor="rm")
    pen.text(((left + right) / 2, bottom + 25), f"{ground.axes[0]} [m]", _INK, letters(), anchor="ma")
    pen.text((left, 3), f"{ground.axes[1]} [m]", _INK, letters(), anchor="la")

    def pixel(place: Place) -> tuple[float, float] | None:
        if not (x.low <= place.x_m <= x.high and y.low <= place.y_m <= y.high):
            return None
        return left + (place.x_m - x.low) / metres, bottom - (place.y_m - y.low) / metres

    if at_origin := pixel(ground.origin):
        _draw_arrow(pen, at_origin, ground.origin.yaw_rad, _X)
        _draw_arrow(pen, at_origin, ground.origin.yaw_rad + math.pi / 2, _Y)
    if ground.robot and (at_robot := pixel(ground.robot)):
        _draw_robot(pen, at_robot, ground.robot.yaw_rad)
    return Framed(np.asarray(image), left, _TOP)


def marks_in_words(ground: Ground) -> str:
    """Return a legend for the marks, with the pose of the robot."""
    words = "Axes in metres; the red and green arrows are x and y at the origin of the frame."
    if robot := ground.robot:
        heading = f"heading {math.degrees(robot.yaw_rad):.0f}° from x towards y"
        words += f" The robot, orange, is at ({robot.x_m:.2f}, {robot.y_m:.2f}) m on these axes, {heading}."
    return words


def _towards(at: tuple[float, float], yaw_rad: float, length: float) -> tuple[float, float]:
    """Return the pixel at this distance and direction; the y axis of pixels points down."""
    return at[0] + length * math.cos(yaw_rad), at[1] - length * math.sin(yaw_rad)


def _draw_arrow(pen: ImageDraw.ImageDraw, at: tuple[float, float], yaw_rad: float, colour: str) -> None:
    pen.line([at, _towards(at, yaw_rad, _ARROW - 6)], colour, 3)
    head = [_towards(_towards(at, yaw_rad, _ARROW - 8), yaw_rad + side, 5) for side in (math.pi / 2, -math.pi / 2)]
    pen.polygon([_towards(at, yaw_rad, _ARROW), *head], fill=colour)


def _draw_robot(pen: ImageDraw.ImageDraw, at: tuple[float, float], yaw_rad: float) -> None:
    corners = [_towards(at, yaw_rad + turn, length) for turn, length in ((0.0, _ROBOT), (2.5, _ROBOT), (-2.5, _ROBOT))]
    pen.polygon(corners, fill=ROBOT_COLOUR, outline=_INK)
