"""Draw curves: panels one below the other over one x axis, with ticks, grid and legend."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cache
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont

from ros2_mcp.model.pictures import BOUNDS, Picture
from ros2_mcp.pictures.raster import Raster, finished

Numbers = NDArray[np.float64]

COLOURS = (
    *("#1f6fc4", "#d95f02", "#1b9e4b", "#c2185b", "#7a4fc9", "#8c5a2b"),
    *("#00949e", "#b8860b", "#e377c2", "#5c6b7a", "#6b8e00", "#20304f"),
)
"""One colour for each curve, in this order; there are at most as many curves as colours."""
NOT_FINITE = "#e00000"
_TEXT, _GREY, _GRID, _FRAME, _PAPER = "#222222", "#666666", "#e4e4e4", "#888888", "#ffffff"
_SIZE, _SMALL, _ROW = 15, 14, 21
"""Pixels: size of the title, size of all other letters, and height of a line of text."""
_EDGE, _GAP = 14, 12
"""Pixels: the margin at the edges of the picture, and the gap between panels."""
_FINE = 2
"""Lines are drawn this many times larger and scaled down, so that they are smooth."""
_DOTS = 60
"""Curves of up to this many points show each point as a dot, to reveal the rate; more dots would be a thick line."""
_MARK = 4
"""Pixels from the centre of the mark of a non-finite value to its edge."""
_PADDING = 0.05
"""Share of a span that stays free on both sides, so that extremes do not lie on the frame."""
_LARGEST = 8e307
"""Larger values are clipped, because the span of the axis would not be finite."""
_LONGEST_LABEL = 9
"""Characters. Longer tick labels use an exponent, because they would take up the curves' room."""


@dataclass(frozen=True, slots=True)
class Span:
    """The range of an axis that is shown, `low` less than `high`."""

    low: float
    high: float

    @property
    def length(self) -> float:
        """Length of the range."""
        return self.high - self.low


@dataclass(frozen=True, slots=True)
class Curve:
    """Points in order; `apart[i]` is true if point i is not joined to the previous point.

    A point whose y (or x) is not finite is not drawn but marked at the panel's edge.
    """

    name: str
    x: Numbers
    y: Numbers
    apart: NDArray[np.bool_]


@dataclass(frozen=True, slots=True)
class Panel:
    """Curves over one y axis."""

    curves: Sequence[Curve]
    y_label: str = ""


@dataclass(frozen=True, slots=True)
class Figure:
    """The panels to draw, with title and x axis.

    With `equal`, x and y have the same scale; with `ends`, a ring marks the start of a curve and a disc its end.
    """

    panels: Sequence[Panel]
    title: str
    x_label: str
    x_span: Span | None = None
    equal: bool = False
    ends: bool = False


@dataclass(frozen=True, slots=True)
class Frame:
    """The area of a panel in the picture, in pixels, and the ranges that it shows."""

    left: float
    top: float
    right: float
    bottom: float
    x: Span
    y: Span

    def pixels(self, x: Numbers, y: Numbers) -> tuple[Numbers, Numbers]:
        """Return the pixels of points, y downwards."""
        across = self.left + (x - self.x.low) / self.x.length * (self.right - self.left)
        return across, self.bottom - (y - self.y.low) / self.y.length * (self.bottom - self.top)


@dataclass(frozen=True, slots=True)
class Drawn:
    """The picture (RGB) with the frame of each panel."""

    image: Image.Image
    frames: Sequence[Frame]


def draw(figure: Figure, width: int, height: int) -> Drawn:
    """Draw a figure at that size in pixels."""
    frames = _frames(figure, width, height)
    fine = Image.new("RGB", (width * _FINE, height * _FINE), _PAPER)
    colours = iter(COLOURS)
    coloured = [[(curve, next(colours)) for curve in panel.curves] for panel in figure.panels]
    for frame, curves in zip(frames, coloured, strict=True):
        _draw_lines(ImageDraw.Draw(fine), frame, curves, figure.ends)
    image = fine.reduce(_FINE)
    pen = ImageDraw.Draw(image)
    pen.text((_EDGE, _EDGE), _fitted(figure.title, width - 2 * _EDGE), _TEXT, _font(_SIZE))
    for panel, frame, curves in zip(figure.panels, frames, coloured, strict=True):
        _write_panel(pen, panel, frame, curves, width)
    _write_x_axis(pen, frames[-1], figure.x_label)
    return Drawn(image, frames)


