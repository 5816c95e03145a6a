"""Point clouds of every layout, and known points at known pixels."""

from __future__ import annotations

import io
import struct
from typing import Any

import numpy as np
import pytest
from PIL import Image

from ros2_mcp.model.errors import BadData
from ros2_mcp.model.pictures import POINT_CLOUD, BirdEyeOptions, Bounds, Place
from ros2_mcp.pictures.bird_eye import BirdEye, bird_eye
from ros2_mcp.values.check import check
from ros2_mcp.values.definitions import Definitions
from ros2_mcp.world.clouds import Cloud, cloud_of

KINDS = {"b": 1, "B": 2, "h": 3, "H": 4, "i": 5, "I": 6, "f": 7, "d": 8}


def cloud(definitions: Definitions, layout: dict[str, tuple[int, str]], points: list[dict[str, float]], **more) -> Any:
    """A message whose fields have these offsets and kinds; `more` overrides the rest."""
    order = ">" if more.get("is_bigendian") else "<"
    step = more.get("point_step") or max(at + struct.calcsize(kind) for at, kind in layout.values())
    height = more.get("height", 1)
    width = len(points) // height
    row_step = more.get("row_step") or width * step
    data = bytearray(b"\xaa" * (row_step * height))
    for index, point in enumerate(points):
        start = index // width * row_step + index % width * step
        for name, value in point.items():
            at, kind = layout[name]
            struct.pack_into(order + kind, data, start + at, value)
    fields = [{"name": n, "offset": at, "datatype": KINDS[kind], "count": 1} for n, (at, kind) in layout.items()]
    value = {"fields": fields, "point_step": step, "row_step": row_step, "width": width, "height": height}
    return check(definitions, POINT_CLOUD, {**value, "data": list(data), **more})


XYZ = {"x": (0, "f"), "y": (4, "f"), "z": (8, "f")}


def whole(seen: BirdEye) -> np.ndarray:
    return np.asarray(Image.open(io.BytesIO(seen.picture.data)).convert("RGB"))


def pixels(seen: BirdEye) -> np.ndarray:
    """The pixels of the ground, without the axes around it."""
    n = seen.numbers
    height, width = (
        round((high - low) / n.metres_per_pixel) for low, high in ((n.y_min_m, n.y_max_m), (n.x_min_m, n.x_max_m))
    )
    return whole(seen)[n.top_px : n.top_px + height, n.left_px : n.left_px + width]


def places(points: list[tuple[float, float, float]]) -> list[dict[str, float]]:
    return [dict(zip("xyz", point, strict=True)) for point in points]


@pytest.mark.parametrize(
    ("layout", "more"),
    [
        (XYZ, {}),
        ({"x": (3, "d"), "z": (13, "d"), "y": (21, "d")}, {"point_step": 32}),
        ({"z": (0, "h"), "y": (2, "h"), "x": (4, "i")}, {"is_bigendian": True}),
        (XYZ, {"height": 2, "row_step": 64, "is_bigendian": True}),
        (XYZ, {"height": 2, "row_step": 64, "point_step": 20}),
    ],
)
def test_points_of_any_layout_are_read(definitions: Definitions, layout: Any, more: Any) -> None:
    points = [(1, 2, 3), (-4, 5, -6), (7, -8, 9), (0, 0, 0)]
    assert cloud_of(cloud(definitions, layout, places(points), **more)).xyz.tolist() == [list(p) for p in points]


def test_points_that_are_not_finite_are_dropped_with_their_colours_and_counted(definitions: Definitions) -> None:
    layout = {**XYZ, "intensity": (12, "B")}
    points = [{"x": 1, "y": 1, "z": 1, "intensity": 10}, {"x": float("nan"), "y": 1, "z": 1, "intensity": 20}]
    points += [{"x": 2, "y": 1, "z": float("inf"), "intensity": 30}, {"x": 3, "y": 1, "z": 1, "intensity": 40}]
    found = cloud_of(cloud(definitions, layout, points))
    assert (found.points, found.not_finite) == (4, 2)
    assert found.intensity is not None and found.intensity.tolist() == [10, 40]


@pytest.mark.parametrize("big", [False, True])
@pytest.mark.parametrize("kind", ["I", "f"])
def test_packed_colours_are_unpacked(definitions: Definitions, kind: str, big: bool) -> None:
    packed = 0x00C81E90
    value = packed if kind == "I" else struct.unpack("<f", struct.pack("<I", packed))[0]
    point = {"x": 1, "y": 2, "z": 3, "rgb": value}
    found = cloud_of(cloud(definitions, {**XYZ, "rgb": (16, kind)}, [point], is_bigendian=big))
    assert found.rgb is not None and found.rgb.tolist() == [[0xC8, 0x1E, 0x90]]


