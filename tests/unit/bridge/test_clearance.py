"""What a scan shows, and how fast that lets a robot go: mounts, what beams tell, circles."""

from __future__ import annotations

import array
import math
import struct
from types import SimpleNamespace
from typing import Any

import pytest

from ros2_mcp_bridge.motion.clearance import Body, Clearance, Guard, Mount
from ros2_mcp_bridge.motion.course import Circle, Line, Pose, Turn
from ros2_mcp_bridge.motion.points import MOST_POINTS, places

ROUND = Body(0.2, 0.2, 0.2, 0.2)
CENTRE = Mount.of((0.0, 0.0, 0.0), (0.0, 0.0, 0.0, 1.0))
FAST = 1.0


def scan(ranges: dict[int, float], otherwise: float = math.inf) -> Any:
    """A scan with a beam for each degree from -180° on; `ranges` by degrees."""
    return SimpleNamespace(
        angle_min=-math.pi,
        angle_max=math.pi,
        angle_increment=math.radians(1),
        ranges=[ranges.get(degree, otherwise) for degree in range(-180, 180)],
        range_min=0.1,
        range_max=10.0,
    )


def heard(message: Any, guard_m: float = 0.3, body: Body = ROUND, mount: Mount = CENTRE) -> Clearance:
    clearance = Clearance(guard_m, body, mount)
    clearance.hear(message, 0.0)
    return clearance


def ahead(clearance: Clearance, direction: int = 1, curvature: float = 0.0) -> float:
    return clearance.allowed(FAST, curvature, direction, 0.0, 0.0).speed


def test_nothing_in_sight_lets_it_go() -> None:
    clearance = heard(scan({}))
    assert ahead(clearance) == ahead(clearance, -1) == FAST
    assert clearance.allowed_turn(FAST, 0.0).speed == FAST


def test_a_scan_with_another_number_of_ranges_than_its_header_tells_is_refused() -> None:
    message = scan({0: 1.0}, otherwise=3.0)
    message.angle_max = 0.5
    with pytest.raises(ValueError, match="it has 360 ranges, and the header tells 210"):
        heard(message)


@pytest.mark.parametrize("unknown", [math.nan, 0.0, 0.05])
def test_a_direction_of_which_nothing_is_told_is_not_seen(unknown: float) -> None:
    clearance = heard(scan(dict.fromkeys(range(-60, 60), 2.0), otherwise=unknown))
    assert Guard({"scan": clearance}).sees(0.0)
    assert not Guard({"scan": clearance}).sees(math.pi)


def test_what_is_too_near_to_be_measured_is_in_the_way() -> None:
    far = Body(0.05, 0.05, 0.05, 0.05)
    assert ahead(heard(scan({0: -math.inf}), body=far)) == 0.0


def test_it_slows_down_before_what_it_must_not_come_near() -> None:
    speeds = [ahead(heard(scan({0: distance_m}))) for distance_m in (0.45, 0.6, 0.8, 1.2, 3.0)]
    assert speeds == sorted(speeds)
    assert speeds[0] == 0.0
    assert speeds[-1] == FAST
    gap = heard(scan({0: 0.6})).allowed(FAST, 0.0, 1, 0.0, 0.0).gap
    assert gap == pytest.approx(0.4)


def test_the_way_it_has_gone_since_the_scan_counts() -> None:
    clearance = heard(scan({0: 1.0}))
    assert clearance.allowed(FAST, 0.0, 1, 0.3, 0.0).speed < ahead(clearance)


def test_what_is_behind_it_stops_it_only_backwards() -> None:
    clearance = heard(scan({-180: 0.6}))
    assert (ahead(clearance), ahead(clearance, -1) < FAST) == (FAST, True)


def test_what_holds_it_is_told_and_not_what_is_far_ahead() -> None:
    """Something at 0.25 m beside its middle: 0.05 m from its side."""
    beside = heard(scan({0: 2.0, 90: 0.25}))
    held = beside.allowed(FAST, 0.0, 1, 0.0, 0.0)
    assert held.speed < 0.02
    assert held.gap == pytest.approx(0.05)
    assert math.degrees(held.bearing) == pytest.approx(90.0)


