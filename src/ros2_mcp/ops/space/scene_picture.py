"""The request and the result of `ros2_scene`."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

from ros2_mcp.model.meanings import Meaning
from ros2_mcp.model.text import named
from ros2_mcp.ops.results.results import IF_ANY, SAID, WithPictures

_FLAT_M = 0.05
"""Heights below this are not reported: a base on the ground may be off its map's plane by as much."""


@dataclass(frozen=True, slots=True)
class Way:
    """A path that no topic publishes, such as a planned path: points (x, y) in m in `frame`; its end is drawn as a
    goal.

    `marks` (name, x, y) are notable places along the path.
    """

    name: str
    frame: str
    points: Sequence[Sequence[float]]
    marks: Sequence[tuple[str, float, float]] = ()


@dataclass(frozen=True, slots=True)
class SceneRequest:
    """A request: the frame (empty: that of the grid), the grid (a topic, or `costmap`; empty: the map), the radius
    around the robot in m (None: everything), and a path to draw.
    """

    frame: str = ""
    grid: str = ""
    radius_m: float | None = None
    way: Way | None = None


@dataclass(frozen=True, slots=True)
class SceneLayer:
    """Something in the picture: a `grid`, `costmap`, `scan`, `path`, `goal`, `place`, `footprint`, `keep-out zone`, or
    the `links` that joints move.

    `name` is its topic, or the name of a place or zone. `x_m`, `y_m` and `yaw_deg` give the pose of a goal or place, or
    the end of a path, in the picture's frame; null for others, and the yaw null if it has none. `age_s` is null if not
    known. `from_before` is set if the message was sent before the request, and gives its age.
    """

    kind: str
    name: str
    x_m: float | None = None
    y_m: float | None = None
    yaw_deg: float | None = None
    age_s: float | None = None
    from_before: str = field(default="", metadata=IF_ANY)


@dataclass(frozen=True, slots=True, kw_only=True)
class ScenePicture(WithPictures):
    """The surroundings of the robot in the frame `frame_id`, x to the right, y up, in metres, with a grid line every
    `grid_spacing_m`.

    Pixel (`left_px` + column, `top_px` + row) has its corner at x = `x_min_m` + column · `metres_per_pixel`, y =
    `y_max_m` - row · `metres_per_pixel`; outside are labels. The robot's pose is null if it is unknown, its age null if
    the transform is static. `meaning` is that of the first scan. `missing` lists what is not shown, and why. `at` is
    the time shown.
    """

    frame_id: str = field(metadata=SAID)
    x_min_m: float
    x_max_m: float
    y_min_m: float
    y_max_m: float
    grid_spacing_m: float = field(metadata=SAID)
    metres_per_pixel: float
    left_px: int
    top_px: int
    robot_x_m: float | None
    robot_y_m: float | None
    robot_z_m: float | None
    robot_yaw_deg: float | None
    robot_age_s: float | None = field(metadata=SAID)
    layers: Sequence[SceneLayer]
    meaning: Meaning | None = field(metadata=SAID)
    missing: Sequence[str] = field(metadata=SAID)
    at: str
    seconds_from_start: float | None
    source: str

    def summary(self) -> list[str]:
        """Return a line on the picture, the meaning of the scan, and a line for each thing that is missing."""
        width, height = self.x_max_m - self.x_min_m, self.y_max_m - self.y_min_m
        where = ""
        if self.robot_x_m is not None and self.robot_yaw_deg is not None:
            old = ", static" if self.robot_age_s is None else f", {self.robot_age_s:.2f} s ago"
            high = f", {self.robot_z_m:.2f} m high" if abs(self.robot_z_m or 0.0) >= _FLAT_M else ""
            at = f"({self.robot_x_m:.2f}, {self.robot_y_m:.2f}) m{high}"
            where = f" Robot at {at}, heading {round(self.robot_yaw_deg)}°{old}."
        shown = ", ".join(_in_words(layer) for layer in self.layers) or "only grid lines"
        grid = f"grid lines every {self.grid_spacing_m:g} m"
        line = f"Scene in {named(self.frame_id)}, {width:.4g} m × {height:.4g} m, {grid}.{where} Shown: {shown}."
        return [line, *([str(self.meaning)] if self.meaning else []), *self.missing]


def _in_words(layer: SceneLayer) -> str:
    at = "" if layer.x_m is None or layer.y_m is None else f" ({layer.x_m:.2f}, {layer.y_m:.2f})"
    to = " to" if layer.kind == "path" and at else ""
    age = f" ({layer.from_before})" if layer.from_before else ""
    return f"{layer.kind} {named(layer.name)}{to}{at}{age}"
