import math

import numpy as np
import pytest

from ros2_mcp_demo.world import Box, Pillar, World

AHEAD, LEFT, BEHIND, RIGHT = 0.0, math.pi / 2, math.pi, -math.pi / 2


def test_rays_meet_the_walls_at_their_analytic_distances():
    distances = World([]).cast(0.0, 0.0, np.array([AHEAD, LEFT, BEHIND, RIGHT, math.radians(135)]))
    assert distances == pytest.approx([2.45, 3.0, 2.0, 3.0, 2.0 * math.sqrt(2)])


def test_a_ray_through_the_doorway_reaches_the_far_wall():
    assert World([]).cast(2.0, 1.3, np.array([0.0])) == pytest.approx([4.0])


def test_rays_meet_a_pillar_on_its_near_side_and_miss_it_beside_its_radius():
    world = World([Pillar("post", 1.0, 0.0, 0.25, 1.0, (0, 0, 0))])
    grazing = math.asin(0.25)
    distances = world.cast(0.0, 0.0, np.array([0.0, 0.9 * grazing, 1.1 * grazing]))
    assert distances[0] == pytest.approx(0.75)
    assert distances[1] < 1.0
    assert distances[2] == pytest.approx(2.45 / math.cos(1.1 * grazing))


def test_the_nearest_side_of_a_box_hides_the_others():
    distances, normals = Box("crate", 1.0, 0.0, 0.5, 0.5, 1.0, (0, 0, 0)).cast(0.0, 0.0, np.array([0.0]))
    assert distances == pytest.approx([0.75])
    assert math.cos(normals[0]) == pytest.approx(-1.0)


def test_clearance_is_the_distance_to_the_nearest_thing_and_negative_outside():
    world = World([Pillar("post", 0.0, 1.0, 0.25, 1.0, (0, 0, 0))])
    assert world.clearance(0.0, 0.0) == pytest.approx(0.75)
    assert world.clearance(-1.9, -1.0) == pytest.approx(0.1)
    assert world.clearance(-2.5, 0.0) < 0


def test_the_map_knows_walls_and_first_obstacles_but_nothing_placed_later():
    world = World()
    world.place(Pillar("late", 0.0, 0.0, 0.3, 1.0, (0, 0, 0)))
    cells, (x, y) = world.occupancy(0.05)

    def at(px, py):
        return cells[int((py - y) / 0.05), int((px - x) / 0.05)]

    assert (at(2.5, 0.0), at(2.5, 1.3), at(1.6, -1.0), at(0.0, 0.0)) == (100, 0, 100, 0)
    assert (cells[0] == -1).all()
    assert (at(-2.03, 0.0), at(-1.97, 0.0)) == (100, 0)


def test_placing_an_obstacle_again_moves_it():
    world = World([])
    for x in (1.0, -1.0):
        world.place(Pillar("post", x, 0.0, 0.25, 1.0, (0, 0, 0)))
    assert world.cast(0.0, 0.0, np.array([AHEAD, BEHIND])) == pytest.approx([2.45, 0.75])
