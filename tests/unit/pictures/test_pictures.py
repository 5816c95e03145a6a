import io
import struct

import numpy as np
import pytest
from PIL import Image

from ros2_mcp.model.errors import BadData, BadValue
from ros2_mcp.model.pictures import BOUNDS, COMPRESSED_IMAGE, IMAGE, OCCUPANCY_GRID, Bounds, Picture, Place
from ros2_mcp.pictures import messages as makers
from ros2_mcp.pictures.maps import map_drawing
from ros2_mcp.pictures.messages import picture_of
from ros2_mcp.pictures.raster import Raster
from ros2_mcp.values.check import check
from ros2_mcp.values.definitions import Definitions
from ros2_mcp.world.occupancy import OccupancyGrid

RED, GREEN, BLUE, GREY = (250, 10, 10), (10, 250, 10), (10, 10, 250), (128, 128, 128)


def pixels(picture: Picture) -> np.ndarray:
    image = Image.open(io.BytesIO(picture.data))
    assert image.size == (picture.width, picture.height)
    assert Image.MIME[image.format] == picture.mime
    return np.asarray(image)


def image(definitions: Definitions, encoding: str, rows: np.ndarray, padding: int = 0, **fields: int) -> object:
    height, width = rows.shape[:2]
    raw = np.ascontiguousarray(rows).view(np.uint8).reshape(height, -1)
    padded = np.pad(raw, ((0, 0), (0, padding)), constant_values=99)
    message = check(definitions, IMAGE, {
        "height": height, "width": width, "encoding": encoding, "step": padded.shape[1], **fields,
    })  # fmt: skip
    message.data = padded.ravel()
    message.data.flags.writeable = False  # as decoded
    return message


def colours(*row: tuple[int, int, int]) -> np.ndarray:
    """Two rows of 2 × 2 blocks of these colours."""
    return np.array([row, row], np.uint8).repeat(2, axis=0).repeat(2, axis=1)


@pytest.mark.parametrize(
    ("encoding", "order"),
    [
        ("rgb8", [0, 1, 2]), ("bgr8", [2, 1, 0]), ("8UC3", [2, 1, 0]),
        ("rgba8", [0, 1, 2, 0]), ("bgra8", [2, 1, 0, 0]), ("RGB8", [0, 1, 2]),
    ],
)  # fmt: skip
def test_colours_come_out_right_whatever_the_order_and_the_padding(
    definitions: Definitions, encoding: str, order: list[int]
) -> None:
    rows = colours(RED, GREEN, BLUE)
    picture = picture_of(IMAGE, image(definitions, encoding, rows[:, :, order], padding=5))
    assert picture.mime == "image/png"
    assert np.array_equal(pixels(picture), rows)


def test_grey_is_shown_as_it_is(definitions: Definitions) -> None:
    rows = np.arange(12, dtype=np.uint8).reshape(3, 4)
    for encoding in ("mono8", "8UC1"):
        assert np.array_equal(pixels(picture_of(IMAGE, image(definitions, encoding, rows, padding=1))), rows)


@pytest.mark.parametrize("order", ["<", ">"])
def test_sixteen_bits_are_stretched_in_either_byte_order(definitions: Definitions, order: str) -> None:
    rows = np.array([[1000, 2000], [3000, 1000]], order + "u2")
    picture = picture_of(IMAGE, image(definitions, "mono16", rows, is_bigendian=int(order == ">")))
    assert pixels(picture).tolist() == [[0, 128], [255, 0]]
    assert picture.note == "mono16: black is 1000, white is 3000."


def test_depth_tells_its_range_in_metres_and_what_is_invalid(definitions: Definitions) -> None:
    rows = np.full((10, 10), 2000, np.uint16)
    rows[0], rows[1] = 0, 500
    picture = picture_of(IMAGE, image(definitions, "16UC1", rows))
    assert "0.500 m to 2.000 m" in picture.note and "invalid (10.0%)" in picture.note
    shades = pixels(picture)
    assert (shades[0, 0], shades[1, 0], shades[5, 0]) == (0, 255, 50)
    metres = rows.astype(np.float32) / 1000
    metres[0, :5], metres[0, 5:] = np.nan, np.inf
    assert np.array_equal(pixels(picture_of(IMAGE, image(definitions, "32FC1", metres))), shades)


def test_depth_without_any_distance_says_so(definitions: Definitions) -> None:
    rows = np.full((4, 4), np.nan, np.float32)
    assert "no valid distance" in picture_of(IMAGE, image(definitions, "32FC1", rows)).note


