"""The picture of a scene: what broken or far-away numbers do to it, and how its lines are labelled."""

from __future__ import annotations

import math
from itertools import pairwise
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from PIL import Image

from ros2_mcp.model.errors import BadData
from ros2_mcp.model.pictures import BOUNDS, Place
from ros2_mcp.pictures.plot import Span
from ros2_mcp.pictures.scene import GridLayer, Mark, Scene, SceneDrawing, Zone, _Sheet, extent, scene_drawing
from ros2_mcp.world.occupancy import OccupancyGrid

BROKEN = (math.nan, math.inf, -math.inf, 1e300, -1e30, 2e6)


ORIGIN = SimpleNamespace(position=SimpleNamespace(x=0, y=0, z=0), orientation=SimpleNamespace(x=0, y=0, z=0, w=1))


def grid(width: int = 40, height: int = 20, resolution: float = 0.1, fill: int = 0) -> OccupancyGrid:
    info = SimpleNamespace(width=width, height=height, resolution=resolution, origin=ORIGIN)
    header = SimpleNamespace(frame_id="map")
    return OccupancyGrid(SimpleNamespace(header=header, info=info, data=np.full(width * height, fill, np.int8)))


def drawn(x: Span, y: Span, **more: Any) -> SceneDrawing:
    return scene_drawing(Scene(frame="map", x=x, y=y, **more), BOUNDS)


@pytest.mark.parametrize("size_m", [0.5, 2, 3.3, 8, 30, 70, 200, 1500])
def test_lines_are_round_numbers_apart_and_far_enough_to_be_counted(size_m: float) -> None:
    drawing = drawn(Span(-size_m / 3, size_m), Span(0, size_m))
    assert drawing.line_m / drawing.metres_per_pixel >= 36
    assert math.log10(drawing.line_m) % 1 == pytest.approx(0, abs=1e-9) or any(
        math.isclose(math.log10(drawing.line_m / step) % 1, 0, abs_tol=1e-9) for step in (2, 5)
    )
    height, width = drawing.raster.pixels.shape[:2]
    assert max(height, width) <= BOUNDS.max_side and height * width < 1_400_000


@pytest.mark.parametrize("broken", BROKEN)
def test_numbers_that_are_none_are_left_out(broken: float) -> None:
    points = np.array([[0.0, 0.0], [broken, 1.0], [1.0, broken], [1.0, 1.0]])
    x, y = extent(None, [points], None, None)
    assert x.high < 3 and y.high < 3
    drawing = drawn(
        x, y, scans=[points], paths=[points], footprint=points, robot=Place(0, 0), goals=[Mark("goal", broken, broken)]
    )
    assert (drawing.raster.pixels != drawn(x, y).raster.pixels).any()


def test_what_is_far_from_the_grid_does_not_make_it_small() -> None:
    layer = GridLayer(grid(), Place(0, 0))
    x, _ = extent(layer, [np.array([[5000.0, 0.0], [4.5, 1.0]])], None, None)
    assert 4.5 < x.high < 6


def test_a_robot_far_from_a_part_that_is_shown_is_not_drawn() -> None:
    x = y = Span(0, 2)
    assert (drawn(x, y, robot=Place(1e5, 0)).raster.pixels == drawn(x, y).raster.pixels)[:-30].all()


def test_only_the_known_part_of_a_grid_is_shown() -> None:
    unknown = grid(fill=-1)
    unknown.cells[10, 10] = 0
    x, y = extent(GridLayer(unknown, Place(0, 0)), [], None, None)
    assert x.length < 2.5 and y.length < 2.5


def test_thin_walls_stay_in_a_picture_of_a_large_map() -> None:
    large = grid(3000, 1500, 0.05)
    large.cells[:, 1500] = 100
    layer = GridLayer(large, Place(0, 0))
    drawing = drawn(*extent(layer, [], None, None), grid=layer)
    middle = drawing.raster.pixels[drawing.top_px + 100 : drawing.top_px + 200].astype(int)
    assert (middle.min(axis=(0, 2)) < 60).any()


def test_nothing_at_all_is_refused() -> None:
    with pytest.raises(BadData, match="nothing to show"):
        extent(None, [], None, None)


def test_cells_that_are_no_probability_are_unknown() -> None:
    def shade(fill: int) -> int:
        layer = GridLayer(grid(fill=fill), Place(0, 0))
        return int(drawn(Span(0, 4), Span(0, 2), grid=layer).raster.pixels[200, 200, 0])

    shades = [shade(fill) for fill in (-1, 101, 0, 100)]
    assert shades[0] == shades[1] == 200 and shades[2] == 255 and shades[3] == 0
    assert all(one != other for one, other in pairwise(shades[1:]))


def test_the_legend_tells_goals_that_are_outside_of_the_picture_and_no_marks_that_are_not_in_it() -> None:
    span = Span(0, 4)

    def legend(*goals: Mark, places: tuple[Mark, ...] = ()) -> list[str]:
        scene = Scene(frame="map", x=span, y=span, goals=goals, places=places)
        return [text for _, text in _Sheet(scene, 0.01, Image.new("RGB", (400, 400))).legend()]

    assert legend(Mark("goal", 1, 1)) == ["goal"]
    assert legend(Mark("goal", 50, -3.25)) == ["goal outside, at (50, -3.25)"]
    assert legend(Mark("goal", 1, 1), *[Mark("goal", 9, y) for y in range(9)])[:2] == [
        "goal",
        "goal outside, at (9, 0)",
    ]
    assert len(legend(*[Mark("goal", 9, y) for y in range(9)])) == 3
    assert legend(places=(Mark("dock", 9, 9),)) == [] and legend(places=(Mark("dock", 3, 3),)) == ["place"]


def test_of_several_paths_the_legend_tells_which_is_which() -> None:
    span, line = Span(0, 4), np.array([[0.0, 0.0], [1.0, 1.0]])

    def legend(*names: str) -> list[tuple[str, str]]:
        scene = Scene(frame="map", x=span, y=span, paths=[line] * len(names), path_names=names)
        return _Sheet(scene, 0.01, Image.new("RGB", (400, 400))).legend()

    assert [text for _, text in legend("/plan")] == ["path"]
    assert [text for _, text in legend("/plan", "/local_plan")] == ["path /plan", "path /local_plan"]
    assert len({colour for colour, _ in legend("/plan", "/local_plan")}) == 2


def test_keep_out_zones_are_tinted_outlined_and_in_the_legend() -> None:
    zone = Zone("stairs", np.array([[1.0, 1.0], [3.0, 1.0], [3.0, 3.0], [1.0, 3.0]]))
    drawing = drawn(Span(0, 4), Span(0, 4), zones=(zone,))

    def colour(x_m: float, y_m: float) -> tuple[int, ...]:
        column = drawing.left_px + int(x_m / drawing.metres_per_pixel)
        row = drawing.top_px + int((4 - y_m) / drawing.metres_per_pixel)
        return tuple(map(int, drawing.raster.pixels[row, column]))

    red, green, blue = colour(1.3, 1.3)
    assert red > green + 30 and red > blue + 30
    assert colour(0.37, 0.37) == (255, 255, 255)
    scene = Scene(frame="map", x=Span(0, 4), y=Span(0, 4), zones=(zone,))
    assert "keep-out zone" in [text for _, text in _Sheet(scene, 0.01, Image.new("RGB", (400, 400))).legend()]