def test_a_scanner_that_lies_on_its_back_sees_left_on_the_left() -> None:
    turned = Mount.of((0.1, 0.0, 0.3), (1.0, 0.0, 0.0, 0.0))  # half a turn about x
    clearance = heard(scan({90: 0.5}), mount=turned)
    bearing = clearance.allowed_turn(FAST, 0.0).bearing
    assert bearing == pytest.approx(math.atan2(-0.5, 0.1))


def test_the_robot_itself_is_not_in_its_way() -> None:
    assert ahead(heard(scan({0: 0.15, 90: 0.19}))) == FAST


def test_on_a_circle_what_stands_on_it_counts_and_not_what_is_straight_ahead() -> None:
    on_circle = heard(scan({45: math.sqrt(2.0)}))  # at (1, 1): a quarter of the circle with radius 1 to the left
    assert ahead(on_circle, curvature=1.0) < FAST
    assert ahead(on_circle, curvature=-1.0) == FAST
    far_ahead = heard(scan({0: 2.5}))
    assert ahead(far_ahead, curvature=1.0) == FAST


@pytest.mark.parametrize("side", [1, -1])
def test_a_circle_ends_where_it_should(side: int) -> None:
    circle = Circle(Pose(0.0, 0.0, 0.0), side * math.pi / 2, 2.0)
    steps = [side * math.pi / 2 * number / 10 for number in range(11)]
    places = [circle.place(Pose(2 * math.sin(abs(a)), side * 2 * (1 - math.cos(a)), a)) for a in steps]
    assert places[-1].along == pytest.approx(circle.whole) == pytest.approx(math.pi)
    assert [place.aside_m for place in places] == pytest.approx([0.0] * 11, abs=1e-9)
    assert [place.heading for place in places] == pytest.approx([0.0] * 11, abs=1e-9)


def test_a_line_and_a_turn_measure_from_where_they_begin() -> None:
    start = Pose(1.0, 2.0, math.pi / 2)
    along, aside_m, heading = Line(start, 3.0).place(Pose(0.9, 3.0, math.pi / 2 + 0.1))
    assert (along, aside_m, heading) == pytest.approx((1.0, 0.1, 0.1))
    assert Turn(start, -7.0).place(Pose(1.0, 2.0, math.pi / 2 - 6.5)).along == pytest.approx(-6.5)


def cloud(xyz: Any, *, rows: int = 1, letter: str = "f", order: str = "<", padding: int = 4) -> Any:
    """A cloud of these points, `padding` bytes before each."""
    packed = b"".join(b"\0" * padding + struct.pack(f"{order}3{letter}", *point) for point in xyz)
    size = struct.calcsize(f"{order}{letter}")
    fields = [
        SimpleNamespace(name=name, offset=padding + number * size, datatype=7 if letter == "f" else 8)
        for number, name in enumerate("xyz")
    ]
    step, width = padding + 3 * size, len(xyz) // rows
    return SimpleNamespace(
        fields=fields, is_bigendian=order == ">", height=rows, width=width, point_step=step, row_step=width * step,
        data=array.array("B", packed),
    )  # fmt: skip


LYING, OPTICAL = (0.0, 0.0, 0.0, 1.0), (-0.5, 0.5, -0.5, 0.5)


def floor() -> list[tuple[float, float, float]]:
    return [(0.5 + x / 10, y / 10, -0.1) for x in range(30) for y in range(-15, 16)]


def sensed(points: Any, rotation: Any = LYING, **how: Any) -> Clearance:
    clearance = Clearance(0.3, ROUND, Mount.of((0.1, 0.0, 0.1), rotation), heights=(0.05, 0.5))
    clearance.hear(cloud(points, **how), 0.0)
    return clearance


@pytest.mark.parametrize("how", [{}, {"letter": "d"}, {"order": ">"}, {"padding": 0}, {"rows": 5}])
def test_what_stands_on_the_ground_is_in_the_way_and_the_ground_is_not(how: Any) -> None:
    assert ahead(sensed(floor(), **how)) == FAST
    box = [*floor()[:-5], *((0.7, y / 50, 0.1) for y in range(-2, 3))]
    clearance = sensed(box, **how)
    assert ahead(clearance) < FAST
    assert clearance.allowed(FAST, 0.0, 1, 0.0, 0.0).gap == pytest.approx(0.6)  # 0.8 m from the base, less 0.2 m of it


