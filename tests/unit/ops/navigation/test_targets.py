"""Where to go, as it may be written."""

import math

import pytest

from ros2_mcp.model.errors import BadInput, NotFound
from ros2_mcp.ops.navigation.known_places import NamedPlace, Places
from ros2_mcp.ops.navigation.targets import targets_of


@pytest.fixture
def places():
    kept = Places()
    kept.set(NamedPlace("Door", "map", 2.0, 1.0, math.pi / 2))
    return kept


def test_a_place_and_poses_are_taken_with_their_frames_and_headings(places):
    door, near, ahead = targets_of(
        [{"place": "door"}, {"x": 1, "y": 2, "yaw_deg": -450}, {"x": 1.0, "y": 0, "frame": "/base_link"}], places
    )
    assert (door.name, door.x_m, door.y_m, door.yaw_rad) == ("Door", 2.0, 1.0, math.pi / 2)
    assert (near.frame, near.x_m, near.y_m) == ("map", 1.0, 2.0) and near.yaw_rad == pytest.approx(-math.pi / 2)
    assert (ahead.frame, ahead.yaw_rad) == ("base_link", None)


def test_a_goal_without_a_heading_is_reached_as_one_comes(places):
    (goal,) = targets_of({"x": 1.0, "y": 1.0}, places)
    assert goal.facing_from(0.0, 0.0).yaw_rad == pytest.approx(math.pi / 4)
    assert goal.facing_from(1.0, 1.0).yaw_rad == 0.0
    (turned,) = targets_of({"x": 1.0, "y": 1.0, "yaw_deg": 10}, places)
    assert turned.facing_from(5.0, 5.0) == turned
    assert goal.pose()["header"] == {"frame_id": "map"}


@pytest.mark.parametrize(
    ("to", "says"),
    [
        ([], "1 to 100"),
        ({"x": 1.0}, "x and y"),
        ({"x": 1.0, "y": math.nan}, "finite"),
        ({"x": True, "y": 0}, "finite"),
        ({"x": 1.0, "y": 2e9}, "too far"),
        ({"x": 1.0, "y": 2.0, "yaw": 3}, "yaw_deg"),
        ({"x": 1.0, "y": 2.0, "frame": ""}, "frame"),
        ("door", '"door" is not a place'),
        ({"place": "door", "x": 1.0}, "no field «place»"),
    ],
)
def test_what_is_no_place_is_refused_with_how_one_is_written(places, to, says):
    with pytest.raises(BadInput, match=says):
        targets_of(to, places)


def test_a_place_that_is_not_known_is_told_with_the_nearest_name(places):
    with pytest.raises(NotFound, match="Did you mean Door"):
        targets_of([{"place": "dor"}], places)
