"""Curves drawn where they belong, breaks and marks visible; ticks round and honest."""

from __future__ import annotations

import numpy as np
import pytest
from PIL import ImageColor

from ros2_mcp.model.errors import BadData
from ros2_mcp.model.pictures import BOUNDS, Bounds
from ros2_mcp.pictures.plot import COLOURS, NOT_FINITE, Curve, Drawn, Figure, Panel, Span, draw, labels, span_of, ticks
from ros2_mcp.pictures.raster import Raster, finished
from ros2_mcp.values.definitions import Definitions
from ros2_mcp.values.units import unit_of

BLUE, ORANGE, RED = (ImageColor.getrgb(colour) for colour in (*COLOURS[:2], NOT_FINITE))


def curve(x, y, apart=(), name="signal") -> Curve:
    breaks = np.zeros(len(x), bool)
    breaks[list(apart)] = True
    return Curve(name, np.asarray(x, float), np.asarray(y, float), breaks)


def drawn(*curves: Curve, **more) -> Drawn:
    return draw(Figure([Panel(curves, "m")], "title", "x", Span(0, 10), **more), 600, 400)


def colour_at(picture: Drawn, x: float, y: float) -> tuple[int, ...]:
    across, down = picture.frames[0].pixels(np.array([x]), np.array([y]))
    return picture.image.getpixel((round(across[0]), round(down[0])))


def has_colour(picture: Drawn, x: float, colour: tuple[int, ...]) -> bool:
    """Whether the column of a value of x has pixels of this colour inside the frame."""
    frame = picture.frames[0]
    across = round(frame.pixels(np.array([x]), np.array([0.0]))[0][0])
    inside = np.asarray(picture.image)[int(frame.top) : int(frame.bottom), across - 1 : across + 2]
    return bool((np.abs(inside.astype(int) - colour).sum(axis=2) < 12).any())


def test_a_line_is_drawn_through_its_points_and_nowhere_else() -> None:
    picture = drawn(curve([0, 10], [0, 100]))
    pixels = np.asarray(picture.image).astype(int)
    for x in (1, 3, 6.5, 9):
        (across,), (down,) = picture.frames[0].pixels(np.array([x]), np.array([10 * x]))
        near = pixels[round(down) - 1 : round(down) + 2, round(across) - 1 : round(across) + 2]
        assert (near == BLUE).all(axis=2).any()
    assert colour_at(picture, 3.3, 63) == (255, 255, 255)


def test_the_scale_of_a_picture_is_its_ticks() -> None:
    """The grid line of a tick is where the curve has that value: found in the pixels alone."""
    picture = drawn(curve([0, 4.9, 5, 10], [0, 0, 100, 100]))
    pixels = np.asarray(picture.image).astype(int)
    frame = picture.frames[0]
    column = pixels[int(frame.top) + 4 : int(frame.bottom) - 3, int(frame.left) + 30]
    curve_rows = np.flatnonzero(np.abs(column - BLUE).sum(axis=1) < 12)
    right = pixels[int(frame.top) + 4 : int(frame.bottom) - 3, int(frame.right) - 30]
    upper_rows = np.flatnonzero(np.abs(right - BLUE).sum(axis=1) < 12)
    grid = np.flatnonzero((column == (228, 228, 228)).all(axis=1))
    assert 2 <= len(grid) <= 12
    spacing = (curve_rows.mean() - upper_rows.mean()) / 5
    assert ticks(frame.y, 9)[1] - ticks(frame.y, 9)[0] == pytest.approx(20)
    assert [round((curve_rows.mean() - row) / spacing, 1) % 1 for row in grid] == pytest.approx(
        [0] * len(grid), abs=0.1
    )


def test_a_gap_is_a_break_in_the_curve() -> None:
    picture = drawn(curve([0, 4, 7, 10], [5, 5, 5, 5], apart=[2]))
    assert [has_colour(picture, x, BLUE) for x in (2, 5.5, 8.5)] == [True, False, True]


def test_values_that_are_not_finite_break_the_curve_and_are_marked_at_the_edges() -> None:
    picture = drawn(curve(range(11), [1, 1, np.nan, 1, 1, np.inf, 1, 1, -np.inf, 1, 1]))
    frame = picture.frames[0]
    pixels = np.asarray(picture.image).astype(int)

    def near(x: float, down: float, colour: tuple[int, ...]) -> bool:
        across = int(frame.pixels(np.array([x]), np.array([0.0]))[0][0])
        part = pixels[int(down) - 10 : int(down) + 10, across - 5 : across + 6]
        return bool((np.abs(part - colour).sum(axis=2) < 60).any())

    assert near(2, frame.bottom, RED) and not near(2, frame.top, RED)
    assert near(5, frame.top, BLUE) and not near(5, frame.bottom, BLUE)
    assert near(8, frame.bottom, BLUE) and not near(8, frame.top, BLUE)
    assert colour_at(picture, 2, 1) != BLUE and colour_at(picture, 0.5, 1) == BLUE