def plotted(figure: Figure, width: int, height: int, note: str) -> Picture:
    """Draw a figure as an encoded picture; with fewer colours, then smaller, if it would have too many bytes."""
    return finished(Raster(np.asarray(draw(figure, width, height).image), note, "drawing"), BOUNDS)


# ── where things are ─────────────────────────────────────────────────────────────────────────────────────────────


def _frames(figure: Figure, width: int, height: int) -> list[Frame]:
    x = figure.x_span or span_of([curve.x for panel in figure.panels for curve in panel.curves])
    spans = [span_of([curve.y for curve in panel.curves]) for panel in figure.panels]
    legends = [len(_legend_rows(panel, width)) * _ROW + 6 for panel in figure.panels]
    top = _EDGE + _ROW + 4
    room = height - top - 2 * _ROW - _EDGE - sum(legends) - _GAP * (len(spans) - 1)
    panel_height = room / len(spans)
    left = _EDGE + max(width_of(label) for span in spans for label in labels(ticks(span, _most(panel_height)))) + 10
    right = width - _EDGE - 16
    frames: list[Frame] = []
    for span, legend in zip(spans, legends, strict=True):
        top += legend
        frames.append(Frame(round(left), round(top), right, round(top + panel_height), x, span))
        top += panel_height + _GAP
    return [_equal(frame) for frame in frames] if figure.equal else frames


def _equal(frame: Frame) -> Frame:
    """Return the frame with one of its ranges widened, so that both axes have the same scale."""
    width, height = frame.right - frame.left, frame.bottom - frame.top
    scale = max(frame.x.length / width, frame.y.length / height)
    more_x, more_y = (scale * width - frame.x.length) / 2, (scale * height - frame.y.length) / 2
    x, y = frame.x, frame.y
    return replace(frame, x=Span(x.low - more_x, x.high + more_x), y=Span(y.low - more_y, y.high + more_y))


def _most(pixels: float) -> int:
    """Return the number of ticks for the height of a panel."""
    return max(3, int(pixels / 36))


def _x_ticks(frame: Frame) -> list[float]:
    return ticks(frame.x, max(3, int((frame.right - frame.left) / 90)))


# ── axes: which range, where the ticks are, how they are written ────────────────────────────────────────────────


def span_of(values: Sequence[NDArray[np.float64]]) -> Span:
    """Return a range that contains all finite values, with a margin; 0 to 1 if there are none."""
    lows, highs = zip(*(_bounds(numbers) for numbers in values), strict=True) if values else ((), ())
    low, high = min(lows, default=math.inf), max(highs, default=-math.inf)
    if low > high:
        return Span(0.0, 1.0)
    room = (high - low) * _PADDING
    if room <= max(abs(low), abs(high)) * 1e-13:
        room = max(abs(low), abs(high)) * _PADDING or 1.0
    return Span(low - room, high + room)


def _bounds(values: NDArray[np.float64]) -> tuple[float, float]:
    finite = values[np.isfinite(values)]
    if not len(finite):
        return math.inf, -math.inf
    return max(float(finite.min()), -_LARGEST), min(float(finite.max()), _LARGEST)


def ticks(span: Span, most: int) -> list[float]:
    """Return evenly spaced round numbers (1, 2 or 5 times a power of ten) in the span: about `most`, at least two."""
    step = round_step(span.length / max(most, 3))
    if len(_multiples(span, step)) < 2:
        step = round_step(span.length / max(2 * most, 6))
    return [index * step for index in _multiples(span, step)]


def _multiples(span: Span, step: float) -> range:
    return range(math.ceil(span.low / step), math.floor(span.high / step) + 1)


def round_step(least: float) -> float:
    """Return the least 1, 2 or 5 times a power of ten that is not below `least`: the step of ticks and grid lines."""
    power = 10.0 ** math.floor(math.log10(least))
    return next(factor * power for factor in (1, 2, 5, 10) if factor * power >= least * (1 - 1e-9))


