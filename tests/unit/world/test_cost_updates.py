"""Raw costmaps, and the parts of a costmap that have changed."""

from types import SimpleNamespace

import numpy as np
import pytest

from ros2_mcp.model.errors import BadData
from ros2_mcp.model.nav2 import COSTMAP, COSTMAP_UPDATE, GRID_UPDATE
from ros2_mcp.model.pictures import OCCUPANCY_GRID
from ros2_mcp.world.cost_updates import as_grid, updated

ORIGIN = SimpleNamespace(position=SimpleNamespace(x=0, y=0, z=0), orientation=SimpleNamespace(x=0, y=0, z=0, w=1))
HEADER = SimpleNamespace(frame_id="map")


def raw(costs, width, height):
    told = SimpleNamespace(resolution=0.05, size_x=width, size_y=height, origin=ORIGIN)
    return SimpleNamespace(header=HEADER, metadata=told, data=np.array(costs, np.uint8))


def test_raw_costs_become_those_that_nav2_publishes_in_a_grid():
    """1 to 252 become 1 to 98, by whole numbers as in its table; the other four have meanings of their own."""
    found = as_grid(COSTMAP, raw(range(256), 16, 16)).cells.ravel()
    assert found[[0, 253, 254, 255]].tolist() == [0, 99, 100, -1]
    assert found[[1, 2, 3, 4, 126, 127, 251, 252]].tolist() == [1, 1, 1, 2, 49, 49, 97, 98]
    assert [1 + 97 * (cost - 1) // 251 for cost in range(1, 253)] == found[1:253].tolist()


def test_a_part_changes_the_cells_that_it_names_and_not_the_costmap_that_others_hold():
    info = SimpleNamespace(width=4, height=3, resolution=0.1, origin=ORIGIN)
    first = as_grid(OCCUPANCY_GRID, SimpleNamespace(header=HEADER, info=info, data=[0] * 12))
    second = updated(first, GRID_UPDATE, SimpleNamespace(x=2, y=1, width=2, height=2, data=[1, 2, 3, -1]))
    third = updated(second, COSTMAP_UPDATE, SimpleNamespace(x=0, y=0, size_x=1, size_y=1, data=[254]))
    assert not first.cells.any()
    assert third.cells.tolist() == [[100, 0, 0, 0], [0, 0, 1, 2], [0, 0, 3, -1]]


@pytest.mark.parametrize(("x", "y", "width", "cells"), [(3, 0, 2, 2), (0, 3, 1, 1), (-1, 0, 1, 1), (0, 0, 2, 3)])
def test_a_part_that_does_not_fit_is_refused(x, y, width, cells):
    grid = as_grid(COSTMAP, raw([0] * 12, 4, 3))
    with pytest.raises(BadData, match="An update"):
        updated(grid, GRID_UPDATE, SimpleNamespace(x=x, y=y, width=width, height=1, data=[0] * cells))


def test_a_costmap_whose_cells_do_not_fit_its_size_is_refused():
    with pytest.raises(BadData, match="11 cells, but width × height is 4 × 3"):
        as_grid(COSTMAP, raw([0] * 11, 4, 3))