@pytest.mark.parametrize(
    ("encoding", "places"), [("rggb", "rggb"), ("bggr", "bggr"), ("gbrg", "gbrg"), ("grbg", "grbg")]
)
def test_bayer_mosaics_keep_their_colours(definitions: Definitions, encoding: str, places: str) -> None:
    value = {"r": 200, "g": 100, "b": 50}
    rows = np.tile(np.array([value[p] for p in places], np.uint8).reshape(2, 2), (3, 4))
    for bits, data in (("8", rows), ("16", rows.astype(np.uint16) << 8)):
        picture = picture_of(IMAGE, image(definitions, f"bayer_{encoding}{bits}", data))
        assert (picture.width, picture.height) == (4, 3)
        assert np.array_equal(pixels(picture), np.full((3, 4, 3), (200, 100, 50)))
        assert "half its size" in picture.note


def test_yuv_pictures_keep_their_colours(definitions: Definitions) -> None:
    red_y, red_u, red_v = 81, 90, 240
    uyvy = np.tile(np.array([red_u, red_y, red_v, red_y], np.uint8), (2, 2)).reshape(2, 4, 2)
    yuyv = uyvy[:, :, ::-1]
    nv12 = np.concatenate([np.full((2, 4), red_y, np.uint8), np.tile(np.array([red_u, red_v], np.uint8), (1, 2))])
    nv21 = np.concatenate([np.full((2, 4), red_y, np.uint8), np.tile(np.array([red_v, red_u], np.uint8), (1, 2))])
    for encoding, rows in (
        ("yuv422", uyvy),
        ("uyvy", uyvy),
        ("yuyv", yuyv),
        ("yuv422_yuy2", yuyv),
        ("nv12", nv12),
        ("nv21", nv21),
    ):
        message = image(definitions, encoding, rows)
        message.height = 2
        assert np.allclose(pixels(picture_of(IMAGE, message)), np.full((2, 4, 3), (254, 0, 0)), atol=3), encoding


@pytest.mark.parametrize(
    ("fields", "problem"),
    [
        ({"height": 480, "width": 640, "step": 1920}, "data has 12 bytes, but step × height is 1920 × 480 = 921600"),
        ({"step": 3}, "A row of 2 pixels (rgb8) needs 6 bytes, but step is 3"),
        ({"width": 0}, "empty: 0 × 2"),
        ({"encoding": "hologram"}, "encoding «hologram» cannot be shown"),
    ],
)
def test_an_image_that_does_not_fit_its_description_says_why(
    definitions: Definitions, fields: dict[str, object], problem: str
) -> None:
    message = image(definitions, "rgb8", np.zeros((2, 2, 3), np.uint8))
    for name, value in fields.items():
        setattr(message, name, value)
    with pytest.raises(BadData) as caught:
        picture_of(IMAGE, message)
    assert problem in caught.value.message


def test_pictures_keep_to_their_bounds(definitions: Definitions) -> None:
    noise = np.random.default_rng(1).integers(0, 255, (1200, 2000, 3), np.uint8)
    picture = picture_of(IMAGE, image(definitions, "rgb8", noise))
    assert picture.mime == "image/jpeg"
    assert max(picture.width, picture.height) <= 1568 and len(picture.data) <= 700_000
    assert "instead of 2000 × 1200" in picture.note
    small = picture_of(IMAGE, image(definitions, "rgb8", noise), bounds=Bounds(300, 5_000))
    assert max(small.width, small.height) <= 300 and len(small.data) <= 5_000
    pixels(small)
    deep = picture_of(
        IMAGE, image(definitions, "16UC1", noise[:, :, 0].astype(np.uint16)), bounds=Bounds(max_bytes=50_000)
    )
    assert deep.mime == "image/png" and len(deep.data) <= 50_000


def compressed(definitions: Definitions, described: str, data: bytes) -> object:
    message = check(definitions, COMPRESSED_IMAGE, {"format": described})
    message.data = np.frombuffer(data, np.uint8)
    return message


def saved(rows: np.ndarray, file_format: str) -> bytes:
    buffer = io.BytesIO()
    Image.fromarray(rows).save(buffer, file_format)
    return buffer.getvalue()


@pytest.mark.parametrize(("file_format", "mime"), [("JPEG", "image/jpeg"), ("PNG", "image/png")])
def test_a_compressed_picture_that_fits_passes_unchanged(definitions: Definitions, file_format: str, mime: str) -> None:
    data = saved(colours(RED, GREEN), file_format)
    picture = picture_of(COMPRESSED_IMAGE, compressed(definitions, "bgr8; compressed", data))
    assert (picture.data, picture.mime, picture.width, picture.height) == (data, mime, 4, 4)