def test_dense_noise_keeps_its_highest_and_lowest_points() -> None:
    values = np.random.default_rng(1).normal(0, 1, 100_000)
    values[70_000] = 30.0
    picture = drawn(curve(np.linspace(0, 10, 100_000), values))
    assert colour_at(picture, 7.0, 29) == BLUE
    assert colour_at(picture, 6.5, 29) != BLUE


def test_equal_axes_have_one_scale() -> None:
    frame = draw(Figure([Panel([curve([0, 8], [0, 2])])], "", "", equal=True), 700, 500).frames[0]
    scale = (frame.right - frame.left) / frame.x.length
    assert scale == pytest.approx((frame.bottom - frame.top) / frame.y.length)


def test_panels_share_the_x_axis_and_do_not_overlap() -> None:
    panels = [Panel([curve([0, 1], [0, 10.0**power])]) for power in (-3, 0, 6)]
    one, two, three = draw(Figure(panels, "", "", Span(0, 1)), 800, 600).frames
    assert one.left == two.left == three.left
    assert one.bottom < two.top < two.bottom < three.top < three.bottom < 600


def test_a_panel_without_values_is_drawn_empty() -> None:
    assert drawn(curve([], [])).frames[0].y == Span(0, 1)
    assert draw(Figure([Panel([])], "", ""), 300, 200).image.size == (300, 200)


@pytest.mark.parametrize(
    ("low", "high", "found"),
    [
        (0, 10, ["0", "2", "4", "6", "8", "10"]),
        (-0.012, 0.011, ["-0.010", "-0.005", "0.000", "0.005", "0.010"]),
        (12.551, 12.598, ["12.56", "12.57", "12.58", "12.59"]),
        (0, 4e12, ["0", "1e12", "2e12", "3e12", "4e12"]),
    ],
)
def test_ticks_are_round_and_their_labels_true(low: float, high: float, found: list[str]) -> None:
    values = ticks(Span(low, high), 5)
    assert [label.replace("e+", "e") for label in labels(values)] == found
    assert [float(label) for label in labels(values)] == pytest.approx(values)


@pytest.mark.parametrize("high", [1e-300, 1.0, 1e15, 1.7e308])
@pytest.mark.parametrize("low", [0.0, 1.0, -1e6, -1.7e308])
def test_every_span_has_two_ticks_whose_labels_differ(low: float, high: float) -> None:
    span = span_of([np.array([low, high, np.nan, np.inf])])
    values = ticks(span, 6)
    assert span.low < span.high
    assert 2 <= len(values) <= 15
    assert len(set(labels(values))) == len(values)
    assert [float(label) for label in labels(values)] == pytest.approx(values, rel=1e-3, abs=span.length * 1e-3)


def test_a_picture_that_is_too_large_gets_fewer_colours_and_then_is_refused() -> None:
    picture = drawn(*(curve(np.linspace(0, 10, 5000), np.random.default_rng(n).normal(0, 1, 5000)) for n in range(12)))
    raster = Raster(np.asarray(picture.image), "", "drawing")
    whole = finished(raster, BOUNDS)
    smaller = finished(raster, Bounds(max_bytes=len(whole.data) - 1))
    assert len(smaller.data) < len(whole.data) <= 700_000
    assert (smaller.width, smaller.height) == (whole.width, whole.height) == (600, 400)
    with pytest.raises(BadData):
        finished(raster, Bounds(max_bytes=100))


@pytest.mark.parametrize(
    ("type_name", "path", "unit"),
    [
        ("nav_msgs/msg/Odometry", "twist.twist.linear.x", "m/s"),
        ("nav_msgs/msg/Odometry", "twist.twist.angular.z", "rad/s"),
        ("nav_msgs/msg/Odometry", "pose.pose.position.x", "m"),
        ("nav_msgs/msg/Odometry", "pose.pose.orientation.w", ""),
        ("sensor_msgs/msg/Imu", "linear_acceleration.x", "m/s²"),
        ("sensor_msgs/msg/LaserScan", "ranges[3]", "m"),
        ("sensor_msgs/msg/BatteryState", "voltage", "V"),
        ("geometry_msgs/msg/Vector3", "x", ""),
        ("std_msgs/msg/Float64", "data", ""),
    ],
)
def test_units_are_those_of_the_interfaces(definitions: Definitions, type_name: str, path: str, unit: str) -> None:
    assert unit_of(definitions, type_name, path) == unit