def test_known_points_are_at_known_pixels(definitions: Definitions) -> None:
    """x to the right, y up: the corners of 40 m × 20 m, and one point inside."""
    points = [(29.95, -10.05, 0), (69.95, 9.95, 10), (55.05, 3.05, 10)]
    seen = bird_eye(cloud_of(cloud(definitions, XYZ, places(points))), BirdEyeOptions(0.1, color_mode="height"))
    image = pixels(seen)
    assert image.shape == (201, 401, 3)
    assert seen.numbers.metres_per_pixel == pytest.approx(0.1)
    lit = {(int(column), int(row)) for row, column in np.argwhere(image.any(axis=2))}
    assert lit == {(0, 200), (400, 0), (251, 69)}
    for x, y, _ in points:
        assert ((x - seen.numbers.x_min_m) // 0.1, (seen.numbers.y_max_m - y) // 0.1) in lit
    assert image[200, 0, 2] > image[200, 0, 0] and image[0, 400, 0] > image[0, 400, 2]  # low is blue, high is red


def test_the_highest_point_of_a_pixel_is_seen(definitions: Definitions) -> None:
    layout = {**XYZ, "rgb": (12, "I")}
    colours = {0.0: 0x00FF00, 2.0: 0xFF0000, 1.0: 0x0000FF}
    points = [{"x": 1.01, "y": 0.01, "z": z, "rgb": rgb} for z, rgb in colours.items()]
    points.append({"x": 11.0, "y": 0, "z": 0, "rgb": 0x00FF00})
    seen = bird_eye(cloud_of(cloud(definitions, layout, points)), BirdEyeOptions(0.02, color_mode="rgb"))
    assert pixels(seen)[0, 0].tolist() == [255, 24, 24]


def test_only_the_heights_asked_for_are_shown(definitions: Definitions) -> None:
    points = cloud_of(cloud(definitions, XYZ, places([(0, 0, -1), (1, 1, 0.5), (2, 2, 3)])))
    seen = bird_eye(points, BirdEyeOptions(z_min_m=0.0, z_max_m=1.0))
    assert (seen.numbers.shown, seen.numbers.z_min_m, seen.numbers.z_max_m) == (1, 0.5, 0.5)
    with pytest.raises(BadData, match="No point to show"):
        bird_eye(points, BirdEyeOptions(z_min_m=5.0))


def test_a_wide_cloud_is_shown_coarser_and_says_so(definitions: Definitions) -> None:
    points = cloud_of(cloud(definitions, XYZ, places([(0, 0, 0), (1000, 10, 1)])))
    seen = bird_eye(points, BirdEyeOptions(0.05, color_mode="height"))
    # 1448 of 1568 pixels are left beside the axes; 1000 m / 1448 is 0.69 m, and the next round number 0.7 m.
    assert seen.numbers.resolution_m == pytest.approx(0.7) and pixels(seen).shape[1] == 1429
    assert seen.picture.width == 1485
    assert seen.numbers.note.startswith(f"The resolution is {seen.numbers.resolution_m:.4g} m instead of 0.05 m")


def test_a_picture_of_noise_stays_within_its_bytes() -> None:
    random = np.random.default_rng(1)
    xyz = random.uniform(0, 70, (600_000, 3))
    seen = bird_eye(
        Cloud(xyz, random.uniform(0, 1, 600_000), None, 600_000, 0), BirdEyeOptions(bounds=Bounds(max_bytes=300_000))
    )
    assert len(seen.picture.data) <= 300_000
    assert seen.numbers.metres_per_pixel * pixels(seen).shape[1] == pytest.approx(70, abs=2 * seen.numbers.resolution_m)


def room() -> np.ndarray:
    """2000 points in a room of 8 m × 4 m, whose middle is 1 m east of the sensor."""
    return np.random.default_rng(3).uniform((-3, -2, 0), (5, 2, 2), (2000, 3))


def around(xyz: np.ndarray) -> Cloud:
    return Cloud(xyz, None, None, len(xyz), 0)


def test_one_outlier_does_not_make_the_picture_black() -> None:
    alone, with_outlier = room(), np.vstack((room(), [[9e5, -1e4, 1]]))
    seen = bird_eye(around(with_outlier), BirdEyeOptions(color_mode="height"))
    assert (pixels(seen) == pixels(bird_eye(around(alone), BirdEyeOptions(color_mode="height")))).all()
    assert seen.numbers.shown == 2000 and seen.numbers.note.startswith("Not shown: 1 point far")
    everything = BirdEyeOptions(x_min_m=-1e6, x_max_m=1e6, y_min_m=-1e6, y_max_m=1e6)
    assert bird_eye(around(with_outlier), everything).numbers.shown == 2001


def test_a_far_wall_is_no_outlier() -> None:
    wall = np.random.default_rng(4).uniform((20, -2, 0), (20.1, 2, 2), (100, 3))
    assert bird_eye(around(np.vstack((room(), wall))), BirdEyeOptions()).numbers.shown == 2100


def test_only_the_ground_asked_for_is_shown() -> None:
    numbers = bird_eye(around(room()), BirdEyeOptions(x_min_m=0.0, x_max_m=1.0, y_max_m=-1.0)).numbers
    assert numbers.x_min_m >= 0 and numbers.x_max_m <= 1.05 and numbers.y_min_m >= -2.05 and numbers.y_max_m <= -0.95
    with pytest.raises(BadData, match="outside the limits asked for"):
        bird_eye(around(room()), BirdEyeOptions(x_min_m=10.0))


def test_axes_origin_and_robot_are_drawn_where_they_are() -> None:
    seen = bird_eye(around(room()), BirdEyeOptions(color_mode="height", colormap="gray"), Place(2.0, -1.0, np.pi / 2))
    numbers, image = seen.numbers, whole(seen).astype(int)

    def at(x: float, y: float) -> list[int]:
        column = numbers.left_px + (x - numbers.x_min_m) / numbers.metres_per_pixel
        return image[round(numbers.top_px + (numbers.y_max_m - y) / numbers.metres_per_pixel), round(column)].tolist()

    assert at(2.0, -1.0) == [255, 140, 0]
    ahead = 10 * numbers.metres_per_pixel
    assert at(2.0, -1.0 + ahead) == [255, 140, 0] and at(2.0 + ahead, -1.0) != [255, 140, 0]  # it looks along y
    assert at(5 * numbers.metres_per_pixel, 0) == [0xE0, 0x20, 0x20]
    assert at(0, 5 * numbers.metres_per_pixel) == [0x10, 0xA0, 0x30]
    below = image[numbers.top_px + pixels(seen).shape[0] + 2, numbers.left_px :]  # the ticks of the x axis
    ticks = [numbers.x_min_m + column * numbers.metres_per_pixel for column in np.flatnonzero(below[:, 0] < 80)]
    assert ticks == pytest.approx([round(tick) for tick in ticks], abs=2 * numbers.metres_per_pixel) and len(ticks) >= 3
    assert "at (2.00, -1.00) m on these axes, heading 90°" in seen.picture.note


def test_a_small_picture_has_no_axes() -> None:
    seen = bird_eye(around(room()), BirdEyeOptions(bounds=Bounds(max_side=128)))
    assert (seen.numbers.left_px, seen.numbers.top_px) == (0, 0) and whole(seen).shape == pixels(seen).shape


def test_a_cloud_without_the_colour_asked_for_is_shown_by_height(definitions: Definitions) -> None:
    points = cloud_of(cloud(definitions, XYZ, places([(0, 0, 0), (1, 1, 1)])))
    for mode in ("intensity", "rgb"):
        seen = bird_eye(points, BirdEyeOptions(color_mode=mode))
        assert (seen.numbers.color_mode, seen.numbers.note) == (
            "height",
            f"The cloud has no {mode}; colours show the height.",
        )


@pytest.mark.parametrize(
    ("layout", "more", "words"),
    [
        ({"x": (0, "f"), "y": (4, "f")}, {}, "no x, y and z"),
        (XYZ, {"data": [0] * 10}, "data has 10 bytes"),
        (XYZ, {"width": 2**31}, "data has 12 bytes"),
        (XYZ, {"fields": [{"name": n, "offset": 4_000_000_000, "datatype": 7} for n in "xyz"]}, "beyond point_step"),
        (XYZ, {"fields": [{"name": n, "offset": 0, "datatype": 99} for n in "xyz"]}, "unknown datatype 99"),
    ],
)
def test_a_cloud_that_does_not_fit_its_layout_is_refused(definitions: Definitions, layout, more, words: str) -> None:
    with pytest.raises(BadData, match=words):
        cloud_of(cloud(definitions, layout, [dict.fromkeys(layout, 1.0)], **more))


def test_rows_that_overlap_are_refused(definitions: Definitions) -> None:
    message = cloud(definitions, XYZ, places([(0, 0, 0), (1, 1, 1)]), height=2)
    message.row_step = 4
    with pytest.raises(BadData, match="needs 12 bytes, but row_step is 4"):
        cloud_of(message)


def test_an_empty_cloud_says_so(definitions: Definitions) -> None:
    message = cloud(definitions, XYZ, [], data=[], point_step=12, row_step=0, width=0, height=1)
    with pytest.raises(BadData, match="of 0 points"):
        bird_eye(cloud_of(message), BirdEyeOptions())
