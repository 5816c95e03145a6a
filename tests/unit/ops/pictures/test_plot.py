"""Plots of windows made for the purpose: what is drawn, what is left out, and the numbers beside the picture."""

from __future__ import annotations

import io
import math

import numpy as np
import pytest
from PIL import Image

from ros2_mcp.model.errors import BadInput, BadValue, NotFound
from ros2_mcp.ops.pictures.map import map_picture
from ros2_mcp.ops.pictures.plot import Plot, PlotRequest, plot
from ros2_mcp.robot import Robot
from support.made_windows import Make, Recorded

ODOMETRY = "nav_msgs/msg/Odometry"
FLOAT = "std_msgs/msg/Float64"
TIMES = np.arange(1, 250) * 0.02


async def plotted(windows, series, *look) -> Plot:
    return await plot(Recorded(windows), PlotRequest(series, *look))


def odometry(window: Make, times=TIMES):
    def message(t: float):
        pose = {"position": {"x": 3 * math.cos(t), "y": 3 * math.sin(t)}}
        return {"pose": {"pose": pose}, "twist": {"twist": {"linear": {"x": 3.0}, "angular": {"z": 1.0 + t}}}}

    return window("/odom", ODOMETRY, [(t, message(t)) for t in times])


def floats(window: Make, topic: str, values, times=TIMES):
    return window(topic, FLOAT, [(t, {"data": v}) for t, v in zip(times, values, strict=True)])


@pytest.mark.promise("ros2_plot", "with minimum, maximum and mean of each")
async def test_a_field_is_drawn_with_the_numbers_beside_it(window: Make) -> None:
    found = await plotted([odometry(window)], ["/odom:twist.twist.angular.z"])
    (series,) = found.series
    assert (series.name, series.unit, series.count) == ("/odom:twist.twist.angular.z", "rad/s", len(TIMES))
    assert [series.first, series.last, series.min, series.max] == [1.02, pytest.approx(5.98), 1.02, series.last]
    assert series.mean == pytest.approx(1 + TIMES.mean())
    picture = Image.open(io.BytesIO(found.images[0].data))
    assert (picture.format, picture.size) == ("PNG", (1000, 640))


async def test_a_message_stands_for_the_numbers_in_it_and_a_unit_is_a_panel(window: Make) -> None:
    found = await plotted([odometry(window)], ["/odom:twist.twist"])
    assert [each.unit for each in found.series] == ["m/s"] * 3 + ["rad/s"] * 3


async def test_when_there_are_too_many_those_that_stand_still_are_left_out_and_named(window: Make) -> None:
    found = await plotted([odometry(window)], ["/odom"])
    assert [each.name[6:] for each in found.series] == [
        "pose.pose.position.x",
        "pose.pose.position.y",
        "twist.twist.angular.z",
    ]
    assert "/odom:pose.pose.position.z" in found.note


async def test_gaps_and_values_that_are_not_finite_are_counted(window: Make) -> None:
    times = [t for t in TIMES if not 2 < t < 3]
    values = [{10: "nan", 20: "inf"}.get(index, 1.0) for index in range(len(times))]
    (series,) = (await plotted([floats(window, "/x", values, times)], ["/x:data"])).series
    assert (series.gaps, series.not_finite, series.count) == (1, 2, len(times) - 2)


async def test_a_list_is_drawn_as_its_elements_also_when_it_grows(window: Make) -> None:
    joints = [(t, {"position": [t, 2 * t] if t > 2.5 else [t]}) for t in TIMES]
    found = await plotted([window("/joints", "sensor_msgs/msg/JointState", joints)], ["/joints:position"])
    assert [(each.name, each.count) for each in found.series] == [
        ("/joints:position[0]", len(TIMES)),
        ("/joints:position[1]", sum(t > 2.5 for t in TIMES)),
    ]


async def test_a_position_alone_is_a_trajectory(window: Make) -> None:
    found = await plotted([odometry(window)], ["/odom:pose.pose.position"], "xy", 800, 800)
    assert [each.name for each in found.series] == ["/odom:pose.pose.position.x", "/odom:pose.pose.position.y"]
    pixels = np.asarray(Image.open(io.BytesIO(found.images[0].data)).convert("RGB")).astype(int)
    rows, columns = np.nonzero(np.abs(pixels[60:740] - (0x1F, 0x6F, 0xC4)).sum(axis=2) < 12)
    assert np.ptp(columns) == pytest.approx(np.ptp(rows), abs=20)  # most of a circle is as wide as high


async def test_series_of_two_topics_are_paired_by_time(window: Make) -> None:
    fast, slow = floats(window, "/a", TIMES), floats(window, "/b", TIMES[::5], TIMES[::5] + 0.004)
    found = await plotted([fast, slow], ["/a:data", "/b:data"], "xy")
    assert [each.count for each in found.series] == [len(TIMES), len(TIMES[::5])]


async def test_one_series_alone_is_no_trajectory(window: Make) -> None:
    with pytest.raises(BadInput, match="pairs of x and y"):
        await plotted([floats(window, "/a", TIMES)], ["/a:data"], "xy")