def labels(values: Sequence[float]) -> list[str]:
    """Return the labels of two or more ticks, with as many decimals as the step requires."""
    step = values[1] - values[0]
    largest = max(map(abs, values))
    decimals = max(0, -math.floor(math.log10(step) + 1e-9))
    whole = len(f"{largest:.0f}") if largest < 1e15 else _LONGEST_LABEL + 1
    if whole + decimals <= _LONGEST_LABEL:
        return [f"{value if abs(value) > step / 2 else 0:.{decimals}f}" for value in values]  # never -0.0
    digits = max(0, math.floor(math.log10(largest) + 1e-9) - math.floor(math.log10(step) + 1e-9))
    return ["0" if value == 0 else f"{value:.{digits}e}" for value in values]


# ── lines ────────────────────────────────────────────────────────────────────────────────────────────────────────


def _draw_lines(pen: ImageDraw.ImageDraw, frame: Frame, curves: Sequence[tuple[Curve, str]], ends: bool) -> None:
    box = [frame.left * _FINE, frame.top * _FINE, frame.right * _FINE, frame.bottom * _FINE]
    for across, _ in _places(frame, _x_ticks(frame), vertical=False):
        pen.line([across * _FINE, box[1], across * _FINE, box[3]], _GRID, _FINE)
    for down, _ in _places(frame, ticks(frame.y, _most(frame.bottom - frame.top)), vertical=True):
        pen.line([box[0], down * _FINE, box[2], down * _FINE], _GRID, _FINE)
    pen.rectangle(box, outline=_FRAME, width=_FINE)
    for curve, colour in curves:
        _draw_curve(pen, frame, curve, colour)
    for curve, colour in curves if ends else ():
        _draw_ends(pen, frame, curve, colour)
    for curve, colour in curves:
        _draw_marks(pen, frame, curve, colour)


def _places(frame: Frame, values: Sequence[float], *, vertical: bool) -> list[tuple[float, str]]:
    """Return the pixel coordinate and the label of each tick of an axis."""
    at = np.asarray(values, np.float64)
    across, down = frame.pixels(at, at)
    return list(zip((down if vertical else across).tolist(), labels(values), strict=True))


def _draw_curve(pen: ImageDraw.ImageDraw, frame: Frame, curve: Curve, colour: str) -> None:
    with_dots = np.count_nonzero(_finite(curve)) <= _DOTS
    for x, y in _strokes(curve):
        across, down = (np.rint(places * _FINE) for places in frame.pixels(x, y))
        points = _thinned(across, down)
        if len(points) > 1:
            pen.line(points, colour, 2 * _FINE, joint="curve" if len(points) < 5000 else None)
        for point in points if with_dots or len(points) == 1 else ():
            _dot(pen, point, 3 * _FINE, colour)


def _finite(curve: Curve) -> NDArray[np.bool_]:
    return np.isfinite(curve.x) & np.isfinite(curve.y)


def _strokes(curve: Curve) -> Iterator[tuple[Numbers, Numbers]]:
    """Yield the connected parts of a curve."""
    drawn = _finite(curve)
    begins = curve.apart | ~drawn | np.concatenate(([False], ~drawn[:-1]))
    edges = [0, *np.flatnonzero(begins).tolist(), len(drawn)]
    for start, end in pairwise(edges):
        kept = drawn[start:end]
        if kept.any():
            yield curve.x[start:end][kept], curve.y[start:end][kept]


def _thinned(across: Numbers, down: Numbers) -> list[tuple[float, float]]:
    """Keep for each column of pixels the first, the highest, the lowest and the last point."""
    starts = np.flatnonzero(np.concatenate(([True], np.diff(across) != 0)))
    lasts = np.append(starts[1:], len(across)) - 1
    rows = (down[starts], np.minimum.reduceat(down, starts), np.maximum.reduceat(down, starts), down[lasts])
    points = list(zip(np.repeat(across[starts], 4).tolist(), np.stack(rows, axis=1).ravel().tolist(), strict=True))
    return [point for index, point in enumerate(points) if not index or point != points[index - 1]]


def _draw_ends(pen: ImageDraw.ImageDraw, frame: Frame, curve: Curve, colour: str) -> None:
    """Draw a ring at the start of the curve, and a disc at its end."""
    drawn = np.flatnonzero(_finite(curve))
    if len(drawn):
        ends = drawn[[0, -1]]
        across, down = (places * _FINE for places in frame.pixels(curve.x[ends], curve.y[ends]))
        _dot(pen, (across[1], down[1]), 6 * _FINE, colour)
        _dot(pen, (across[0], down[0]), 7 * _FINE, colour)
        _dot(pen, (across[0], down[0]), 4 * _FINE, _PAPER)


