"""Statistics against NumPy on the same samples, and against the known truth of signals made for the purpose."""

from __future__ import annotations

import math

import numpy as np
import pytest

from ros2_mcp.model.errors import BadInput, BadValue
from ros2_mcp.ops.measure import statistics
from ros2_mcp.ops.measure.columns import Columns, Room
from ros2_mcp.ops.measure.statistics import FieldStatistics, TopicStatistics, measure
from ros2_mcp.ops.sources.selection import Selection
from support.made_windows import Make, Recorded, Window

FLOAT = "std_msgs/msg/Float64"


def floats(window: Make, times, values, **more):
    return window("/x", FLOAT, [(t, {"data": float(v)}) for t, v in zip(times, values, strict=True)], **more)


def evaluate(window: Window, fields=(), most_fields: int = 80) -> TopicStatistics:
    def keep(stream):
        return Columns(stream.codec, stream.type, statistics.measured_fields(stream, fields), Room())

    return statistics.evaluate(window.captured(keep), most_fields)


def only(window, fields=()) -> FieldStatistics:
    (field,) = evaluate(window, fields).fields
    return field


def test_the_numbers_agree_with_numpy(window: Make) -> None:
    random = np.random.default_rng(3)
    times, values = np.sort(random.uniform(0, 5, 200)), random.normal(1e6, 3.0, 200)
    found = only(floats(window, times, values))
    assert found.count == 200
    assert [found.min, found.max, found.first, found.last] == [values.min(), values.max(), values[0], values[-1]]
    assert found.mean == pytest.approx(values.mean(), rel=1e-14)
    assert found.std == pytest.approx(values.std(), rel=1e-9)
    assert found.slope == pytest.approx(np.polyfit(times, values, 1)[0], rel=1e-6)
    assert found.anomalies == []


def test_a_drifting_sensor_shows_its_drift(window: Make) -> None:
    times = np.arange(0, 5, 0.02)
    noise = np.random.default_rng(1).normal(0, 0.001, len(times))
    found = only(floats(window, times, 20 + 0.37 * times + noise))
    assert found.slope == pytest.approx(0.37, abs=0.001)
    assert found.anomalies == []


def test_rate_and_injected_gaps_are_found_where_they_are(window: Make) -> None:
    times = [t for t in np.arange(0.01, 5, 0.05) if not (1.0 < t < 1.4 or 3.0 < t < 3.6)]
    found = evaluate(floats(window, times, times))
    assert found.period_median_s == pytest.approx(0.05)
    assert found.rate_hz == pytest.approx((len(times) - 1) / (times[-1] - times[0]))
    assert found.gaps == ["nothing for 0.450 s from 0.960 s on", "nothing for 0.650 s from 2.960 s on"]


def test_a_topic_that_fell_silent_before_the_end_has_a_gap_there(window: Make) -> None:
    times = np.arange(0, 2, 0.1)
    assert evaluate(floats(window, times, times)).gaps == ["nothing for 3.100 s from 1.900 s on"]


def test_a_steady_topic_has_no_gap(window: Make) -> None:
    times = np.arange(0.01, 5, 0.05) + np.random.default_rng(0).uniform(-0.01, 0.01, 100)
    assert evaluate(floats(window, times, times)).gaps == []


def test_values_that_are_not_finite_are_counted_and_left_out(window: Make) -> None:
    found = only(floats(window, [0, 1, 2, 3], [1.0, math.nan, math.inf, 3.0]))
    assert (found.count, found.not_finite, found.mean, found.last) == (2, 2, 2.0, 3.0)
    assert found.anomalies == ["2 of 4 values are not finite (1 NaN)"]


def test_a_field_without_one_finite_value_has_no_numbers(window: Make) -> None:
    found = only(floats(window, [0, 1], [math.nan, math.nan]))
    assert (found.count, found.mean, found.std, found.slope) == (0, None, None, None)


def test_a_stuck_value_is_told_and_a_constant_one_is_only_constant(window: Make) -> None:
    times = np.arange(0, 5, 0.05)
    values = np.random.default_rng(2).normal(0, 1, 100)
    values[40:70] = values[40]
    found = only(floats(window, times, values))
    assert found.anomalies == [f"stuck at {values[40]:g} for 1.450 s from 2.000 s on"]
    steady = only(floats(window, times, np.full(100, 9.81)))
    assert steady.constant and steady.anomalies == []


def test_a_value_that_is_stuck_several_times_is_told_by_the_longest(window: Make) -> None:
    times = np.arange(0, 5, 0.05)
    values = np.random.default_rng(3).normal(0, 1, 100)
    values[10:35], values[60:90] = values[10], values[60]
    assert only(floats(window, times, values)).anomalies == [f"stuck at {values[60]:g} for 1.450 s from 3.000 s on"]


def test_a_value_that_rests_between_rare_moves_is_not_stuck(window: Make) -> None:
    times = np.arange(0, 5, 0.05)
    values = np.repeat(np.random.default_rng(4).normal(0, 1, 10), [5, 15, 8, 12, 10, 10, 9, 11, 6, 14])
    assert only(floats(window, times, values)).anomalies == []