def test_what_hangs_above_the_robot_is_not_in_its_way() -> None:
    assert ahead(sensed([*floor(), (0.6, 0.0, 0.5)])) == FAST


def test_a_camera_that_looks_ahead_in_its_optical_frame_sees_a_wall_ahead() -> None:
    wall = [(-y / 20, z / 20, 0.7) for y in range(-10, 11) for z in range(-5, 3)]
    clearance = sensed(wall, OPTICAL)
    assert clearance.allowed(FAST, 0.0, 1, 0.0, 0.0).gap == pytest.approx(0.6)
    assert Guard({"cloud": clearance}).sees(0.0)
    assert not Guard({"cloud": clearance}).sees(math.pi)


def test_a_large_cloud_is_thinned_and_a_box_of_a_few_pixels_is_still_in_the_way() -> None:
    columns, rows = 640, 480
    points = [
        (1.0 if 300 < column < 330 and 200 < row < 260 else 4.0, (320 - column) / 200, (240 - row) / 200)
        for row in range(rows)
        for column in range(columns)
    ]
    seen = cloud(points, rows=rows)
    assert len(list(places(seen))) <= MOST_POINTS
    clearance = Clearance(0.3, ROUND, CENTRE, heights=(-0.5, 0.5))
    clearance.hear(seen, 0.0)
    assert clearance.allowed(FAST, 0.0, 1, 0.0, 0.0).gap == pytest.approx(0.8)


@pytest.mark.parametrize("broken", [{"fields": []}, {"point_step": 1000}, {"data": array.array("B")}])
def test_a_broken_cloud_is_not_heard(broken: dict[str, Any]) -> None:
    message = cloud(floor())
    vars(message).update(broken)
    clearance = Clearance(0.3, ROUND, CENTRE)
    with pytest.raises(ValueError, match="a cloud"):
        clearance.hear(message, 1.0)
    assert clearance.heard_at == -math.inf


def test_of_two_scanners_each_sees_its_side_and_the_one_that_allows_less_counts() -> None:
    front = heard(scan(dict.fromkeys(range(-90, 90), math.inf), otherwise=math.nan))
    behind = {degree: 0.55 if abs(degree) > 150 else math.inf for degree in range(-180, 180) if abs(degree) > 90}
    rear = heard(scan(behind, otherwise=math.nan))
    guard = Guard({"front": front, "rear": rear})
    assert guard.sees(0.0) and guard.sees(math.pi)
    assert guard.allowed(FAST, 0.0, 1, 0.0, 0.0).speed == FAST
    assert guard.allowed(FAST, 0.0, -1, 0.0, 0.0).speed < FAST


@pytest.mark.parametrize(
    ("fields", "why"),
    [
        ({"angle_increment": 0.0}, "angle_increment is 0 for 360 ranges"),
        ({"angle_increment": math.nan}, "angle_increment is NaN"),
        ({"angle_min": math.inf}, "angle_min is infinite"),
        ({"angle_increment": 1.0}, "turns"),
    ],
)
def test_a_scan_without_bearings_is_not_heard(fields: dict[str, float], why: str) -> None:
    clearance = Clearance(0.3, ROUND, CENTRE)
    with pytest.raises(ValueError, match=why):
        clearance.hear(SimpleNamespace(**{**vars(scan({0: 0.4})), **fields}), 1.0)
    assert clearance.heard_at == -math.inf


@pytest.mark.parametrize("limits", [{"range_max": 0.0}, {"range_max": math.nan}, {"range_min": math.nan}])
def test_an_obstacle_counts_where_a_driver_has_not_filled_in_what_its_scanner_can(limits: dict[str, float]) -> None:
    message = SimpleNamespace(**{**vars(scan({0: 0.4})), **limits})
    assert ahead(heard(message)) == 0.0
    assert ahead(heard(message), -1) == FAST
