import math

import numpy as np
import pytest

from ros2_mcp_demo.base import RADIUS, Pose
from ros2_mcp_demo.drive import Drive, Goal, Surroundings
from ros2_mcp_demo.planner import Costmap, plan
from ros2_mcp_demo.simulation import AUTONOMOUS, Simulation
from ros2_mcp_demo.world import World

SOUTH_EAST = (5.0, -2.0)


def along(path, spacing=0.02):
    for i in range(len(path) - 1):
        steps = math.ceil(math.dist(path[i], path[i + 1]) / spacing)
        for step in range(steps + 1):
            share = step / steps
            yield tuple(a + share * (b - a) for a, b in zip(path[i], path[i + 1], strict=True))


def test_the_plan_goes_through_the_doorway_and_keeps_clear_of_everything():
    world = World()
    path = plan(Costmap.from_occupancy(*world.occupancy(), 0.05), (0.0, 0.0), SOUTH_EAST)
    assert path is not None
    assert path[0] == (0.0, 0.0)
    assert path[-1] == SOUTH_EAST
    assert min(world.clearance(*point) for point in along(path)) > RADIUS
    assert any(abs(x - 2.5) < 0.05 and 0.8 < y < 1.8 for x, y in along(path))


def test_there_is_no_plan_into_a_wall_or_through_a_closed_doorway():
    cells, origin = World().occupancy()
    closed = [(2.5, 0.8 + 0.05 * step) for step in range(21)]
    assert plan(Costmap.from_occupancy(cells, origin, 0.05), (0.0, 0.0), (2.5, 0.0)) is None
    assert plan(Costmap.from_occupancy(cells, origin, 0.05, closed), (0.0, 0.0), SOUTH_EAST) is None


def test_a_robot_that_stands_close_to_a_wall_can_leave_it():
    cells, origin = World().occupancy()
    assert plan(Costmap.from_occupancy(cells, origin, 0.05), (-1.78, -2.78), (0.0, 0.0)) is not None


def run(simulation, goal, limit_s=60.0, *, lidar=True):
    """Drive as the navigator does; returns the drive and the least clearance on the way."""
    simulation.mode = AUTONOMOUS
    surroundings = Surroundings(*simulation.world.occupancy(), 0.05)
    drive, least = Drive(goal, surroundings, simulation.now), math.inf
    for step in range(round(limit_s * 50)):
        if step % 5 == 0:
            ranges = simulation.scan(0.01)
            surroundings.see(simulation.scan_points(ranges if lidar else np.full_like(ranges, np.inf)), simulation.now)
            base = simulation.base
            simulation.commanded = drive.step(base.pose, simulation.now, base.blocked, 0.4, 1.2)
        simulation.step(0.02)
        least = min(least, simulation.world.clearance(simulation.base.pose.x, simulation.base.pose.y))
        if drive.outcome:
            break
    return drive, least


@pytest.mark.parametrize("place", [SOUTH_EAST, (5.3, 2.3), (-1.5, -2.4), (1.0, 0.0)])
def test_a_drive_arrives_without_touching_anything(place):
    simulation = Simulation()
    drive, least = run(simulation, Goal(*place, yaw=1.0))
    assert drive.outcome == (True, "arrived")
    assert math.dist((simulation.base.pose.x, simulation.base.pose.y), place) <= 0.15
    assert simulation.base.pose.yaw == pytest.approx(1.0, abs=0.2)
    assert least > RADIUS


def test_a_drive_goes_around_an_obstacle_that_the_map_does_not_know():
    simulation = Simulation()
    assert simulation.spawn("crate", 0.2, -1.4, 0.25) is None
    drive, least = run(simulation, Goal(0.3, -2.5))
    assert drive.outcome == (True, "arrived")
    assert least > RADIUS


def test_a_drive_gives_up_when_the_only_way_is_closed():
    simulation = Simulation()
    assert simulation.spawn("plug", 2.5, 1.3, 0.4) is None
    drive, _ = run(simulation, Goal(*SOUTH_EAST))
    assert drive.outcome is not None
    assert drive.outcome[0] is False
    assert "no free way" in drive.outcome[1]


def test_a_blind_drive_bumps_into_an_unknown_obstacle_backs_off_and_gives_up():
    simulation = Simulation()
    assert simulation.spawn("crate", 0.2, -1.4, 0.25) is None
    drive, least = run(simulation, Goal(0.3, -2.5), lidar=False)
    assert drive.outcome == (False, "the base was blocked 4 times")
    assert least > RADIUS - 0.02


def test_a_drive_starts_from_a_wall_behind_it_though_the_base_was_just_driven_against_that():
    simulation = Simulation()
    simulation.commanded = (-0.5, 0.0)
    for _ in range(3000):
        simulation.step(0.02)
        if simulation.base.blocked:
            break
    assert simulation.base.blocked
    drive, _ = run(simulation, Goal(0.0, 0.0))
    assert (drive.outcome, drive.recoveries) == ((True, "arrived"), 0)


def test_a_drive_gives_up_when_the_base_does_not_move():
    drive = Drive(Goal(1.0, 0.0), Surroundings(*World().occupancy(), 0.05), 0.0)
    for tenth in range(60):
        drive.step(Pose(), tenth / 10, False, 0.4, 1.2)
    assert drive.outcome == (False, "gave up after 5 s: the base does not move")


def test_remaining_way_shrinks_to_nothing():
    world = World()
    drive = Drive(Goal(1.0, 0.0), Surroundings(*world.occupancy(), 0.05), 0.0)
    drive.step(Pose(), 0.0, False, 0.4, 1.2)
    assert drive.remaining(Pose()) == pytest.approx(1.0, abs=0.05)
    drive.step(Pose(0.6), 0.1, False, 0.4, 1.2)
    assert drive.remaining(Pose(0.6)) == pytest.approx(0.4, abs=0.05)
