"""Comparisons against the known offset, delay and noise of signals made for the purpose."""

from __future__ import annotations

import math
import tracemalloc

import numpy as np
import pytest

from ros2_mcp.model.errors import BadInput, BadValue, NotFound
from ros2_mcp.ops.measure import compare as comparing
from ros2_mcp.ops.measure.compare import Comparison, compare
from support.made_windows import Make, Recorded, Window

FLOAT = "std_msgs/msg/Float64"
POINT = "geometry_msgs/msg/PointStamped"
TIMES = np.arange(0.01, 5, 0.02)


def evaluate(first: Window, second: Window, fields=(), **more) -> Comparison:
    sides = (first, second)
    captures = [side.captured(comparing.keeping([first.type, second.type], fields)) for side in sides]
    return comparing.evaluate(*captures, **more)


def floats(window: Make, topic: str, times, values):
    return window(topic, FLOAT, [(float(t), {"data": float(v)}) for t, v in zip(times, values, strict=True)])


def wave(times):
    """Not periodic within the window."""
    return np.sin(2 * times) + 0.5 * np.sin(5.3 * times + 1)


def points(window: Make, topic: str, times, stamps, values):
    stamps = [{"sec": 100 + int(s // 1), "nanosec": round((s % 1) * 1e9)} for s in stamps]
    messages = zip(times, stamps, values, strict=True)
    return window(
        topic, POINT, [(float(t), {"header": {"stamp": s}, "point": {"x": float(v)}}) for t, s, v in messages]
    )


def test_a_copy_is_identical(window: Make) -> None:
    found = evaluate(floats(window, "/a", TIMES, wave(TIMES)), floats(window, "/b", TIMES + 0.001, wave(TIMES)))
    assert (found.verdict, found.pairs, found.equal_messages) == ("IDENTICAL", len(TIMES), len(TIMES))
    assert found.receive_delay_s == pytest.approx(0.001, abs=1e-6)
    (field,) = found.fields
    assert (field.max_difference, field.correlation) == (0.0, pytest.approx(1.0))


def test_messages_from_before_are_told_with_their_number_and_age(window: Make) -> None:
    times = [-8.0, *TIMES]
    found = evaluate(floats(window, "/a", times, np.ones(len(times))), floats(window, "/b", times, np.ones(len(times))))
    assert found.verdict == "IDENTICAL" and found.reasons[1].endswith("s old, from before.")
    assert found.reasons[1].startswith("/a: 1 message, ") and found.reasons[2].startswith("/b: 1 message, ")
    assert "from before" not in " ".join(evaluate(*(floats(window, one, TIMES, TIMES) for one in ("/a", "/b"))).reasons)


@pytest.mark.promise(
    "ros2_topic_compare", "Compare two topics over the same time, field by field: differences, correlation, delay"
)
def test_the_differences_agree_with_numpy(window: Make) -> None:
    random = np.random.default_rng(4)
    one, other = random.normal(5, 1, len(TIMES)), random.normal(5.5, 1, len(TIMES))
    (field,) = evaluate(floats(window, "/a", TIMES, one), floats(window, "/b", TIMES, other)).fields
    difference = other - one
    assert field.mean_difference == pytest.approx(difference.mean())
    assert field.max_difference == pytest.approx(np.abs(difference).max())
    assert field.rms_difference == pytest.approx(np.sqrt((difference**2).mean()))
    assert field.correlation == pytest.approx(np.corrcoef(one, other)[0, 1])
    assert field.delay_s is None


@pytest.mark.parametrize("delay", [-0.3, -0.05, 0.0, 0.123, 0.5])
def test_a_known_delay_is_found(window: Make, delay: float) -> None:
    found = evaluate(floats(window, "/a", TIMES, wave(TIMES)), floats(window, "/b", TIMES, wave(TIMES - delay)))
    assert found.delay_s == pytest.approx(delay, abs=0.003)
    later = [reason for reason in found.reasons if "ms behind" in reason]
    whose = {-1: "By its values, /a is", 1: "By its values, /b is"}
    assert [reason.startswith(whose[1 if delay > 0 else -1]) for reason in later] == ([True] if delay else [])


def test_a_known_delay_is_found_between_different_rates_and_under_an_offset(window: Make) -> None:
    slow = np.arange(0.003, 5, 0.1)
    noise = np.random.default_rng(7).normal(0, 0.02, len(slow))
    found = evaluate(
        floats(window, "/a", TIMES, wave(TIMES)), floats(window, "/b", slow, 3 + wave(slow - 0.25) + noise)
    )
    assert found.delay_s == pytest.approx(0.25, abs=0.02)
    assert "200 messages have no partner (250 and 50 received)." in found.reasons


def test_a_known_offset_is_the_mean_difference(window: Make) -> None:
    (field,) = evaluate(
        floats(window, "/a", TIMES, wave(TIMES)), floats(window, "/b", TIMES, wave(TIMES) + 0.25)
    ).fields
    assert field.mean_difference == pytest.approx(0.25)
    assert field.rms_difference == pytest.approx(0.25)
    assert field.delay_s == pytest.approx(0.0, abs=0.001)


def test_messages_are_paired_by_stamp_however_late_they_come(window: Make) -> None:
    values = wave(TIMES)
    a = points(window, "/a", TIMES[:-20], TIMES[:-20], values[:-20])
    b = points(window, "/b", TIMES[:-20] + 0.31, TIMES[:-20], values[:-20])
    found = evaluate(a, b)
    assert (found.verdict, found.paired_by) == ("IDENTICAL", "stamp")
    assert found.receive_delay_s == pytest.approx(0.31)
    by_receipt = evaluate(a, b, by_stamp=False)
    assert by_receipt.verdict != "IDENTICAL"
    assert by_receipt.paired_by == "nearest time of receipt"


def test_stamps_that_cannot_pair_are_not_used(window: Make) -> None:
    a = points(window, "/a", TIMES, TIMES, wave(TIMES))
    other_clock = points(window, "/b", TIMES, TIMES + 5000, wave(TIMES))
    assert evaluate(a, other_clock).paired_by == "nearest time of receipt: the stamps do not overlap in time"
    unset = points(window, "/b", TIMES, np.zeros(len(TIMES)), wave(TIMES))
    assert evaluate(a, unset).paired_by == "nearest time of receipt: the stamps do not increase"


@pytest.mark.promise("ros2_topic_compare", "The verdict is IDENTICAL, SIMILAR, DIFFERENT or VERY DIFFERENT")
@pytest.mark.parametrize(
    ("share", "verdict"),
    [(0.0, "IDENTICAL"), (0.0005, "IDENTICAL"), (0.02, "SIMILAR"), (0.3, "DIFFERENT"), (0.9, "VERY DIFFERENT")],
)
def test_the_verdict_follows_the_difference(window: Make, share: float, verdict: str) -> None:
    constant = np.full(len(TIMES), 10.0)
    found = evaluate(floats(window, "/a", TIMES, constant), floats(window, "/b", TIMES, constant * (1 - share)))
    assert found.verdict == verdict
    assert len(found.reasons) == 1


def test_a_tolerance_widens_identical(window: Make) -> None:
    a, b = floats(window, "/a", TIMES, np.full(len(TIMES), 10.0)), floats(window, "/b", TIMES, np.full(len(TIMES), 9.0))
    assert evaluate(a, b, tolerance_percent=10.0).verdict == "IDENTICAL"
    assert evaluate(a, b, tolerance_percent=9.9).verdict == "DIFFERENT"


def test_lost_messages_are_no_identity(window: Make) -> None:
    found = evaluate(floats(window, "/a", TIMES, wave(TIMES)), floats(window, "/b", TIMES[::2], wave(TIMES[::2])))
    assert found.verdict == "SIMILAR"
    assert found.reasons == ["125 messages have no partner (250 and 125 received)."]


def test_nan_in_both_is_equal_and_in_one_is_told(window: Make) -> None:
    with_nan = wave(TIMES)
    with_nan[10] = math.nan
    a, b = floats(window, "/a", TIMES, with_nan), floats(window, "/b", TIMES, with_nan)
    assert evaluate(a, b).verdict == "IDENTICAL"
    found = evaluate(a, floats(window, "/b", TIMES, wave(TIMES)))
    assert (found.verdict, found.fields[0].not_compared) == ("SIMILAR", 1)


def test_a_silent_topic_is_very_different(window: Make) -> None:
    found = evaluate(floats(window, "/a", TIMES, TIMES), floats(window, "/b", [], []))
    assert (found.verdict, found.reasons) == ("VERY DIFFERENT", ["No message was received on /b."])


def test_arrays_are_compared_element_by_element(window: Make) -> None:
    def scans(topic, extra):
        ranges = [1.0, 2.0, 4.0 + extra]
        return window(topic, "sensor_msgs/msg/LaserScan", [(float(t), {"ranges": ranges}) for t in TIMES])

    field = evaluate(scans("/a", 0), scans("/b", 0.5), ["ranges"]).fields[0]
    assert (field.compared, field.max_difference) == (3 * len(TIMES), 0.5)
    assert field.mean_difference == pytest.approx(0.5 / 3)


def turned(window: Make, topic: str, angles, sign=1.0, kind="geometry_msgs/msg/QuaternionStamped"):
    halves = np.asarray(angles) / 2
    values = sign * np.array([np.zeros(len(halves)), np.zeros(len(halves)), np.sin(halves), np.cos(halves)]).T
    found = [dict(zip("xyzw", map(float, row), strict=True)) for row in values]
    return window(topic, kind, [(float(t), {"quaternion": q}) for t, q in zip(TIMES, found, strict=True)])


@pytest.mark.promise("ros2_topic_compare", "Quaternions are compared as rotations")
def test_a_quaternion_and_its_negative_are_the_same_rotation(window: Make) -> None:
    flips = np.where(np.arange(len(TIMES)) % 3 == 0, -1.0, 1.0)[:, None]
    found = evaluate(turned(window, "/a", wave(TIMES)), turned(window, "/b", wave(TIMES), flips))
    assert found.verdict == "IDENTICAL"
    (field,) = found.fields
    assert (field.field, field.compared_as, field.unit) == ("quaternion", "rotation", "rad")
    assert field.max_difference == pytest.approx(0.0, abs=1e-7)
    assert field.delay_s == pytest.approx(0.0, abs=0.001)


@pytest.mark.promise("ros2_topic_compare", "Quaternions are compared as rotations")
def test_rotations_differ_by_the_angle_between_them(window: Make) -> None:
    a, b = turned(window, "/a", wave(TIMES)), turned(window, "/b", wave(TIMES) + 0.3, -1.0)
    found = evaluate(a, b)
    (field,) = found.fields
    assert [field.mean_difference, field.rms_difference, field.scale] == pytest.approx([0.3, 0.3, math.pi])
    assert found.reasons == ["quaternion differs by 0.3 rad (9.55 %) RMS, at most 0.3."]
    half = evaluate(turned(window, "/a", np.zeros(len(TIMES))), turned(window, "/b", np.full(len(TIMES), math.pi)))
    assert (half.verdict, half.fields[0].max_percent) == ("VERY DIFFERENT", pytest.approx(100.0))
    (z,) = evaluate(a, b, ["quaternion.z"]).fields
    assert (z.field, z.compared_as) == ("quaternion.z", "number")


def test_a_late_rotation_has_its_delay(window: Make) -> None:
    found = evaluate(turned(window, "/a", wave(TIMES)), turned(window, "/b", wave(TIMES - 0.2), -1.0))
    assert found.delay_s == pytest.approx(0.2, abs=0.02)


def test_a_quaternion_that_was_never_set_is_no_rotation(window: Make) -> None:
    a, unset = turned(window, "/a", wave(TIMES)), turned(window, "/b", wave(TIMES), 0.0)
    (field,) = evaluate(a, unset).fields
    assert (field.compared, field.not_compared) == (0, len(TIMES))
    assert evaluate(unset, unset).verdict == "IDENTICAL"


def test_rotations_in_a_list_are_compared_one_by_one(window: Make) -> None:
    def transforms(topic: str, sign: float):
        rotation = {"z": sign * math.sin(0.2), "w": sign * math.cos(0.2)}
        value = {"transforms": [{"transform": {"rotation": one}} for one in (rotation, {"w": sign})]}
        return window(topic, "tf2_msgs/msg/TFMessage", [(float(t), value) for t in TIMES])

    (field,) = evaluate(transforms("/a", 1.0), transforms("/b", -1.0), ["transforms[*].transform.rotation"]).fields
    assert (field.field, field.compared, field.compared_as) == (
        "transforms[*].transform.rotation",
        2 * len(TIMES),
        "rotation",
    )
    assert field.max_difference == pytest.approx(0.0, abs=1e-7)


def poses(window: Make, topic: str, thetas):
    return window(
        topic, "geometry_msgs/msg/Pose2D", [(float(t), {"theta": float(v)}) for t, v in zip(TIMES, thetas, strict=True)]
    )


@pytest.mark.promise("ros2_topic_compare", "angles (by name: yaw, heading, ...) modulo one turn")
def test_an_angle_on_the_other_side_of_a_turn_is_near(window: Make) -> None:
    heading = math.pi + 0.2 * wave(TIMES)
    wrapped = (heading + 0.01 + math.pi) % math.tau - math.pi
    found = evaluate(poses(window, "/a", heading), poses(window, "/b", wrapped), ["theta"])
    (field,) = found.fields
    assert (field.compared_as, field.unit, found.verdict) == ("angle", "rad", "SIMILAR")
    assert [field.mean_difference, field.max_difference] == pytest.approx([0.01, 0.01])
    assert field.correlation == pytest.approx(1.0)
    assert field.delay_s == pytest.approx(0.0, abs=0.001)


def test_what_exceeds_a_turn_is_compared_as_a_number(window: Make) -> None:
    degrees = poses(window, "/a", np.full(len(TIMES), 359.0)), poses(window, "/b", np.full(len(TIMES), 1.0))
    (field,) = evaluate(*degrees, ["theta"]).fields
    assert (field.compared_as, field.max_difference) == ("number", 358.0)


def test_a_span_of_angles_is_no_angle(window: Make) -> None:
    def scan(topic: str, end: float):
        return window(topic, "sensor_msgs/msg/LaserScan", [(float(t), {"angle_max": end}) for t in TIMES])

    (field,) = evaluate(scan("/a", math.pi), scan("/b", -math.pi), ["angle_max"]).fields
    assert (field.compared_as, field.max_difference) == ("number", pytest.approx(math.tau))


def test_comparing_takes_little_memory_for_each_message(window: Make) -> None:
    """As much as leaves room for two topics of a million messages in a process of 300 MB."""
    times = np.arange(20_000) / 100
    sides = [floats(window, topic, times, wave(times)) for topic in ("/a", "/b")]
    captures = [side.captured(comparing.keeping([FLOAT, FLOAT], ())) for side in sides]
    comparing.evaluate(*captures)  # what is imported and cached once
    tracemalloc.start()
    comparing.evaluate(*captures)
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert peak / len(times) < 120


async def test_what_cannot_be_compared_is_refused_before_measuring(window: Make) -> None:
    source = Recorded([floats(window, "/a", [0], [0]), points(window, "/b", [0], [0], [0])])
    for topics, fields, error in [
        (("/a", "/a"), [], BadInput),
        (("/a", "/b"), [], BadInput),
        (("/a", "/b"), ["data"], BadValue),
        (("/a", "/c"), [], NotFound),
    ]:
        with pytest.raises(error):
            await compare(source, topics, fields)


def test_numbers_at_the_end_of_their_range_are_compared(window: Make) -> None:
    huge = np.full(len(TIMES), 1.7e308)
    a = floats(window, "/a", TIMES, huge)
    assert evaluate(a, a).verdict == "IDENTICAL"
    assert evaluate(a, floats(window, "/b", TIMES, -huge)).verdict == "VERY DIFFERENT"


def fixes(window: Make, topic: str, north_deg: float = 0.0, wander_deg: float = 1e-6):
    value = {"latitude": 50.1 + north_deg, "longitude": 8.6, "altitude": 100.0}
    messages = [(float(t), {**value, "latitude": value["latitude"] + wander_deg * float(t)}) for t in TIMES]
    return window(topic, "sensor_msgs/msg/NavSatFix", messages)


@pytest.mark.parametrize("wander_deg", [1e-6, 0.0])
def test_two_places_on_earth_are_not_identical(window: Make, wander_deg: float) -> None:
    fields = ["latitude", "longitude", "altitude"]
    here = fixes(window, "/a", wander_deg=wander_deg)
    assert evaluate(here, fixes(window, "/b", 0.04, wander_deg), fields).verdict == "VERY DIFFERENT"
    assert evaluate(here, fixes(window, "/b", 2e-5, wander_deg), fields).verdict == "SIMILAR"  # 2 m
    assert evaluate(here, fixes(window, "/b", 1e-8, wander_deg), fields).verdict == "IDENTICAL"  # 1 mm


def test_what_spreads_little_beside_its_offset_is_compared_by_its_spread(window: Make) -> None:
    northing = 5.55e6 + TIMES
    far = evaluate(floats(window, "/a", TIMES, northing), floats(window, "/b", TIMES, northing + 5000))
    assert (far.verdict, far.fields[0].scale) == ("VERY DIFFERENT", pytest.approx(5555, 1e-3))
    wide = evaluate(floats(window, "/a", TIMES, wave(TIMES)), floats(window, "/b", TIMES, wave(TIMES)))
    assert wide.fields[0].scale == pytest.approx(np.abs(wave(TIMES)).max())


def test_the_largest_difference_stands_beside_what_is_identical(window: Make) -> None:
    constant = np.full(len(TIMES), 10.0)
    found = evaluate(floats(window, "/a", TIMES, constant), floats(window, "/b", TIMES, constant + 0.005))
    assert found.reasons == ["All 1 fields of 250 pairs agree within 0.1 %; the largest difference is in data: 0.005."]


def joints(window: Make, topic: str, **lists):
    return window(topic, "sensor_msgs/msg/JointState", [(float(t), lists) for t in TIMES])


def test_fields_of_which_there_is_nothing_agree_in_nothing(window: Make) -> None:
    a, b = joints(window, "/a", position=[1.0]), joints(window, "/b", position=[1.0], effort=[5.0])
    found = evaluate(a, a, ["effort"])
    assert (found.verdict, found.reasons) == ("VERY DIFFERENT", ["No value on either topic: effort."])
    found = evaluate(a, b, ["effort"])
    assert (found.verdict, len(found.reasons)) == ("VERY DIFFERENT", 1)
    assert evaluate(a, b, ["position", "effort"]).verdict == "DIFFERENT"
    found = evaluate(a, a, ["position", "effort"])
    assert found.reasons[0].startswith("All 1 fields of")
    assert (found.verdict, found.reasons[1:]) == ("IDENTICAL", ["No value on either topic: effort."])


def test_a_rotation_that_was_never_set_is_not_said_to_be_missing(window: Make) -> None:
    found = evaluate(turned(window, "/a", wave(TIMES)), turned(window, "/b", wave(TIMES), 0.0))
    assert found.reasons == ["250 rotations are missing or never set on one topic only."]
    assert found.verdict == "VERY DIFFERENT"


def test_a_message_that_is_a_quaternion_is_a_rotation(window: Make) -> None:
    def itself(topic: str, sign: float):
        value = {"z": sign * math.sin(0.2), "w": sign * math.cos(0.2)}
        return window(topic, "geometry_msgs/msg/Quaternion", [(float(t), value) for t in TIMES])

    found = evaluate(itself("/a", 1.0), itself("/b", -1.0))
    assert (found.verdict, [row.field for row in found.fields]) == ("IDENTICAL", ["x, y, z, w"])


def test_a_quaternion_is_a_rotation_in_whatever_order_its_fields_are_chosen(window: Make) -> None:
    chosen = [f"quaternion.{axis}" for axis in "wxyz"]
    found = evaluate(turned(window, "/a", wave(TIMES)), turned(window, "/b", wave(TIMES), -1.0), chosen)
    assert (found.verdict, [row.field for row in found.fields]) == ("IDENTICAL", ["quaternion"])


@pytest.mark.parametrize(
    ("field", "one", "other", "compared_as"),
    [
        ("roll", 5.0, -1.2, "number"),  # degrees
        ("roll", 3.1, -3.1, "angle"),
        ("roll", 6.2, 0.1, "angle"),
        ("torque_rad", 6.0, 0.0, "number"),
        ("yaw_deg", 359.0, 1.0, "angle"),
        ("yaw_rad", 5.0, -1.2, "angle"),
    ],
)
def test_a_name_alone_makes_no_angle_of_what_is_no_radians(
    window: Make, field: str, one: float, other: float, compared_as: str
) -> None:
    a, b = (window(topic, "odd_msgs/msg/Angles", [(float(t), {field: v}) for t in TIMES]) for topic, v in
            (("/a", one), ("/b", other)))  # fmt: skip
    (found,) = evaluate(a, b, [field]).fields
    assert found.compared_as == compared_as
