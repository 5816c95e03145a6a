"""Where the header of a message and its data contradict each other, nothing is invented."""

from __future__ import annotations

import io
import math
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from PIL import Image

from ros2_mcp.model.errors import BadData
from ros2_mcp.model.pictures import Bounds
from ros2_mcp.model.poses import Pose
from ros2_mcp.pictures.images import compressed_raster, depth_of
from ros2_mcp.pictures.raster import Raster
from ros2_mcp.world.clouds import cloud_of
from ros2_mcp.world.scans import nearest_to, scan_meaning

BOUNDS = Bounds()


def scan(step: float, count: int, last: float = 0.0) -> Any:
    """From -180° on; a `last` angle of 0 is not filled in."""
    header = SimpleNamespace(frame_id="laser")
    numbers = {"angle_min": -math.pi, "angle_max": last, "angle_increment": step, "range_min": 0.1, "range_max": 10.0}
    return SimpleNamespace(header=header, ranges=np.full(count, 3.0), **numbers)


def compressed(described: str, data: bytes) -> Any:
    return SimpleNamespace(
        format=described, data=np.frombuffer(data, np.uint8), header=SimpleNamespace(frame_id="camera")
    )


def file_of(values: np.ndarray[Any, Any], file_format: str) -> bytes:
    packed = io.BytesIO()
    Image.fromarray(values).save(packed, file_format)
    return packed.getvalue()


@pytest.mark.parametrize(
    ("step", "count", "words"), [(0.0, 360, "angle_increment is 0"), (1.0, 360, "turns"), (-0.5, 40_000, "turns")]
)
def test_a_scan_whose_steps_are_no_angles_has_no_bearings(step: float, count: int, words: str) -> None:
    with pytest.raises(BadData, match=f"no bearings.*{words}"):
        scan_meaning(scan(step, count))


@pytest.mark.parametrize(("step", "count"), [(math.tau / 360, 360), (-math.tau / 360, 361), (0.0, 1)])
def test_a_scan_of_a_turn_or_of_one_beam_has_them(step: float, count: int) -> None:
    assert scan_meaning(scan(step, count)).nearest_m == 3


@pytest.mark.parametrize(
    ("count", "last", "told"), [(400, 0.5, 210), (90, math.pi, 361), (541, math.radians(90), 271), (100, -3.2, 0)]
)
def test_a_scan_with_another_number_of_ranges_than_its_header_tells_has_no_bearings(
    count: int, last: float, told: int
) -> None:
    with pytest.raises(BadData, match=f"no bearings: it has {count} ranges.*tells {told or 'another'}"):
        scan_meaning(scan(math.tau / 360, count, last))
    with pytest.raises(BadData, match="no bearings"):
        nearest_to([(0.1, 0.1), (-0.1, 0.1), (0.0, -0.1)], scan(math.tau / 360, count, last), Pose())


@pytest.mark.parametrize(("count", "last"), [(360, math.pi), (361, math.pi), (358, math.radians(175)), (270, math.nan)])
def test_a_header_that_counts_the_last_ray_in_or_not_or_is_rounded_is_believed(count: int, last: float) -> None:
    assert scan_meaning(scan(math.tau / 360, count, last)).nearest_m == 3


def test_a_cloud_whose_fields_end_beyond_its_points_is_refused_by_the_name_of_the_field() -> None:
    fields = [SimpleNamespace(name=name, offset=4 * at, datatype=7, count=1) for at, name in enumerate("xyz")]
    shape = {"point_step": 8, "row_step": 80, "height": 1, "width": 10, "is_bigendian": False}
    with pytest.raises(BadData, match=r"«z».*beyond point_step, which is 8"):
        cloud_of(SimpleNamespace(fields=fields, data=np.zeros(80, np.uint8), **shape))


@pytest.mark.parametrize(("raw", "lost"), [("16UC1", "distances"), ("32FC1", "distances"), ("mono16", "values")])
def test_a_raw_type_of_more_bits_than_its_file_has_says_what_is_lost(raw: str, lost: str) -> None:
    data = file_of(np.full((8, 8), 90, np.uint8), "JPEG")
    shown = compressed_raster(compressed(f"{raw}; jpeg compressed ", data), BOUNDS)
    assert f"{lost} are lost" in shown.note and "png" in shown.note
    assert depth_of(compressed(f"{raw}; jpeg compressed ", data)) is None, "brightness is no distance"


@pytest.mark.parametrize("raw", ["32FC1", "32FC1; tiff compressed "])
def test_distances_as_tiff_are_distances(raw: str) -> None:
    metres = np.linspace(0.5, 4.0, 64, dtype=np.float32).reshape(8, 8)
    message = compressed(raw, file_of(metres, "TIFF"))
    shown = compressed_raster(message, BOUNDS)
    assert isinstance(shown, Raster) and "0.500 m to 4.000 m" in shown.note
    found = depth_of(message)
    assert found is not None and found[0, 0] == 0.5 and found[-1, -1] == 4


def test_sixteen_bits_as_png_are_distances_or_labels_by_what_they_are() -> None:
    millimetres = np.linspace(700, 3000, 64).astype(np.uint16).reshape(8, 8)
    found = depth_of(compressed("16UC1; png compressed ", file_of(millimetres, "PNG")))
    assert found is not None and found[0, 0] == pytest.approx(0.7)
    labels = np.repeat(np.array([0, 1, 2, 7], np.uint16), 16).reshape(8, 8)
    shown = compressed_raster(compressed("16UC1; png compressed ", file_of(labels, "PNG")), BOUNDS)
    assert isinstance(shown, Raster) and "labels" in shown.note
    assert depth_of(compressed("16UC1; png compressed ", file_of(labels, "PNG"))) is None


@pytest.mark.parametrize(
    ("described", "data", "words"),
    [
        ("h264", b"\0\0\0\1\x67" + bytes(50), "H.264 is a video"),
        ("hevc", bytes(9), "H.265 is a video"),
        ("", b"\0\0\1\x09" + bytes(50), "H.264 or H.265 is a video"),
        ("jpeg", b"", "it is empty"),
        ("jpeg", b"\xff\xd8\xff\xe0" + bytes(20), "damaged, or end too early"),
        ("png", b"\x89PNG\r\n\x1a\n" + bytes(3), "damaged, or end too early"),
        ("webp", b"nonsense", "begin as none does"),
    ],
)
def test_what_is_no_picture_is_told_without_words_of_a_library(described: str, data: bytes, words: str) -> None:
    with pytest.raises(BadData, match=words) as found:
        compressed_raster(compressed(described, data), BOUNDS)
    assert "object at" not in str(found.value) and "BytesIO" not in str(found.value)