def _dot(pen: ImageDraw.ImageDraw, at: tuple[float, float], radius: float, colour: str) -> None:
    pen.ellipse([at[0] - radius, at[1] - radius, at[0] + radius, at[1] + radius], fill=colour)


def _draw_marks(pen: ImageDraw.ImageDraw, frame: Frame, curve: Curve, colour: str) -> None:
    """Mark NaN by a cross at the bottom, infinities by a wedge at the top or bottom."""
    unshown = np.isfinite(curve.x) & ~np.isfinite(curve.y)
    across, _ = frame.pixels(curve.x[unshown], np.zeros(int(unshown.sum())))
    for column, value in dict.fromkeys(zip(np.rint(across).tolist(), map(str, curve.y[unshown]), strict=True)):
        x, size = column * _FINE, _MARK * _FINE
        y = (frame.top + _MARK + 3 if value == "inf" else frame.bottom - _MARK - 3) * _FINE
        if value == "nan":
            pen.line([x - size, y - size, x + size, y + size], NOT_FINITE, _FINE)
            pen.line([x - size, y + size, x + size, y - size], NOT_FINITE, _FINE)
        else:
            tip = -size if value == "inf" else size
            pen.polygon([(x, y + tip), (x - size, y - tip), (x + size, y - tip)], fill=colour)


# ── words ────────────────────────────────────────────────────────────────────────────────────────────────────────


def _write_panel(
    pen: ImageDraw.ImageDraw, panel: Panel, frame: Frame, curves: Sequence[tuple[Curve, str]], width: int
) -> None:
    for down, label in _places(frame, ticks(frame.y, _most(frame.bottom - frame.top)), vertical=True):
        pen.text((frame.left - 8, down), label, _TEXT, letters(), anchor="rm")
    colours = {curve.name: colour for curve, colour in curves}
    rows = _legend_rows(panel, width)
    top = frame.top - 6 - len(rows) * _ROW
    if panel.y_label:
        pen.text((_EDGE, top + _ROW / 2), f"[{panel.y_label}]", _GREY, letters(), anchor="lm")
    for number, row in enumerate(rows):
        for at, name in row:
            middle = top + number * _ROW + _ROW / 2
            pen.line([at, middle, at + 20, middle], colours[name], 4)
            pen.text((at + 26, middle), _fitted(name, width - at - 26 - _EDGE), _TEXT, letters(), anchor="lm")
    if not any(_finite(curve).any() for curve, _ in curves):
        centre = ((frame.left + frame.right) / 2, (frame.top + frame.bottom) / 2)
        pen.text(centre, "no values", _GREY, _font(_SIZE), anchor="mm")


def _write_x_axis(pen: ImageDraw.ImageDraw, frame: Frame, label: str) -> None:
    for across, text in _places(frame, _x_ticks(frame), vertical=False):
        pen.text((across, frame.bottom + 6), text, _TEXT, letters(), anchor="ma")
    centre = ((frame.left + frame.right) / 2, frame.bottom + 6 + _ROW)
    pen.text(centre, label, _GREY, letters(), anchor="ma")


def _legend_rows(panel: Panel, width: int) -> list[list[tuple[float, str]]]:
    """Return the legend's rows, each name with its distance from the left."""
    left = _EDGE + (width_of(f"[{panel.y_label}]") + 16 if panel.y_label else 0)
    rows: list[list[tuple[float, str]]] = [[]]
    at = left
    for curve in panel.curves:
        needed = 26 + width_of(curve.name)
        if rows[-1] and at + needed > width - _EDGE:
            rows.append([])
            at = left
        rows[-1].append((at, curve.name))
        at += needed + 22
    return rows


def _fitted(text: str, width: float) -> str:
    """Return the text, truncated to the width."""
    if width_of(text) <= width:
        return text
    while text and width_of(text + "…") > width:
        text = text[:-1]
    return text + "…"


def width_of(text: str) -> float:
    """Return the width of a text in the font of labels, in pixels."""
    return letters().getlength(text)


def letters(size: int = _SMALL) -> ImageFont.FreeTypeFont | ImageFont.ImageFont:
    """Return the font of labels, at its usual or another size."""
    return _font(size)


@cache
def _font(size: int) -> ImageFont.FreeTypeFont | ImageFont.ImageFont:
    return ImageFont.load_default(size)
