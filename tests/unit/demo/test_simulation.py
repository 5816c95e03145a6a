import math

import numpy as np
import pytest

from ros2_mcp_demo.base import Pose
from ros2_mcp_demo.picture import CENTER_X, CENTER_Y, render, render_depth
from ros2_mcp_demo.simulation import IDLE, RANGE_MAX, Simulation
from ros2_mcp_demo.world import World


def story(seed):
    """What a robot senses on a short drive."""
    simulation = Simulation(seed)
    simulation.commanded = (0.3, 0.4)
    for _ in range(100):
        simulation.step(0.02)
    base = simulation.base
    return np.concatenate([simulation.scan(0.01), simulation.inertia()[2], [base.pose.x, base.odometry.x]])


def test_the_same_seed_tells_the_same_story_and_another_seed_another():
    assert np.array_equal(story(7), story(7))
    assert not np.array_equal(story(7), story(8))


def test_a_scan_is_noisy_true_and_infinite_beyond_its_range():
    simulation = Simulation()
    ranges = simulation.scan(0.01)
    exact = simulation.world.cast(0.0, 0.0, -math.pi + np.arange(360) * math.radians(1))
    seen = np.isfinite(ranges)
    assert 0.003 < np.std(ranges[seen] - exact[seen]) < 0.02
    assert not seen[exact > RANGE_MAX + 0.05].any()
    assert 5 < np.count_nonzero(~seen) < 40


def test_scan_points_lie_on_what_was_seen_although_the_robot_has_turned_since():
    simulation = Simulation()
    ranges = simulation.scan(0.0)
    simulation.base.pose = Pose(yaw=0.3)
    points = simulation.scan_points(ranges)
    assert max(simulation.world.clearance(x, y) for x, y in points) < 0.01


def test_an_idle_robot_does_not_drive():
    simulation = Simulation()
    simulation.mode, simulation.commanded = IDLE, (0.5, 0.0)
    for _ in range(50):
        simulation.step(0.02)
    assert simulation.base.travelled == pytest.approx(0.0)


def test_driving_drains_the_battery_faster_than_standing():
    standing, driving = Simulation(), Simulation()
    driving.commanded = (0.0, 1.5)
    for _ in range(500):
        standing.step(0.02)
        driving.step(0.02)
    assert driving.battery.charge < standing.battery.charge < 0.87
    assert driving.battery.voltage < standing.battery.voltage < 12.6


@pytest.mark.parametrize(
    ("place", "reason"),
    [
        ((9.0, 0.0, 0.2), "outside"),
        ((0.3, 0.0, 0.2), "overlap"),
        ((1.0, 1.0, 0.0), "radius"),
        ((math.nan, 1.0, 0.2), "finite"),
    ],
)
def test_an_obstacle_that_cannot_stand_there_is_refused_in_words(place, reason):
    simulation = Simulation()
    before = list(simulation.world.obstacles)
    assert reason in (simulation.spawn("crate", *place) or "")
    assert simulation.world.obstacles == before


def test_the_picture_shows_the_red_pillar_where_the_robot_looks_at_it():
    picture = render(World(), Pose(yaw=math.atan2(-1.0, 1.6)))
    red, green, blue = picture[round(CENTER_Y), round(CENTER_X)].astype(int)
    assert red > 100
    assert red > 2 * max(green, blue)
    assert not np.array_equal(picture, render(World(), Pose(yaw=0.5)))


def test_a_wall_hides_what_stands_behind_it():
    picture = render(World(), Pose(yaw=math.atan2(-0.9, 4.2))).astype(int)
    assert not (picture[100:140, :, 2] > 2 * picture[100:140, :, 0]).any()


def test_brightness_zero_is_black():
    assert render(World(), Pose(), brightness=0.0).max() == 0


def test_depth_is_measured_along_the_optical_axis():
    depth = render_depth(World([]), Pose())
    wall = depth[round(CENTER_Y)]
    assert wall[200:300] == pytest.approx(2.45, abs=0.01)
    assert np.isinf(depth[0]).all()
    assert depth[-1, 160] < 1.0