async def test_a_missing_topic_leaves_the_others_and_is_named(window: Make) -> None:
    found = await plotted([floats(window, "/a", TIMES)], ["/a:data", "/b:data"])
    assert (len(found.series), found.note) == (1, "There is no topic /b.")
    with pytest.raises(NotFound):
        await plotted([floats(window, "/a", TIMES)], ["/b:data"])


async def test_a_silent_topic_is_drawn_empty_and_named(window: Make) -> None:
    found = await plotted([floats(window, "/a", [], [])], ["/a:data"])
    assert (found.series[0].count, found.series[0].mean, found.note) == (0, None, "/a had no messages.")


@pytest.mark.parametrize("series", ["/odom:twist.twist.linaer", "/odom:header.frame_id", "/odom:child_frame_id"])
async def test_a_field_that_is_no_number_is_refused(window: Make, series: str) -> None:
    with pytest.raises(BadValue):
        await plotted([odometry(window)], [series])


async def test_a_map_is_shown_with_its_facts(robot: Robot, window: Make) -> None:
    info = {"resolution": 0.5, "width": 2, "height": 2, "origin": {"position": {"x": -1.0, "y": 2.0}}}
    message = {"header": {"frame_id": "map"}, "info": info, "data": [0, 100, -1, 0]}
    recorded = Recorded([window("/map", "nav_msgs/msg/OccupancyGrid", [(0.0, message)])])
    found = await map_picture(robot, recorded, "/map")
    assert (found.frame_id, found.resolution_m, found.width, found.height) == ("map", 0.5, 2, 2)
    assert (found.origin_x_m, found.origin_y_m) == (-1.0, 2.0)
    assert (found.free, found.occupied, found.unknown) == (0.5, 0.25, 0.25)
    pixels = np.asarray(Image.open(io.BytesIO(found.images[0].data)).convert("L"))
    cell = round(0.5 / found.metres_per_pixel)
    rows, columns = ([first + cell // 2, first + cell * 3 // 2] for first in (found.top_px, found.left_px))
    assert pixels[np.ix_(rows, columns)].tolist() == [[128, 255], [255, 0]]
    assert found.robot_x_m is None and "robot" not in found.images[0].note


def tf(frame: str, child: str, x: float, y: float, yaw: float = 0.0) -> dict[str, object]:
    rotation = {"z": math.sin(yaw / 2), "w": math.cos(yaw / 2)}
    return {
        "header": {"frame_id": frame},
        "child_frame_id": child,
        "transform": {"translation": {"x": x, "y": y}, "rotation": rotation},
    }


GROUND = {"header": {"frame_id": "map"}, "info": {"resolution": 0.5, "width": 2, "height": 2}, "data": [0] * 4}
TF = "tf2_msgs/msg/TFMessage"


@pytest.mark.promise("ros2_get_map_as_image", "axes in metres, origin and robot")
@pytest.mark.parametrize("prefix", ["", "robot1/"])
async def test_a_map_tells_where_the_robot_is_by_its_transforms(robot: Robot, window: Make, prefix: str) -> None:
    odom, base = f"{prefix}odom", f"{prefix}base_link"
    moving = [
        (0.0, {"transforms": [tf("map", odom, 1, 2, math.pi / 2), tf(odom, f"{prefix}base_footprint", 9, 9)]}),
        (0.1, {"transforms": [tf(odom, f"{prefix}base_footprint", 3, 0, 0.5)]}),
    ]
    static = [(0.0, {"transforms": [tf(f"{prefix}base_footprint", base, 0, 0)]})]
    windows = [window("/map", "nav_msgs/msg/OccupancyGrid", [(0.0, GROUND)])]
    windows += [window("/tf", TF, moving), window("/tf_static", TF, static)]
    found = await map_picture(robot, Recorded(windows), "/map")
    assert (found.robot_x_m, found.robot_y_m, found.robot_yaw_rad) == pytest.approx((1.0, 5.0, math.pi / 2 + 0.5))


async def test_a_map_tells_where_the_robot_is_by_its_localisation(robot: Robot, window: Make) -> None:
    pose = {"header": {"frame_id": "map"}, "pose": {"pose": {"position": {"x": 0.5, "y": 0.25}}}}
    posed = window("/amcl_pose", "geometry_msgs/msg/PoseWithCovarianceStamped", [(0.0, pose)])
    other = window("/tf", TF, [(0.0, {"transforms": [tf("odom", "base_link", 7, 7)]})])  # says nothing of the map
    recorded = Recorded([window("/map", "nav_msgs/msg/OccupancyGrid", [(0.0, GROUND)]), posed, other])
    found = await map_picture(robot, recorded, "/map")
    assert (found.robot_x_m, found.robot_y_m, found.robot_yaw_rad) == (0.5, 0.25, 0.0)


async def test_transforms_in_a_circle_place_no_robot(robot: Robot, window: Make) -> None:
    circle = [(0.0, {"transforms": [tf("odom", "base_link", 1, 0), tf("base_link", "odom", 1, 0)]})]
    recorded = Recorded([window("/map", "nav_msgs/msg/OccupancyGrid", [(0.0, GROUND)]), window("/tf", TF, circle)])
    assert (await map_picture(robot, recorded, "/map")).robot_x_m is None
