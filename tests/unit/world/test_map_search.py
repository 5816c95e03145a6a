"""The search of a scan on a map: in random rooms, where the true pose is known."""

from __future__ import annotations

import math

import numpy as np

from ros2_mcp.world.map_search import Area, FoundPose, search
from support.made_rooms import Room, made_grid

ROOMS = 20


def is_at(pose: FoundPose, x: float, y: float, yaw: float) -> bool:
    turned = math.remainder(pose.yaw_rad - yaw, 2 * math.pi)
    return math.hypot(pose.x_m - x, pose.y_m - y) < 0.15 and abs(turned) < math.radians(3)


def test_the_true_pose_is_first_in_random_rooms_and_where_it_is_not_there_are_rivals() -> None:
    right, rivalled = 0, 0
    for seed in range(ROOMS):
        rng = np.random.default_rng(seed)
        room = Room.random(rng)
        room.visit(rng, people=4 * (seed % 2))
        at = (*room.free(rng), rng.uniform(-math.pi, math.pi))
        found = search(room.map(), room.scan(rng, *at, reach=8.0 - 3 * (seed % 2)), most_s=60)
        assert found.searched == 1.0
        is_right = is_at(found.poses[0], *at)
        right += is_right
        rivalled += found.rivals > 0
        assert is_right or found.rivals, f"seed {seed}: wrong, and told as certain"
    assert right >= 0.9 * ROOMS
    assert rivalled <= 0.2 * ROOMS


def test_a_room_that_looks_the_same_from_two_poses_gives_both_and_a_guess_of_the_heading_decides() -> None:
    rng = np.random.default_rng(1)
    room = Room(8.0, 5.0)
    at = (3.0, 2.0, 0.5)
    hits = room.scan(rng, *at, reach=12.0)
    found = search(room.map(), hits)
    assert found.rivals == 1
    assert sorted(is_at(pose, *at) for pose in found.poses[:2]) == [False, True]
    assert any(is_at(pose, 5.0, 3.0, 0.5 - math.pi) for pose in found.poses[:2])
    guessed = search(room.map(), hits, Area(4.0, 2.5, 3.0, 0.2, math.radians(60)))
    assert (is_at(guessed.poses[0], *at), guessed.rivals) == (True, 0)


def test_only_the_area_is_searched() -> None:
    rng = np.random.default_rng(2)
    room = Room.random(rng)
    at = (*room.free(rng), 1.0)
    hits = room.scan(rng, *at)
    far = Area(room.width - at[0], room.height - at[1], 1.0)
    for pose in search(room.map(), hits, far).poses:
        assert math.hypot(pose.x_m - far.x_m, pose.y_m - far.y_m) < 1.3
    assert search(room.map(), hits, Area(-50.0, 0.0, 1.0)).poses == ()


def test_a_map_whose_corner_is_turned_gives_poses_in_its_frame() -> None:
    rng = np.random.default_rng(3)
    room = Room.random(rng)
    x, y, yaw = (*room.free(rng), 0.7)
    plain = room.map()
    turn, to_x, to_y = 0.9, 5.0, -2.0
    dx, dy = x - plain.corner.x_m, y - plain.corner.y_m
    turned = made_grid(plain.cells, plain.resolution_m, to_x, to_y, turn)
    at = (
        to_x + math.cos(turn) * dx - math.sin(turn) * dy,
        to_y + math.sin(turn) * dx + math.cos(turn) * dy,
        yaw + turn,
    )
    hits = room.scan(rng, x, y, yaw)
    assert is_at(search(turned, hits).poses[0], *at)
    assert is_at(search(turned, hits, Area(at[0] + 0.5, at[1], 1.5, at[2] + 0.3, 0.6)).poses[0], *at)


def test_a_search_that_runs_out_of_time_says_how_far_it_came() -> None:
    rng = np.random.default_rng(4)
    room = Room.random(rng)
    assert 0 < search(room.map(), room.scan(rng, *room.free(rng), 0.0), most_s=0.0).searched < 1
