"""Plots of the growth: SVG with logarithmic axes on an opaque background, light or dark as the reader's system."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from statistics import fmean
from typing import Any

WIDTH, HEIGHT = 860, 380
TOP, BOTTOM, LINE = 52, 332, 15
"""Pixels: upper and lower edge of a panel, and the height of a line of text."""
LIGHT = ("#1f6fc4", "#c05400", "#15803d", "#b3125a", "#6d3fc0", "#7a5200", "#5a6672")
DARK = ("#6fb1ff", "#ff9d4d", "#5fd38a", "#ff7fb5", "#b99cff", "#e0b860", "#aab6c2")
Numbers = Sequence[float]


@dataclass(frozen=True)
class Panel:
    """Curves with one unit; `curves` maps keys of the points to labels."""

    title: str
    left: int
    right: int
    curves: Mapping[str, str]
    is_linear: bool = False


STOPS = {"stop_ms": "ros2_stop → zero", "stop_beside_ms": "ros2_stop, others ask"}
MEMORY = Panel(
    "memory, MB", 615, 785, {"server_mb": "server", "bridge_mb": "bridge", "stopper_mb": "stopper"}, is_linear=True
)
LISTS = {"topic_list_default_ms": "ros2_topic_list (200)", "node_list_ms": "ros2_node_list", "robot_ms": "ros2_robot"}
GRAPH = {"first_ms": "start → whole listing", "topic_list_ms": "ros2_topic_list, all", **LISTS, **STOPS}
CLIENTS = {"all_at_once_ms": "all list at once", **LISTS, **STOPS}
BAGS = {"open_ms": "open", "last100_ms": "last 100 messages", "statistics_ms": "statistics of a topic"}
FIGURES: Mapping[str, tuple[str, Sequence[Panel]]] = {
    "topics": ("topics of the robot", [Panel("time, ms", 60, 400, GRAPH), MEMORY]),
    "nodes": ("nodes of the robot", [Panel("time, ms", 60, 400, GRAPH), MEMORY]),
    "clients": ("clients of one HTTP server", [Panel("time, ms", 60, 400, CLIENTS), MEMORY]),
    "bags": ("size of the bag, GB", [Panel("time, ms", 60, 560, BAGS)]),
}


def slope(sizes: Numbers, values: Numbers) -> float:
    """Return the slope of the best fit of log(value) over log(size): 1 is linear growth, 0 is none."""
    x, y = [math.log(size) for size in sizes], [math.log(value) for value in values]
    middle_x, middle_y = fmean(x), fmean(y)
    products = sum((a - middle_x) * (b - middle_y) for a, b in zip(x, y, strict=True))
    return products / sum((a - middle_x) ** 2 for a in x)


def draw(found: Mapping[str, Any], folder: Path) -> str:
    """Draw the points into the folder; return a table of the slopes, over all points and over the last step."""
    lines = ["figure   what                       first     last   slope  last step"]
    for what, (x_label, panels) in FIGURES.items():
        points = [_in_ms(point) for point in found.get(what, ())]
        if len(points) < 2:
            continue
        sizes = [point["n"] for point in points]
        parts: list[str] = []
        for panel in panels:
            curves = {
                words: [point[key] for point in points] for key, words in panel.curves.items() if key in points[0]
            }
            parts += _panel(panel, x_label, sizes, curves)
            for words, values in curves.items():
                last = slope(sizes[-2:], values[-2:])
                fitted = slope(sizes, values)
                lines.append(f"{what:8} {words:24} {values[0]:8.1f} {values[-1]:8.1f} {fitted:7.2f} {last:10.2f}")
        (folder / f"growth-{what}.svg").write_text(_page(parts))
    return "\n".join(lines)


def _in_ms(point: Mapping[str, float]) -> dict[str, float]:
    """Return a point with its size under `n`, and with seconds converted to milliseconds."""
    seconds = {f"{key[:-2]}_ms": value * 1000 for key, value in point.items() if key.endswith("_s")}
    return {**point, **seconds, "n": point["n"] if "n" in point else point["gb"]}


def _page(parts: Sequence[str]) -> str:
    light, dark = (
        "".join(f".c{number}{{stroke:{one}}}.t{number}{{fill:{one}}}" for number, one in enumerate(colours))
        for colours in (LIGHT, DARK)
    )
    style = (
        "text{font:12px sans-serif;fill:#222}.paper{fill:#fff}.grid{stroke:#ddd}path{fill:none;stroke-width:2}"
        f".guide{{stroke:#888;stroke-dasharray:4 4}}{light}@media(prefers-color-scheme:dark){{text{{fill:#ddd}}"
        f".paper{{fill:#161b22}}.grid{{stroke:#333b45}}{dark}}}"
    )
    head = f'<svg xmlns="http://www.w3.org/2000/svg" width="{WIDTH}" height="{HEIGHT}" viewBox="0 0 {WIDTH} {HEIGHT}">'
    return "\n".join(
        [head, f"<style>{style}</style>", '<rect class="paper" width="100%" height="100%"/>', *parts, "</svg>\n"]
    )


def _panel(panel: Panel, x_label: str, sizes: Numbers, curves: Mapping[str, Numbers]) -> list[str]:
    every = [value for values in curves.values() for value in values]
    low_x, high_x = math.log10(sizes[0]), math.log10(sizes[-1])
    low = 0.0 if panel.is_linear else math.floor(math.log10(min(every)))
    high = max(every) * 1.1 if panel.is_linear else math.ceil(math.log10(max(every)))

    def across(size: float) -> float:
        return round(panel.left + (math.log10(size) - low_x) / (high_x - low_x) * (panel.right - panel.left), 1)

    def height(value: float) -> float:
        share = ((value if panel.is_linear else math.log10(value)) - low) / (high - low)
        return round(BOTTOM - share * (BOTTOM - TOP), 1)

    step = 10 ** math.floor(math.log10(high)) / 2 if panel.is_linear else 1
    ticks = (
        [number * step for number in range(int(high / step) + 1)]
        if panel.is_linear
        else [10.0**power for power in range(int(low), int(high) + 1)]
    )
    parts = [_text(panel.left, TOP - 16, panel.title, weight="bold")]
    for tick in ticks:
        parts.append(
            f'<line class="grid" x1="{panel.left}" x2="{panel.right}" y1="{height(tick)}" y2="{height(tick)}"/>'
        )
        parts.append(_text(panel.left - 6, height(tick) + 4, f"{tick:,g}" if tick < 1e6 else f"{tick:,.0f}", "end"))
    for size in sizes:
        parts.append(f'<line class="grid" x1="{across(size)}" x2="{across(size)}" y1="{TOP}" y2="{BOTTOM}"/>')
        parts.append(_text(across(size), BOTTOM + 18, f"{size:g}", "middle"))
    parts.append(_text((panel.left + panel.right) / 2, BOTTOM + 38, x_label, "middle"))
    if not panel.is_linear:
        parts += _guide(sizes, low, high, across, height)
    ends = {words: height(values[-1]) for words, values in curves.items()}
    for number, values in enumerate(curves.values()):
        places = [(across(size), height(value)) for size, value in zip(sizes, values, strict=True)]
        parts.append(f'<path class="c{number % len(LIGHT)}" d="M{" L".join(f"{x} {y}" for x, y in places)}"/>')
        parts += [f'<circle class="t{number % len(LIGHT)}" cx="{x}" cy="{y}" r="3"/>' for x, y in places]
    for words, y in _apart(ends).items():
        number = list(curves).index(words) % len(LIGHT)
        parts.append(
            f'<line class="c{number}" x1="{panel.right}" y1="{ends[words]}" x2="{panel.right + 10}" y2="{y}"/>'
        )
        parts.append(_text(panel.right + 13, y + 4, words))
    return parts


def _guide(sizes: Numbers, low: float, high: float, across: Any, height: Any) -> list[str]:
    """Return a dashed line of linear growth, from the lower left corner to the edge of the panel."""
    end = min(sizes[-1], sizes[0] * 10 ** (high - low))
    x, y = across(end), height(10**low * end / sizes[0])
    line = f'<line class="guide" x1="{across(sizes[0])}" y1="{height(10**low)}" x2="{x}" y2="{y}"/>'
    beside = across(sizes[0] * (end / sizes[0]) ** 0.2), height(10**low * (end / sizes[0]) ** 0.2)
    return [line, _text(beside[0] + 8, beside[1] + 8, "linear")]


def _apart(ends: Mapping[str, float]) -> dict[str, float]:
    """Return the heights of the labels: each at the end of its curve, moved down where it would overlap the one
    above."""
    placed: dict[str, float] = {}
    for words in sorted(ends, key=lambda one: ends[one]):
        placed[words] = max(ends[words], max(placed.values(), default=-math.inf) + LINE)
    words = list(placed)
    placed[words[-1]] = min(placed[words[-1]], BOTTOM)
    for lower, upper in pairwise(reversed(words)):
        placed[upper] = min(placed[upper], placed[lower] - LINE)
    return placed


def _text(x: float, y: float, text: str, anchor: str = "start", weight: str = "") -> str:
    bold = f' font-weight="{weight}"' if weight else ""
    return f'<text x="{round(x, 1)}" y="{round(y, 1)}" text-anchor="{anchor}"{bold}>{text}</text>'
