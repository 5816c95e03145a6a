"""What clouds and depth images mean: nearest thing above the ground, extent, ground."""

from __future__ import annotations

import io
import math
from collections.abc import Sequence
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from PIL import Image

from ros2_mcp.model.meanings import DepthMeaning
from ros2_mcp.model.poses import Pose
from ros2_mcp.world.depths import cloud_meaning, depth_meaning, depth_within, intrinsics_of
from ros2_mcp_demo import picture
from ros2_mcp_demo.base import Pose as At
from ros2_mcp_demo.world import Pillar, World

FLOOR = [(x / 10, y / 10, -0.3) for x in range(5, 40) for y in range(-20, 20)]
BASE = Pose()


def cloud(points: Sequence[tuple[float, float, float]], frame: str = "lidar") -> Any:
    """A message of x, y and z as 32-bit floats."""
    fields = [SimpleNamespace(name=name, offset=4 * at, datatype=7, count=1) for at, name in enumerate("xyz")]
    data = np.frombuffer(np.array(points, "<f4").tobytes(), np.uint8)
    count = len(points)
    header = SimpleNamespace(frame_id=frame)
    return SimpleNamespace(
        header=header,
        fields=fields,
        point_step=12,
        row_step=12 * count,
        width=count,
        height=1,
        is_bigendian=False,
        data=data,
    )


def box(x: float, y: float, low: float, high: float) -> list[tuple[float, float, float]]:
    return [(x, y + across / 50, low + (high - low) * up / 10) for across in range(-5, 6) for up in range(11)]


def depth_image(metres: np.ndarray, encoding: str = "32FC1", frame: str = "camera_optical") -> Any:
    values = metres.astype("<f4") if encoding == "32FC1" else (metres * 1000).astype("<u2")
    height, width = values.shape
    header = SimpleNamespace(frame_id=frame)
    data = np.frombuffer(values.tobytes(), np.uint8)
    return SimpleNamespace(
        header=header, encoding=encoding, height=height, width=width, step=0, is_bigendian=False, data=data
    )


def demo_view(*pillars: Pillar) -> tuple[Any, tuple[float, float, float, float]]:
    """What the simulated robot's depth camera sees at (0, 0), with its intrinsics."""
    image = picture.render_depth(World(pillars), At())
    return depth_image(image), (picture.FOCAL, picture.FOCAL, picture.CENTER_X, picture.CENTER_Y)


def optical_mount(forward: float, height: float) -> Pose:
    """The pose of an optical frame that looks along x of the base."""
    return Pose((forward, 0.0, height), (-0.5, 0.5, -0.5, 0.5))


def test_the_nearest_thing_stands_above_the_ground() -> None:
    meaning = cloud_meaning(cloud([*FLOOR, *box(2.0, 1.0, -0.2, 0.4)]), BASE, "base_link")
    assert meaning.ground_z_m == pytest.approx(-0.3, abs=0.01)
    assert meaning.ground_share and meaning.ground_share > 0.8
    assert (meaning.nearest_x_m, meaning.nearest_y_m) == pytest.approx((2.0, 0.93), abs=0.05)
    assert meaning.nearest_m == pytest.approx(math.hypot(2.0, 0.93), abs=0.05)
    assert "24° to the left (front left)" in str(meaning)


def test_open_ground_says_that_nothing_stands_there() -> None:
    meaning = cloud_meaning(cloud(FLOOR), BASE, "base_link")
    assert meaning.nearest_m is None
    assert "Nothing above the ground is in view." in str(meaning)


def test_a_ceiling_is_in_nobodys_way() -> None:
    ceiling = [(x, y, 2.4) for x, y, _ in FLOOR]
    assert cloud_meaning(cloud([*FLOOR, *ceiling]), BASE, "base_link").nearest_m is None


def test_the_top_of_a_table_is_not_the_ground() -> None:
    top = [(1 + x / 50, y / 50, 0.4) for x in range(15) for y in range(15)]
    meaning = cloud_meaning(cloud([*FLOOR, *top]), BASE, "base_link")
    assert meaning.ground_z_m == pytest.approx(-0.3, abs=0.01)
    assert meaning.nearest_m == pytest.approx(1.0, abs=0.05)


def test_without_ground_everything_counts_and_it_is_said() -> None:
    meaning = cloud_meaning(cloud(box(3.0, 0.0, 0.0, 1.0)), BASE, "base_link")
    assert meaning.ground_z_m is None and meaning.nearest_m == pytest.approx(3.0, abs=0.05)
    assert "No ground is seen." in str(meaning)


def test_single_points_of_noise_are_not_the_nearest_thing() -> None:
    noise = [(0.3, 0.1, 0.5), (0.35, -0.1, 0.4)]
    assert cloud_meaning(cloud([*FLOOR, *box(2.0, 0.0, -0.2, 0.4) * 5, *noise]), BASE, "b").nearest_m == pytest.approx(
        2.0, abs=0.05
    )


