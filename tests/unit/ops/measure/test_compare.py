"""Comparisons against the known offset, delay and noise of signals made for the purpose."""

from __future__ import annotations

import math

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


def test_a_known_delay_is_found_between_different_rates_and_under_an_offset(window: Make) -> None:
    slow = np.arange(0.003, 5, 0.1)
    noise = np.random.default_rng(7).normal(0, 0.02, len(slow))
    found = evaluate(
        floats(window, "/a", TIMES, wave(TIMES)), floats(window, "/b", slow, 3 + wave(slow - 0.25) + noise)
    )
    assert found.delay_s == pytest.approx(0.25, abs=0.02)
    assert "200 messages have no partner (250 and 50 came)." in found.reasons


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
    assert evaluate(a, other_clock).paired_by == "nearest time of receipt: the stamps are of different times"
    unset = points(window, "/b", TIMES, np.zeros(len(TIMES)), wave(TIMES))
    assert evaluate(a, unset).paired_by == "nearest time of receipt: the stamps do not rise"


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
    assert found.reasons == ["125 messages have no partner (250 and 125 came)."]


def test_nan_in_both_is_equal_and_in_one_is_told(window: Make) -> None:
    with_nan = wave(TIMES)
    with_nan[10] = math.nan
    a, b = floats(window, "/a", TIMES, with_nan), floats(window, "/b", TIMES, with_nan)
    assert evaluate(a, b).verdict == "IDENTICAL"
    found = evaluate(a, floats(window, "/b", TIMES, wave(TIMES)))
    assert (found.verdict, found.fields[0].not_compared) == ("SIMILAR", 1)


def test_a_silent_topic_is_very_different(window: Make) -> None:
    found = evaluate(floats(window, "/a", TIMES, TIMES), floats(window, "/b", [], []))
    assert (found.verdict, found.reasons) == ("VERY DIFFERENT", ["/b sent nothing."])


def test_arrays_are_compared_element_by_element(window: Make) -> None:
    def scans(topic, extra):
        ranges = [1.0, 2.0, 4.0 + extra]
        return window(topic, "sensor_msgs/msg/LaserScan", [(float(t), {"ranges": ranges}) for t in TIMES])

    field = evaluate(scans("/a", 0), scans("/b", 0.5), ["ranges"]).fields[0]
    assert (field.compared, field.max_difference) == (3 * len(TIMES), 0.5)
    assert field.mean_difference == pytest.approx(0.5 / 3)


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
