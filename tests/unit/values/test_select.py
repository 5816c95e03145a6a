import pytest

from ros2_mcp.model.errors import BadValue
from ros2_mcp.values.check import check
from ros2_mcp.values.definitions import Definitions
from ros2_mcp.values.select import numeric_fields, parse_field, parse_fields, value_at
from support.made_windows import CODEC

ODOMETRY = "nav_msgs/msg/Odometry"


@pytest.mark.parametrize(
    ("path", "message", "hint"),
    [
        ("pose.pose.positon", "geometry_msgs/msg/Pose has no field 'positon'", "Did you mean position?"),
        ("header.frame_id.x", "string has no fields", ""),
        ("child_frame_id[0]", "a single string, not a list", "child_frame_id[0:100]"),
        ("pose.covariance.x", "float64[36] is a list", "[0:10]"),
        ("pose.covariance[0].x", "float64 has no fields", ""),
        ("pose.covariance[a]", "[a] is not an index", "[*]"),
        ("pose.covariance[0:9:-1]", "is not an index", "[*]"),
        ("pose..pose", "'' is not a field", ""),
        ("", "'' is not a field", ""),
        ("pose.__class__", "'__class__' is not a field", ""),
    ],
)
def test_a_path_that_does_not_exist_says_where_it_ends(
    definitions: Definitions, path: str, message: str, hint: str
) -> None:
    with pytest.raises(BadValue) as caught:
        parse_fields(definitions, ODOMETRY, [path])
    assert message in caught.value.message and hint in caught.value.hint
    assert caught.value.path == path


def test_numeric_fields_are_the_single_numbers_at_any_depth(definitions: Definitions) -> None:
    paths = numeric_fields(definitions, ODOMETRY)
    assert paths[:3] == ["header.stamp.sec", "header.stamp.nanosec", "pose.pose.position.x"]
    assert not any("covariance" in path or "frame_id" in path for path in paths)
    assert "flag" not in numeric_fields(definitions, "odd_msgs/msg/Numbers")


def test_values_are_found_by_path_also_under_python_words(definitions: Definitions) -> None:
    message = check(definitions, ODOMETRY, {"pose": {"pose": {"position": {"x": 2.5}}}})
    assert value_at(message, "pose.pose.position.x") == 2.5
    assert value_at(check(definitions, "odd_msgs/msg/Words", {"class": 4}), "class") == 4


@pytest.mark.parametrize(
    ("type_name", "path", "index"),
    [
        ("sensor_msgs/msg/LaserScan", "ranges", 1),
        ("sensor_msgs/msg/LaserScan", "ranges[2:9:3]", 5),
        ("sensor_msgs/msg/LaserScan", "ranges[-2:]", None),
        ("sensor_msgs/msg/MultiEchoLaserScan", "ranges[1:].echoes", None),
        ("sensor_msgs/msg/MultiEchoLaserScan", "ranges[1].echoes", 1),
        ("sensor_msgs/msg/Imu", "orientation_covariance[-2:]", 8),
        ("tf2_msgs/msg/TFMessage", 'transforms[child_frame_id == "a"].transform.translation.x', None),
    ],
)
def test_the_place_of_an_element_is_told_only_where_it_is_certain(type_name: str, path: str, index: int | None) -> None:
    assert parse_field(CODEC.definitions, type_name, path).element(1) == index
