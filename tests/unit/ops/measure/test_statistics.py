"""Statistics against NumPy on the same samples, and against the known truth of signals made for the purpose."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from ros2_mcp.model.errors import BadInput, BadValue
from ros2_mcp.model.times import both_times
from ros2_mcp.ops.measure import statistics
from ros2_mcp.ops.measure.columns import Columns, Room
from ros2_mcp.ops.measure.statistics import FieldStatistics, TopicStatistics, measure
from ros2_mcp.ops.sources.selection import Selection
from support.made_windows import CODEC, START_NS, Make, Recorded, Window

FLOAT = "std_msgs/msg/Float64"


def when(at_s: float) -> str:
    return both_times(START_NS + round(at_s * 1e9), START_NS)


def floats(window: Make, times, values, **more):
    return window("/x", FLOAT, [(t, {"data": float(v)}) for t, v in zip(times, values, strict=True)], **more)


def evaluate(window: Window, fields=(), most_fields: int = 80) -> TopicStatistics:
    def keep(stream):
        return Columns(
            stream.codec,
            stream.type,
            statistics.measured_fields(stream, fields),
            Room(),
            is_replayed=stream.is_replayed,
        )

    return statistics.evaluate(window.captured(keep), most_fields)


def only(window, fields=()) -> FieldStatistics:
    (field,) = evaluate(window, fields).fields
    return field


@pytest.mark.promise("ros2_topic_statistics", "min, max, mean, std")
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


@pytest.mark.promise("ros2_topic_statistics", "slope")
def test_a_drifting_sensor_shows_its_drift(window: Make) -> None:
    times = np.arange(0, 5, 0.02)
    noise = np.random.default_rng(1).normal(0, 0.001, len(times))
    found = only(floats(window, times, 20 + 0.37 * times + noise))
    assert found.slope == pytest.approx(0.37, abs=0.001)
    assert found.anomalies == []
    assert found.trend == "rises steadily by 0.37/s (+1.84 in 4.98 s)"


def test_rate_and_injected_gaps_are_found_where_they_are(window: Make) -> None:
    times = [t for t in np.arange(0.01, 5, 0.05) if not (1.0 < t < 1.4 or 3.0 < t < 3.6)]
    found = evaluate(floats(window, times, times))
    assert found.period_median_s == pytest.approx(0.05)
    assert found.rate_hz == float(f"{(len(times) - 1) / (times[-1] - times[0]):.4g}")
    assert found.gaps == [f"nothing for 0.450 s from {when(0.96)} on", f"nothing for 0.650 s from {when(2.96)} on"]


def test_a_topic_that_fell_silent_before_the_end_has_a_gap_there(window: Make) -> None:
    times = np.arange(0, 2, 0.1)
    assert evaluate(floats(window, times, times)).gaps == [f"nothing for 3.100 s from {when(1.9)} on"]


def test_what_was_latched_before_is_measured_and_in_no_rate(window: Make) -> None:
    found = evaluate(floats(window, [-60.0, 1.0, 2.0, 3.0, 4.0], [7, 1, 1, 1, 1]))
    assert (found.count, found.rate_hz, found.period_median_s) == (5, pytest.approx(1.0), pytest.approx(1.0))
    assert found.fields[0].max == 7.0
    assert found.note == "1 message, 65 s old, from before: measured, but not counted in the rate."


def test_a_steady_topic_has_no_gap(window: Make) -> None:
    times = np.arange(0.01, 5, 0.05) + np.random.default_rng(0).uniform(-0.01, 0.01, 100)
    assert evaluate(floats(window, times, times)).gaps == []


def test_values_that_are_not_finite_are_counted_and_left_out(window: Make) -> None:
    found = only(floats(window, [0, 1, 2, 3], [1.0, math.nan, math.inf, 3.0]))
    assert (found.count, found.not_finite, found.mean, found.last) == (2, 2, 2.0, 3.0)
    assert found.anomalies == ["2 of 4 values are not finite: 1 NaN, 1 infinite"]


def test_a_field_without_one_finite_value_has_no_numbers(window: Make) -> None:
    found = only(floats(window, [0, 1], [math.nan, math.nan]))
    assert (found.count, found.mean, found.std, found.slope) == (0, None, None, None)
    assert found.anomalies == ["2 of 2 values are not finite: 2 NaN"]
    assert only(floats(window, [0, 1], [math.inf, -math.inf])).anomalies == ["2 of 2 values are not finite: 2 infinite"]


def test_a_stuck_value_is_told_and_a_constant_one_is_only_constant(window: Make) -> None:
    times = np.arange(0, 5, 0.05)
    values = np.random.default_rng(2).normal(0, 1, 100)
    values[40:70] = values[40]
    found = only(floats(window, times, values))
    assert found.anomalies == [f"stuck at {values[40]:g} for 1.450 s from {when(2.0)} on"]
    steady = evaluate(floats(window, times, np.full(100, 9.81)))
    assert (steady.fields, steady.constants) == ([], {"data": 9.81})


def test_a_value_that_is_stuck_several_times_is_told_by_the_longest(window: Make) -> None:
    times = np.arange(0, 5, 0.05)
    values = np.random.default_rng(3).normal(0, 1, 100)
    values[10:35], values[60:90] = values[10], values[60]
    assert only(floats(window, times, values)).anomalies == [f"stuck at {values[60]:g} for 1.450 s from {when(3.0)} on"]


def test_a_value_that_rests_between_rare_moves_is_not_stuck(window: Make) -> None:
    times = np.arange(0, 5, 0.05)
    values = np.repeat(np.random.default_rng(4).normal(0, 1, 10), [5, 15, 8, 12, 10, 10, 9, 11, 6, 14])
    assert only(floats(window, times, values)).anomalies == []


@pytest.mark.promise("ros2_topic_statistics", "jumps")
def test_a_jump_is_told_with_its_time(window: Make) -> None:
    times = np.arange(0, 5, 0.05)
    values = np.sin(times)
    values[60:] += 5
    assert only(floats(window, times, values)).anomalies == [
        f"jump from {values[59]:g} to {values[60]:g} at {when(3.0)}"
    ]


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
    assert (found.count, found.rate_hz, found.note) == (0, None, "No message in this time.")


def test_a_flood_of_fields_is_bounded_and_says_so(window: Make) -> None:
    found = evaluate(window("/odom", "nav_msgs/msg/Odometry", [(0.0, {})]), (), 4)
    assert len(found.fields) == 4 and "11 more fields" in found.note


def test_numbers_at_the_end_of_their_range_are_measured(window: Make) -> None:
    found = only(floats(window, np.arange(10), [1.7e308, -1.7e308] * 5))
    assert (found.count, found.max, found.std) == (10, 1.7e308, None)


@pytest.mark.promise("ros2_topic_statistics", "Also trends")
def test_a_drift_under_noise_stands_in_a_line(window: Make) -> None:
    times = np.arange(0, 60, 0.1)
    noise = np.random.default_rng(2).normal(0, 0.2, len(times))
    found = evaluate(floats(window, times, 21.0 - 0.02 * times + noise, duration_s=60))
    assert found.fields[0].trend.startswith("falls steadily by 0.02")
    assert f"  trends: data {found.fields[0].trend}" in found.summary()


@pytest.mark.parametrize(
    "values",
    [
        np.sin(np.arange(100) / 5),
        np.random.default_rng(5).normal(0, 1, 100),
        np.repeat([0.0, 5.0], 50),
        np.concatenate([np.zeros(50), np.linspace(0, 1, 50)]),
        3.0 + np.arange(100) * 1e-9,
    ],
    ids=["sine", "noise", "step", "starts to move", "rounding"],
)
def test_what_does_not_go_one_way_the_whole_time_has_no_trend(window: Make, values) -> None:
    assert only(floats(window, np.arange(0, 5, 0.05), values)).trend == ""


@pytest.mark.promise("ros2_topic_statistics", "when extremes were reached")
def test_extremes_are_told_with_their_times_and_elements(window: Make) -> None:
    times = np.arange(1, 5, 0.5)
    values = np.array([3.0, 1.0, 4.0, 1.0, 5.0, 9.0, 2.0, 9.0])
    found = only(floats(window, times, values))
    assert (found.min_at, found.max_at) == (when(1.5), when(3.5))
    scans = [{"ranges": [9.0] * 10 + [2.0, math.nan, 5.0, 7.0 - 3 * (t == 3)]} for t in range(4)]
    scans[2]["ranges"][13] = 0.5
    ranges = only(window("/scan", "sensor_msgs/msg/LaserScan", list(enumerate(scans))), ["ranges[10:14]"])
    assert (ranges.min, ranges.min_at) == (0.5, f"element 13, {when(2)}")
    assert (ranges.max, ranges.max_at) == (7.0, f"element 13, {when(0)}")
    thinned = only(window("/scan", "sensor_msgs/msg/LaserScan", list(enumerate(scans))), ["ranges[1::3]"])
    assert (thinned.min, thinned.min_at) == (0.5, f"element 13, {when(2)}")


def test_the_extremes_of_few_fields_stand_in_lines_of_their_own(window: Make) -> None:
    found = evaluate(floats(window, np.arange(1, 5, 0.5), np.array([3.0, 1.0, 4.0, 1.0, 5.0, 9.0, 2.0, 9.0])))
    assert f"  data: min 1 at {when(1.5)}, max 9 at {when(3.5)}" in found.summary()


def test_a_burst_has_no_rate(window: Make) -> None:
    found = evaluate(floats(window, [1.0, 1.00002], [1.0, 2.0], duration_s=5.0))
    assert found.rate_hz is None and "Only 2 messages came, within 0.02 ms: too few to measure a rate." in found.note


def test_of_a_recording_times_count_from_its_beginning(window: Make) -> None:
    capture = floats(window, [1.0, 2.0], [1, 2]).captured(
        lambda stream: Columns(CODEC, FLOAT, statistics.measured_fields(stream, ()), Room())
    )
    found = statistics.evaluate(replace(capture, began_ns=START_NS - 60_000_000_000))
    assert found.seconds_from_start == 60.0
    assert found.fields[0].max_at == "62.000 s (2023-11-14T22:13:22.000Z)"


def test_a_constant_is_told_once_and_short(window: Make) -> None:
    messages = [
        (at / 10, {"pose": {"pose": {"position": {"x": at * at}}, "covariance": [0.5, *[0.0] * 35]}})
        for at in range(20)
    ]
    found = evaluate(window("/odom", "nav_msgs/msg/Odometry", messages))
    assert [row.field for row in found.fields] == ["pose.pose.position.x"]
    assert found.constants["pose.pose.position.y"] == 0.0
    assert found.constants["pose.covariance"] == "36 values, 0 to 0.5"
    (line,) = [line for line in found.summary() if "constant" in line]
    assert "pose.pose.position.y 0, " in line and line.endswith("and 2 more")


def test_of_a_burst_of_jumps_the_last_one_is_told_too(window: Make) -> None:
    values = np.random.default_rng(1).normal(0, 0.1, 200)
    values[100:112] += np.where(np.arange(12) % 2, -20.0, 20.0)
    anomalies = only(floats(window, np.arange(200) / 40, values)).anomalies
    assert len(anomalies) == 6 and anomalies[0].endswith(f"at {when(2.5)}")
    assert anomalies[4] == "8 more jumps, up to the last one:" and anomalies[5].endswith(f"at {when(2.8)}")


@pytest.mark.parametrize(("offset", "step"), [(50.1, 4e-4), (5.55e6, 30.0)], ids=["latitude", "northing"])
def test_a_jump_and_a_drift_of_metres_far_from_the_origin_are_found(window: Make, offset: float, step: float) -> None:
    times = np.arange(0, 5, 0.05)
    walk = offset + step / 1000 * np.sin(times)
    assert "jump" in only(floats(window, times, walk + np.where(times < 2, 0, step))).anomalies[0]
    assert only(floats(window, times, offset + step / 10 * times)).trend.startswith("rises")


def test_what_only_some_messages_have_is_no_constant(window: Make) -> None:
    joints = [(at / 20, {"position": [1.0], "effort": [5.0] if at in (3, 8) else []}) for at in range(100)]
    found = evaluate(window("/joints", "sensor_msgs/msg/JointState", joints))
    assert "effort" not in found.constants and "position" in found.constants
    assert [(row.field, row.count) for row in found.fields] == [("velocity", 0), ("effort", 2)]


def test_large_whole_numbers_are_compared_exactly(window: Make) -> None:
    def counters(numbers: list[int]) -> Window:
        return window("/counter", "std_msgs/msg/UInt64", [(at / 4, {"data": n}) for at, n in enumerate(numbers)])

    assert evaluate(counters([2**60 + at for at in range(20)])).constants == {}
    assert evaluate(counters([2**60 + 1] * 20)).constants == {"data": "1152921504606846977"}
    assert evaluate(counters([7] * 20)).constants == {"data": 7.0}
