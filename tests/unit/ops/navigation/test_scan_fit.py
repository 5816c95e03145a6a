"""How much of a scan fits a map, on a map that is made here."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

from ros2_mcp.world.map_fit import share_that_fits
from ros2_mcp.world.occupancy import OccupancyGrid


def room() -> OccupancyGrid:
    """4 m × 4 m in cells of 0.1 m, with a wall at x = 3.0 to 3.1 m."""
    data = [100 if column == 30 else 0 for _ in range(40) for column in range(40)]
    at = SimpleNamespace(x=0.0, y=0.0, z=0.0)
    turn = SimpleNamespace(x=0.0, y=0.0, z=0.0, w=1.0)
    origin = SimpleNamespace(position=at, orientation=turn)
    info: Any = SimpleNamespace(width=40, height=40, resolution=0.1, origin=origin)
    return OccupancyGrid(SimpleNamespace(header=SimpleNamespace(frame_id="map"), info=info, data=data))


def test_beams_that_end_at_the_wall_fit_and_others_do_not() -> None:
    at_wall = [[3.05, 0.1 * step] for step in range(1, 31)]
    assert share_that_fits(room(), at_wall)[0] == 1.0
    assert share_that_fits(room(), [[x - 0.6, y] for x, y in at_wall])[0] == 0.0
    assert share_that_fits(room(), [*at_wall, *([x - 0.6, y] for x, y in at_wall)])[0] == 0.5


def test_beams_that_end_beside_the_map_fit_nothing() -> None:
    assert share_that_fits(room(), [[-5.0, -5.0], [50.0, 2.0]])[0] == 0.0