def test_a_compressed_picture_that_is_too_large_is_encoded_again(definitions: Definitions) -> None:
    data = saved(colours(*[RED, GREEN] * 500), "PNG")
    picture = picture_of(COMPRESSED_IMAGE, compressed(definitions, "png", data), bounds=Bounds(max_side=100))
    assert picture.width == 100 and picture.data != data


def test_compressed_depth_is_shown_as_depth(definitions: Definitions) -> None:
    millimetres = np.tile(np.array([[0, 1000, 4000]], np.uint16), (2, 1))
    data = struct.pack("<iff", 0, 0, 0) + saved(millimetres, "PNG")
    picture = picture_of(COMPRESSED_IMAGE, compressed(definitions, "16UC1; compressedDepth png", data))
    assert "1.000 m to 4.000 m" in picture.note and "(33.3%)" in picture.note
    scale, offset = 1000.0, 100.0
    inverse = np.array([[0, 1100, 350]], np.uint16)
    data = struct.pack("<iff", 0, scale, offset) + saved(inverse, "PNG")
    picture = picture_of(COMPRESSED_IMAGE, compressed(definitions, "32FC1; compressedDepth", data))
    assert "1.000 m to 4.000 m" in picture.note


def test_sixteen_bit_png_by_its_description(definitions: Definitions) -> None:
    data = saved(np.array([[1000, 4000]], np.uint16), "PNG")
    assert "1.000 m to 4.000 m" in picture_of(COMPRESSED_IMAGE, compressed(definitions, "16UC1; png", data)).note
    assert "black is 1000" in picture_of(COMPRESSED_IMAGE, compressed(definitions, "mono16; png", data)).note


@pytest.mark.parametrize(
    ("described", "data", "problem"),
    [
        ("jpeg", b"", "0 bytes with the format «jpeg» are not a whole picture"),
        ("jpeg", saved(colours(*[RED, BLUE] * 40), "JPEG")[:-200], "not a whole picture"),
        ("jpeg", b"\0" * 100, "not a whole picture"),
        ("16UC1; compressedDepth rvl", b"\0" * 100, "RVL"),
        ("16UC1; compressedDepth png", b"\0" * 5, "incomplete"),
        ("png", saved(np.zeros((9000, 9000), np.uint8), "PNG"), "too large to show"),
    ],
)
def test_compressed_data_that_is_no_picture_says_why(
    definitions: Definitions, described: str, data: bytes, problem: str
) -> None:
    with pytest.raises(BadData, match=problem):
        picture_of(COMPRESSED_IMAGE, compressed(definitions, described, data))


def grid(definitions: Definitions, cells: np.ndarray) -> object:
    message = check(definitions, OCCUPANCY_GRID, {
        "header": {"frame_id": "map"},
        "info": {
            "resolution": 0.05, "width": cells.shape[1], "height": cells.shape[0],
            "origin": {"position": {"x": -1, "y": 2}, "orientation": {"z": 1, "w": 1}},
        },
    })  # fmt: skip
    message.data = cells.astype(np.int8).ravel()
    return message


def test_a_map_has_its_first_row_at_the_bottom_and_tells_its_facts(definitions: Definitions) -> None:
    cells = np.array([[0, 100, -1], [0, 0, 50]])
    message = grid(definitions, cells)
    picture = picture_of(OCCUPANCY_GRID, message)
    drawing = map_drawing(OccupancyGrid(message), BOUNDS)
    scale = round(0.05 / drawing.metres_per_pixel)
    left, top = drawing.left_px + scale // 2, drawing.top_px + scale // 2
    cells = pixels(picture)[top : top + 2 * scale : scale, left : left + 3 * scale : scale, 0]
    assert cells.tolist() == [[255, 255, 128], [255, 0, 128]]
    facts = OccupancyGrid(message).facts()
    assert (facts.free, facts.occupied, facts.unknown) == pytest.approx((3 / 6, 2 / 6, 1 / 6))
    assert (facts.origin_x_m, facts.origin_y_m, facts.origin_yaw_rad) == pytest.approx((-1, 2, 1.5707963))
    assert "3 × 2 cells of 0.05 m (0.15 m × 0.10 m)" in picture.note and "turned by 90.0°" in picture.note


