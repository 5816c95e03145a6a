"""What a costmap says of a place, and of the way to it."""

import random
from types import SimpleNamespace

import numpy as np
import pytest

from ros2_mcp.model.costs import cost_in_words
from ros2_mcp.model.errors import BadData
from ros2_mcp.world.costmap import CostGrid


def grid(cells, resolution=0.1, x=0.0, y=0.0, z=0.0, w=1.0):
    """A message of these rows, the first one at the smallest y."""
    cells = np.array(cells, np.int8)
    origin = SimpleNamespace(
        position=SimpleNamespace(x=x, y=y, z=0.0), orientation=SimpleNamespace(x=0.0, y=0.0, z=z, w=w)
    )
    info = SimpleNamespace(width=cells.shape[1], height=cells.shape[0], resolution=resolution, origin=origin)
    return CostGrid(SimpleNamespace(header=SimpleNamespace(frame_id="/map"), info=info, data=cells.ravel()))


def test_a_point_has_the_cost_of_its_cell_wherever_the_grid_lies_and_however_it_is_turned():
    assert grid([[1, 2], [3, 4]]).value(0.15, 0.05) == 2
    assert grid([[1, 2], [3, 4]], x=-1.0, y=5.0).value(-0.95, 5.15) == 3
    turned = grid([[1, 2], [3, 4]], z=2**-0.5, w=2**-0.5)  # by a right angle: its rows go along -x
    assert turned.value(-0.15, 0.05) == 3
    assert turned.cell(*turned.point(1, 0)) == (1, 0)
    assert grid([[1, 2]]).value(0.05, 0.1) is None and grid([[1, 2]]).value(-0.01, 0.05) is None


def test_costs_are_told_in_words():
    told = [cost_in_words(cost) for cost in (None, -1, 0, 42, 99, 100)]
    assert told[:4] == ["outside the costmap", "unknown", "free", "free (42)"]
    assert "touches" in told[4] and told[5] == "occupied (cost 100)"


def test_a_goal_behind_a_wall_is_not_reached_and_the_nearest_place_on_this_side_is_told():
    cells = np.zeros((20, 30))
    cells[:, 14:17] = 99
    cells[:, 15] = 100
    reach = grid(cells).reach((0.5, 1.0), (2.5, 1.0))
    assert not reach.is_reached
    assert (reach.x_m, reach.y_m) == pytest.approx((1.35, 1.05))
    assert reach.short_m == pytest.approx(1.151, abs=1e-3)
    cells[3, 14:17] = 0  # a door
    assert grid(cells).reach((0.5, 1.0), (2.5, 1.0)).is_reached


def test_a_robot_that_touches_something_can_leave_it_but_not_go_through_it():
    cells = np.zeros((20, 30))
    cells[:, 13:18] = 99
    cells[:, 15] = 100
    assert grid(cells).reach((1.42, 1.0), (0.2, 1.0)).is_reached
    assert not grid(cells).reach((1.42, 1.0), (2.8, 1.0)).is_reached
    assert grid(cells).reach((1.55, 1.0), (0.2, 1.0)) is None  # it stands in what is occupied
    assert grid(cells).reach((9.0, 1.0), (0.2, 1.0)) is None  # or outside


def test_what_is_reached_is_what_a_search_cell_by_cell_reaches():
    rng = random.Random(3)
    for _ in range(40):
        rows, columns = rng.randint(2, 25), rng.randint(2, 25)
        cells = np.array([[100 if rng.random() < 0.4 else 0 for _ in range(columns)] for _ in range(rows)])
        start, goal = ((rng.randrange(rows), rng.randrange(columns)) for _ in range(2))
        cells[start] = 0
        seen, todo = {start}, [start]
        while todo:
            row, column = todo.pop()
            for near in ((row + i, column + j) for i in (-1, 0, 1) for j in (-1, 0, 1)):
                inside = 0 <= near[0] < rows and 0 <= near[1] < columns
                if inside and near not in seen and cells[near] < 99:
                    seen.add(near)
                    todo.append(near)
        one = grid(cells)
        assert one.reach(one.point(*start), one.point(*goal)).is_reached == (goal in seen)


def test_what_is_no_grid_is_refused():
    with pytest.raises(BadData, match="cells"):
        grid(np.zeros((0, 3)))
    with pytest.raises(BadData, match="resolution is 0"):
        grid([[0]], resolution=0.0)


def test_the_nearest_free_place_is_found():
    cells = np.full((10, 10), 100)
    cells[2, 7] = 5
    one = grid(cells)
    assert one.nearest_free(0.0, 0.0) == pytest.approx((0.75, 0.25))
    assert grid(np.full((3, 3), 100)).nearest_free(0.0, 0.0) is None
    assert one.extent() == "x 0.00 to 1.00, y 0.00 to 1.00"


def doorway(turn=0.0):
    """4 m × 3 m in cells of 5 cm: a wall at x = 2 with a door of 0.9 m, from y = 1 to y = 1.9; a post at (0.5, 2.3)."""
    cells = np.zeros((60, 80))
    cells[:, 39:41] = 100
    cells[20:38, 39:41] = 0
    cells[45:47, 9:11] = 100
    return grid(cells, 0.05, z=np.sin(turn / 2), w=np.cos(turn / 2))


@pytest.mark.parametrize("turn", [0.0, 0.6, -2.0])
def test_of_a_way_the_narrowest_gap_and_the_nearest_obstacle_are_told_in_metres_with_their_places(turn):
    def turned(x, y):
        return x * np.cos(turn) - y * np.sin(turn), x * np.sin(turn) + y * np.cos(turn)

    def on_map(at):
        return at[0] * np.cos(turn) + at[1] * np.sin(turn), at[1] * np.cos(turn) - at[0] * np.sin(turn)

    way = [turned(0.5 + 0.05 * step, 0.6 + 0.022 * step) for step in range(60)]  # at a slant through the door
    spot = doorway(turn).narrowest(way)
    assert spot.gap_m == pytest.approx(0.9, abs=0.06)
    assert on_map(spot.gap_at) == pytest.approx((2.0, 1.45), abs=0.06)
    assert spot.clearance_m == pytest.approx(0.24, abs=0.06)
    assert on_map(spot.clearance_at) == pytest.approx((1.95, 1.24), abs=0.2)
    assert "a gap of 0." in str(spot) and "nearest: 0." in str(spot)


def test_a_way_along_one_wall_leads_through_no_gap_and_one_in_the_open_past_nothing():
    cells = np.zeros((80, 80))
    cells[0] = 100
    spot = grid(cells).narrowest([(1.0 + 0.1 * step, 0.55) for step in range(50)])
    assert spot.clearance_m == pytest.approx(0.45, abs=0.06) and spot.gap_m is None
    assert str(spot).startswith("nearest: 0.45 m")
    assert grid(np.zeros((9, 9))).narrowest([(0.4, 0.4), (0.5, 0.5)]) is None
    assert grid(cells).narrowest([(1.0, 7.0), (2.0, 7.0)]) is None, "7 m away from the wall"
    assert grid(cells).narrowest([(99.0, 99.0)]) is None, "outside the costmap"


def test_a_way_through_what_is_occupied_has_no_room_at_all():
    cells = np.zeros((20, 20))
    cells[10] = 100
    assert grid(cells).narrowest([(0.55, 0.55), (0.55, 1.05), (0.55, 1.55)]).clearance_m == 0