def test_a_cloud_of_an_optical_frame_without_a_mount_is_turned_upright() -> None:
    meaning = cloud_meaning(cloud([(-y, -z, x) for x, y, z in box(2.0, 0.5, 0.0, 0.4)], "camera_optical_frame"))
    assert not meaning.is_base and (meaning.nearest_x_m, meaning.nearest_y_m) == pytest.approx((2.0, 0.4), abs=0.05)
    assert "its mount on the base is unknown" in meaning.note


def test_an_empty_cloud_says_so() -> None:
    nothing = (math.nan, math.nan, math.nan)
    assert "No point has a valid position." in str(cloud_meaning(cloud([nothing, nothing])))


@pytest.mark.parametrize(("x", "y"), [(1.5, 0.0), (2.0, 0.6), (1.8, -0.5)])
def test_a_depth_image_with_a_camera_info_says_where_the_nearest_thing_is(x: float, y: float) -> None:
    image, intrinsics = demo_view(Pillar("post", x, y, 0.1, 0.8, (0, 0, 0)))
    meaning = depth_meaning(image, intrinsics, optical_mount(0.0, picture.EYE_HEIGHT), "base_link")
    assert isinstance(meaning, DepthMeaning)
    assert meaning.nearest_m == pytest.approx(math.hypot(x, y) - 0.1, abs=0.03)
    assert meaning.nearest_bearing_deg == pytest.approx(math.degrees(math.atan2(y, x)), abs=4)
    assert meaning.ground_z_m == pytest.approx(0.0, abs=0.03)


def test_a_depth_image_without_a_camera_info_says_the_nearest_of_each_third() -> None:
    metres = np.full((40, 60), 3.0)
    metres[10:30, 5:10] = 1.5
    meaning = depth_meaning(depth_image(metres), None)
    assert isinstance(meaning, DepthMeaning) and meaning.nearest_m == 1.5
    assert "By thirds of the picture: left 1.50 m, middle 3.00 m, right 3.00 m." in meaning.note
    assert "Without camera info" in meaning.note and meaning.ground_z_m is None


def test_depth_in_millimetres_is_the_same() -> None:
    plane = np.tile(np.linspace(1.0, 3.0, 60), (40, 1))
    one, other = (depth_meaning(depth_image(plane, kind), (50, 50, 30, 20)) for kind in ("32FC1", "16UC1"))
    assert one and other and one.nearest_m == pytest.approx(other.nearest_m, abs=0.01)


def test_compressed_depth_is_the_same() -> None:
    plane = np.tile(np.linspace(1.0, 3.0, 60), (40, 1))
    file = io.BytesIO()
    Image.fromarray((plane * 1000).astype(np.uint16)).save(file, "PNG")
    data = np.frombuffer(bytes(12) + file.getvalue(), np.uint8)
    header = SimpleNamespace(frame_id="camera_optical")
    packed = SimpleNamespace(header=header, format="16UC1; compressedDepth png", data=data)
    one, other = depth_meaning(packed, (50, 50, 30, 20)), depth_meaning(depth_image(plane), (50, 50, 30, 20))
    assert one and other and one.nearest_m == pytest.approx(other.nearest_m, abs=0.01)
    assert depth_meaning(SimpleNamespace(header=header, format="jpeg", data=data), None) is None


def test_a_depth_image_without_any_distance_says_so() -> None:
    empty = depth_meaning(depth_image(np.full((20, 30), np.nan)), None)
    assert empty and "left nothing valid" in empty.note


def test_a_colour_image_is_no_depth_image() -> None:
    assert depth_meaning(SimpleNamespace(encoding="rgb8"), None) is None


def test_intrinsics_are_those_of_the_rectified_picture_where_there_are_such() -> None:
    k, p = [1.0, 0, 2.0, 0, 3.0, 4.0, 0, 0, 1], [5.0, 0, 6.0, 0, 0, 7.0, 8.0, 0, 0, 0, 1, 0]
    assert intrinsics_of(SimpleNamespace(k=k, p=p)) == (5, 7, 6, 8)
    assert intrinsics_of(SimpleNamespace(k=k, p=[0.0] * 12)) == (1, 3, 2, 4)


def test_the_depth_in_a_box_is_that_of_its_pixels_alone() -> None:
    metres = np.full((4, 6), 5.0)
    metres[1:3, 2:4] = 2.0
    metres[2, 3] = np.nan
    image = depth_image(metres)
    assert depth_within(image, (2, 1, 3, 2)) == (2.0, "depth there 2.00 m (from 2.00 to 2.00 m, 75% of it valid)")
    assert depth_within(image, (3, 2, 3, 2)) == (None, "no valid depth there")
    image.encoding = "rgb8"
    assert depth_within(image, (0, 0, 1, 1)) == (None, "")