def test_walls_stay_visible_on_a_map_that_is_made_smaller(definitions: Definitions) -> None:
    cells = np.zeros((3001, 4000))
    cells[1500] = 100
    picture = picture_of(OCCUPANCY_GRID, grid(definitions, cells))
    assert max(picture.width, picture.height) <= 1568 and "3 × 3 cells" in picture.note
    drawing = map_drawing(OccupancyGrid(grid(definitions, cells)), BOUNDS)
    shown = pixels(picture)[drawing.top_px :, drawing.left_px : drawing.left_px + -(-4000 // 3)]
    assert (shown == 0).all(axis=2).any(axis=0).all()


@pytest.mark.parametrize("turned", [False, True])
def test_a_map_shows_the_robot_where_it_is(definitions: Definitions, turned: bool) -> None:
    message = grid(definitions, np.zeros((40, 60)))  # 3 m × 2 m from (-1, 2), turned by 90°
    robot = Place(-2.0, 2.5, np.pi)
    if not turned:
        message.info.origin.orientation.z, message.info.origin.orientation.w = 0.0, 1.0
        robot = Place(-0.5, 3.0, np.pi / 2)
    drawing = map_drawing(OccupancyGrid(message), BOUNDS, robot)
    orange = np.argwhere((drawing.raster.pixels == (255, 140, 0)).all(axis=2))
    row, column = (orange.min(axis=0) + orange.max(axis=0)) / 2
    x = (column - drawing.left_px) * drawing.metres_per_pixel
    y = 2 - (row - drawing.top_px) * drawing.metres_per_pixel
    assert (x, y) == pytest.approx((0.5, 1.0), abs=0.06)
    assert np.ptp(orange[:, 0]) > np.ptp(orange[:, 1])  # up in the picture
    assert ("(0.50, 1.00)" if turned else "(-0.50, 3.00)") in drawing.raster.note


def labelled(definitions: Definitions, encoding: str, dtype: str, *values: int) -> Picture:
    """Patches of 20 × 20 pixels with these values."""
    rows = np.array([values], dtype).repeat(20, axis=0).repeat(20, axis=1)
    return picture_of(IMAGE, image(definitions, encoding, rows))


@pytest.mark.parametrize(
    ("encoding", "dtype"),
    [("mono8", "u1"), ("8UC1", "u1"), ("mono16", "<u2"), ("16UC1", "<u2"), ("16SC1", "<i2"), ("32SC1", "<i4")],
)
def test_labels_are_seen_in_colours_of_their_own(definitions: Definitions, encoding: str, dtype: str) -> None:
    picture = labelled(definitions, encoding, dtype, 0, 1, 2, 17, 255)
    colours = pixels(picture)[10, 10::20].astype(int)
    assert colours[0].tolist() == [0, 0, 0]
    apart = [np.abs(one - other).max() for index, one in enumerate(colours) for other in colours[index + 1 :]]
    assert min(apart) > 50
    assert f"{encoding}, labels" in picture.note and f"17 #{bytes(colours[3].tolist()).hex()} 20.0%" in picture.note


def test_a_grey_picture_is_not_taken_for_labels(definitions: Definitions) -> None:
    noise = np.random.default_rng(5).integers(0, 30, (60, 80), dtype=np.uint8)  # a dark photograph
    assert "labels" not in picture_of(IMAGE, image(definitions, "mono8", noise)).note
    assert "labels" not in labelled(definitions, "mono8", "u1", 0, 255).note  # a mask is seen as it is
    assert "labels" not in labelled(definitions, "mono8", "u1", 0, 0).note
    assert "Depth" in labelled(definitions, "16UC1", "<u2", 0, 800, 900).note
    assert "black is -40000" in labelled(definitions, "32SC1", "<i4", *range(-40_000, 40_000, 200)).note


def test_a_map_whose_data_does_not_fit_says_so(definitions: Definitions) -> None:
    message = grid(definitions, np.zeros((2, 3)))
    message.info.width = 4
    with pytest.raises(BadData, match="data has 6 cells, but width × height is 4 × 2 = 8"):
        picture_of(OCCUPANCY_GRID, message)


def test_other_types_are_no_pictures() -> None:
    with pytest.raises(BadValue, match="is not a picture"):
        picture_of("std_msgs/msg/String", object())


def test_a_kind_of_picture_is_one_line_in_the_table(definitions: Definitions, monkeypatch: pytest.MonkeyPatch) -> None:
    def red_raster(message: object, bounds: Bounds) -> Raster:
        return Raster(np.full((2, 3, 3), RED, np.uint8), f"red, at most {bounds.max_side}", "exact")

    message = grid(definitions, np.zeros((2, 3), np.int8))
    with pytest.raises(BadValue, match="Choose from: map"):
        picture_of(OCCUPANCY_GRID, message, "red")
    monkeypatch.setattr(makers, "MAKERS", {**makers.MAKERS, (OCCUPANCY_GRID, "red"): red_raster})
    picture = picture_of(OCCUPANCY_GRID, message, "red", Bounds(max_side=64))
    assert (pixels(picture) == RED).all() and picture.note == "red, at most 64"
    assert picture_of(OCCUPANCY_GRID, message) == picture_of(OCCUPANCY_GRID, message, "map")