def test_a_jump_is_told_with_its_time(window: Make) -> None:
    times = np.arange(0, 5, 0.05)
    values = np.sin(times)
    values[60:] += 5
    assert only(floats(window, times, values)).anomalies == [f"jump from {values[59]:g} to {values[60]:g} at 3.000 s"]


def test_what_is_only_the_rounding_of_a_robot_that_rests_is_no_jump(window: Make) -> None:
    times = np.arange(0, 5, 0.05)
    values = -1.34219 + np.where(times < 2, 3e-8, 0.0) + 1e-12 * np.random.default_rng(6).normal(0, 1, 100)
    assert not any("jump" in line for line in only(floats(window, times, values)).anomalies)


@pytest.mark.parametrize(
    "values",
    [
        np.sin(np.arange(100) / 5),
        np.random.default_rng(5).normal(0, 1, 100),
        np.floor(np.arange(100) / 4),
        np.concatenate([np.zeros(50), np.linspace(0, 1, 50)]),
        np.concatenate([np.linspace(0, 1, 50), np.ones(50)]),
    ],
    ids=["sine", "noise", "coarse encoder", "starts to move", "comes to rest"],
)
def test_an_ordinary_signal_has_no_anomalies(window: Make, values) -> None:
    assert only(floats(window, np.arange(0, 5, 0.05), values)).anomalies == []


def test_an_array_is_one_entry_over_all_its_elements(window: Make) -> None:
    scans = [[1.0, math.inf, 3.0], [5.0, 7.0, math.nan]]
    found = evaluate(window("/scan", "sensor_msgs/msg/LaserScan", [(i, {"ranges": s}) for i, s in enumerate(scans)]))
    ranges = next(field for field in found.fields if field.field == "ranges")
    assert (ranges.array, ranges.count, ranges.not_finite) == (True, 4, 2)
    assert (ranges.min, ranges.max, ranges.mean, ranges.first, ranges.last) == (1.0, 7.0, 4.0, 2.0, 6.0)
    assert ranges.std == pytest.approx(np.std([1, 3, 5, 7]))


def test_all_fields_are_measured_but_stamps_and_bytes(window: Make) -> None:
    odometry = evaluate(window("/odom", "nav_msgs/msg/Odometry", [(0.0, {})]))
    assert len(odometry.fields) == 15
    assert not any("stamp" in field.field for field in odometry.fields)
    image = evaluate(window("/image", "sensor_msgs/msg/Image", [(0.0, {"data": [1, 2]})]))
    assert "data" not in [field.field for field in image.fields]


def test_chosen_fields_may_be_messages_elements_and_bytes(window: Make) -> None:
    joints = window("/joints", "sensor_msgs/msg/JointState", [(0.0, {"position": [1, 2]}), (1.0, {"position": [3]})])
    assert [each.count for each in evaluate(joints, ["position[0]", "position[1]"]).fields] == [2, 1]
    image = window("/image", "sensor_msgs/msg/Image", [(0.0, {"data": [1, 3]})])
    assert only(image, ["data"]).mean == 2.0
    odometry = window("/odom", "nav_msgs/msg/Odometry", [(0.0, {})])
    chosen = evaluate(odometry, ["pose.pose.position"]).fields
    assert [each.field for each in chosen] == [f"pose.pose.position.{axis}" for axis in "xyz"]


def test_transforms_in_a_list_can_be_measured(window: Make) -> None:
    transforms = [{"transform": {"translation": {"x": x}}} for x in (1.0, 2.0, 6.0)]
    tf = window("/tf", "tf2_msgs/msg/TFMessage", [(0.0, {"transforms": transforms})])
    assert only(tf, ["transforms[*].transform.translation.x"]).mean == 3.0
    assert only(tf, ["transforms[1].transform.translation.x"]).mean == 2.0


async def test_a_topic_that_is_not_there_leaves_the_others(window: Make) -> None:
    source = Recorded([floats(window, [0, 1], [1, 2])])
    there, missing = (await measure(source, ["/x", "/y"], Selection())).topics
    assert there.count == 2 and not there.error
    assert missing.error == "There is no topic /y."


async def test_a_field_that_no_topic_has_is_refused_before_measuring(window: Make) -> None:
    source = Recorded([floats(window, [0, 1], [1, 2])])
    with pytest.raises(BadValue, match="no field 'dta'"):
        await measure(source, ["/x"], Selection(fields=["dta"]))
    with pytest.raises(BadInput, match="twice"):
        await measure(source, ["/x", "/x"], Selection())


def test_a_silent_topic_says_so(window: Make) -> None:
    found = evaluate(floats(window, [], [], publishers=["/node"]))
    assert (found.count, found.rate_hz, found.note) == (0, None, "Silent in this time.")


def test_a_flood_of_fields_is_bounded_and_says_so(window: Make) -> None:
    found = evaluate(window("/odom", "nav_msgs/msg/Odometry", [(0.0, {})]), (), 4)
    assert len(found.fields) == 4 and "11 more fields" in found.note


def test_numbers_at_the_end_of_their_range_are_measured(window: Make) -> None:
    found = only(floats(window, np.arange(10), [1.7e308, -1.7e308] * 5))
    assert (found.count, found.max, found.std) == (10, 1.7e308, None)
