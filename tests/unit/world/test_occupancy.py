"""One reader of occupancy grids: what it refuses, and what it says of a grid."""

from __future__ import annotations

import math
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from ros2_mcp.model.errors import BadData
from ros2_mcp.world.occupancy import OccupancyGrid

CELLS = ((0, 100, -1), (0, 49, 50))


def message(
    cells: Any = CELLS, *, width: int = 3, resolution: float = 0.05, x: float = -1.0, z: float = 0.0, w: float = 1.0
) -> Any:
    orientation = SimpleNamespace(x=0.0, y=0.0, z=z, w=w)
    origin = SimpleNamespace(position=SimpleNamespace(x=x, y=2.0, z=0.0), orientation=orientation)
    info = SimpleNamespace(width=width, height=2, resolution=resolution, origin=origin)
    return SimpleNamespace(header=SimpleNamespace(frame_id="/map"), info=info, data=np.array(cells, np.int8).ravel())


@pytest.mark.parametrize(
    ("broken", "said"),
    [
        ({"cells": (), "width": 0}, "empty: 0 × 2 cells"),
        ({"width": 4}, "data has 6 cells, but width × height is 4 × 2 = 8"),
        ({"resolution": math.nan}, "info.resolution is NaN"),
        ({"resolution": 0.0}, "resolution is 0 m"),
        ({"resolution": -0.05}, "resolution is -0.05 m"),
        ({"x": math.inf}, "origin is not finite .info.origin.position.x is infinite"),
        ({"w": math.nan}, "info.origin.orientation.w is NaN"),
    ],
)
def test_a_broken_grid_is_refused_with_what_does_not_fit(broken: dict[str, Any], said: str) -> None:
    with pytest.raises(BadData, match=said):
        OccupancyGrid(message(**broken))


def test_its_facts_are_its_place_and_the_shares_of_free_occupied_and_unknown_cells() -> None:
    facts = OccupancyGrid(message(z=1.0)).facts()  # a quaternion that is not of unit length: by 90°
    assert (facts.frame_id, facts.width, facts.height) == ("map", 3, 2)
    assert (facts.origin_x_m, facts.origin_y_m, facts.origin_yaw_rad) == pytest.approx((-1, 2, math.pi / 2))
    assert (facts.free, facts.occupied, facts.unknown) == pytest.approx((3 / 6, 2 / 6, 1 / 6))


def test_an_origin_that_nobody_has_filled_in_is_not_turned() -> None:
    assert OccupancyGrid(message(w=0.0)).corner.yaw_rad == 0


def test_values_that_are_no_percentage_are_unknown() -> None:
    grid = OccupancyGrid(message(((0, 100, 101), (-1, -128, 127))))
    assert grid.percentages().tolist() == [[0, 100, -1], [-1, -1, -1]]
    assert grid.cells.tolist() == [[0, 100, 101], [-1, -128, 127]]
