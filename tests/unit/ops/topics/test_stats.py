"""How topics flow, of samples made for the purpose."""

from __future__ import annotations

from collections.abc import AsyncGenerator, Sequence
from contextlib import asynccontextmanager
from typing import Any

import pytest

from ros2_mcp.model.errors import NotFound, TypeConflict
from ros2_mcp.model.qos import Endpoint, QoS
from ros2_mcp.ops.sources.source import GraphSnapshot, Stream
from ros2_mcp.ops.topics.stats import MAX_TOPICS, TopicStats, measure
from ros2_mcp.robot import TopicEndpoints
from support.made_windows import START_NS, Make, Recorded, Window

FLOAT = "std_msgs/msg/Float64"


async def only(window: Make, times: Sequence[float], duration_s: float) -> TopicStats:
    made = window("/speed", FLOAT, [(at, {"data": 0.0}) for at in times], duration_s)
    (found,) = (await measure(Recorded([made], GraphSnapshot({}, None, None)), ["/speed"])).topics
    return found


@pytest.mark.promise("ros2_topic_stats", "gaps")
async def test_a_silence_between_messages_is_a_gap(window: Make) -> None:
    found = await only(window, [0.1, 0.2, 0.3, 0.9, 1.0], 1.05)
    assert (found.count, found.gaps, found.longest_gap_s) == (5, 1, pytest.approx(0.6))
    assert found.note == "The longest silence is 0.6 s, from 0.300 s (2023-11-14T22:13:20.300Z) on."


async def test_a_topic_that_has_stopped_is_told(window: Make) -> None:
    found = await only(window, [0.1, 0.2, 0.3, 0.4], 2.4)
    assert (found.gaps, found.longest_gap_s) == (1, pytest.approx(2.0))
    assert found.rate_hz == pytest.approx(10.0)
    assert found.note == "It has stopped: no message in the last 2 s, from 0.400 s (2023-11-14T22:13:20.400Z) on."


@pytest.mark.parametrize(
    ("times", "rate_hz"),
    [
        ([1.0, 1.00002], None),
        ([0.001 + at * 1e-4 for at in range(10)], None),
        ([1.0, 3.0], 0.5),
        ([0.1, 0.2, 0.3, 0.4], 10.0),
        ([at / 1000 for at in range(1, 50)], 1000.0),
    ],
)
async def test_a_few_messages_that_came_together_have_no_rate(
    window: Make, times: Sequence[float], rate_hz: float | None
) -> None:
    found = await only(window, times, 5.0)
    assert found.rate_hz == (rate_hz and pytest.approx(rate_hz))
    assert ("too few to measure a rate" in found.note) == (rate_hz is None) == ("rate unknown" in found.summary())


class OfTwoTypes(Recorded):
    """A robot of which one topic cannot be read."""

    is_live = True

    @asynccontextmanager
    async def follow(self, topic: str, type_name: str = "", **more: Any) -> AsyncGenerator[Stream, None]:
        if topic == "/odd":
            raise TypeConflict(f"{topic} has several types.")
        async with super().follow(topic, type_name, **more) as stream:
            yield stream


async def test_a_topic_of_two_types_is_told_with_its_publishers(window: Make) -> None:
    publishers = [Endpoint(node, kind, "", "", QoS()) for node, kind in (("/a", FLOAT), ("/b", "std_msgs/msg/String"))]
    graph = GraphSnapshot({"/odd": TopicEndpoints("/odd", publishers, [])}, None, None)
    source = OfTwoTypes([window("/speed", FLOAT, [(0.1, {"data": 0.0})], 1.0)], graph)
    found = {one.topic_name: one for one in (await measure(source, ["/odd", "/speed"])).topics}
    assert (found["/odd"].publishers, found["/odd"].publisher_nodes) == (2, ["/a", "/b"])
    assert found["/odd"].topic_type == f"{FLOAT}, std_msgs/msg/String" and "several types" in found["/odd"].error


async def test_a_slow_topic_has_not_stopped_between_two_messages(window: Make) -> None:
    found = await only(window, [1.0, 3.0, 5.0, 7.0], 12.0)
    assert (found.gaps, found.note) == (0, "")


async def test_two_publishers_that_send_in_pairs_have_no_gaps_and_have_not_stopped(window: Make) -> None:
    for pairs in (2, 3, 6):
        times = [at + shift for at in range(1, pairs + 1) for shift in (0.0, 0.015)]
        found = await only(window, times, pairs + 2.0)
        assert (found.gaps, found.note, "gaps" in found.summary()) == (0, "", False), pairs


async def test_what_is_irregular_is_said_and_the_worst_is_named(window: Make) -> None:
    steady = [at / 10 for at in range(1, 60)]
    late = [*steady[:20], *(at + 0.15 for at in steady[20:])]
    broken = [at for at in steady if not 2.05 < at < 2.55]
    windows = [window(f"/{name}", FLOAT, [(at, {"data": 0.0}) for at in times], 6.1) for name, times in
               (("steady", steady), ("late", late), ("broken", broken))]  # fmt: skip
    found = await measure(Recorded(windows, GraphSnapshot({}, None, None)), ["/steady", "/late", "/broken"])
    lines = {line.partition(":")[0]: line for line in found.summary()[1:-1]}
    assert "gaps" not in lines["/steady"]
    assert ", gaps 0, longest period 0.25 s, " in lines["/late"]
    assert ", gaps 1, longest 0.6 s, " in lines["/broken"]
    assert found.summary()[-1] == "Least regular: /broken, silent for 0.6 s, 6 times its usual period of 0.1 s."


async def test_figures_have_no_digits_of_chance(window: Make) -> None:
    found = await only(window, [0.1, 0.2333333, 0.3666667, 0.5], 0.6)
    assert (found.rate_hz, found.period_mean_s, found.period_min_s) == (7.5, 0.133333, 0.133333)


async def test_replayed_history_is_in_no_rate(window: Make) -> None:
    before = [-20.0 + at / 10 for at in range(100)]
    found = await only(window, [*before, 1.0, 2.0, 3.0, 4.0], 4.5)
    assert (found.count, found.replayed, found.rate_hz) == (4, 100, pytest.approx(1.0))
    assert found.bytes_per_second == 10.67  # 4 * 12 / 4.5
    assert found.note == "Not counted: 100 messages, 15 s old, from before."


async def test_of_a_single_moment_no_bytes_per_second_are_told(window: Make) -> None:
    found = await only(window, [0.0], 1e-9)
    assert (found.rate_hz, found.bytes_per_second, found.mean_size_bytes) == (None, None, 12)
    assert "rate unknown, bytes/s unknown, 1 message" in found.summary()


@pytest.mark.promise("ros2_topic_stats", "Measure the traffic of topics, several at once")
async def test_without_names_all_topics_are_measured_that_somebody_publishes(window: Make) -> None:
    here = Endpoint("/node", FLOAT, "", "", QoS())
    published = [f"/speed_{number:02}" for number in range(MAX_TOPICS + 2)]
    topics = {name: TopicEndpoints(name, [here], ()) for name in [*published, "/_hidden", "/rosout"]}
    topics["/nobody"] = TopicEndpoints("/nobody", (), [here])
    picture = Endpoint("/node", "sensor_msgs/msg/Image", "", "", QoS())
    topics["/z_camera"] = TopicEndpoints("/z_camera", [picture], ())
    windows = [window("/z_camera", FLOAT, []), *(window(name, FLOAT, []) for name in published)]
    found = await measure(Recorded(windows, GraphSnapshot(topics, None, None)))
    assert sorted(row.topic_name for row in found.topics) == [*published[: MAX_TOPICS - 1], "/z_camera"]
    assert found.note == f"Not measured (at most 64 topics): {', '.join(published[-3:])}." == found.summary()[-1]


async def test_without_names_and_without_topics_it_says_so(window: Make) -> None:
    with pytest.raises(NotFound, match="has a publisher"):
        await measure(Recorded([window("/speed", FLOAT, [])], GraphSnapshot({}, None, None)))


def stamped(window: Make, topic: str, age_s: float, size: int = 0) -> Window:
    """Scans at 10 Hz whose stamps are so old."""
    messages: list[tuple[float, dict[str, Any]]] = []
    for at in range(1, 30):
        stamp_ns = START_NS + round((at / 10 - age_s) * 1e9)
        stamp = {"sec": stamp_ns // 10**9, "nanosec": stamp_ns % 10**9}
        messages.append((at / 10, {"header": {"stamp": stamp}, "ranges": [1.0] * size}))
    return window(topic, "sensor_msgs/msg/LaserScan", messages, 3.0)


@pytest.mark.parametrize(
    ("age_s", "note"),
    [
        (0.02, ""),
        (47.0, "Its stamps are 47 s old on average: messages are late, or its clock is behind."),
        (-3.0, "Its stamps are 3 s in the future on average: its clock is ahead."),
        (1.7e9, "Its stamps come from another clock (simulated time?), so no ages are given."),
    ],
)
async def test_the_first_line_tells_the_age(window: Make, age_s: float, note: str) -> None:
    source = Recorded([stamped(window, "/scan", age_s)], GraphSnapshot({}, None, None))
    (found,) = (await measure(source, ["/scan"])).topics
    assert found.note == note
    assert (f", age {age_s:.3g} s, " in found.summary()) == (age_s < 1e6)


async def test_empty_stamps_are_counted_and_leave_the_ages_of_the_others(window: Make) -> None:
    def with_stamps(stamps_ns: Sequence[int]) -> Recorded:
        values = [{"header": {"stamp": {"sec": ns // 10**9, "nanosec": ns % 10**9}}} for ns in stamps_ns]
        messages = [(at / 10, value) for at, value in enumerate(values)]
        imu = window("/imu", "sensor_msgs/msg/Imu", messages, len(messages) / 10)
        return Recorded([imu], GraphSnapshot({}, None, None))

    old = [START_NS + round((at / 10 - 60) * 1e9) for at in range(30)]
    (found,) = (await measure(with_stamps([0, *old[1:]]), ["/imu"])).topics
    assert found.age_mean_s == pytest.approx(60.0)
    assert "1 of 30 stamps are empty (0)." in found.note
    (found,) = (await measure(with_stamps([0] * 30), ["/imu"])).topics
    assert (found.age_mean_s, found.note) == (None, "30 of 30 stamps are empty (0).")


@pytest.mark.promise("ros2_topic_stats", "The largest come first")
async def test_the_largest_comes_first_with_its_bytes(window: Make) -> None:
    windows = [stamped(window, f"/scan{size}", 0.0, size) for size in (0, 10_000, 100)]
    found = await measure(Recorded(windows, GraphSnapshot({}, None, None)), ["/scan0", "/scan10000", "/scan100"])
    assert [topic.topic_name for topic in found.topics] == ["/scan10000", "/scan100", "/scan0"]
    assert found.summary()[1].startswith("/scan10000: 10.00 Hz, 387 kB/s, age 0 s, 29 messages.")


async def test_publishers_are_named(window: Make) -> None:
    source = Recorded([stamped(window, "/scan", 0.0)], GraphSnapshot({}, None, None))
    source.is_live = True
    (line,) = (await measure(source, ["/scan"])).summary()
    assert line.endswith("29 messages, from /node.")


def test_a_line_says_that_several_publishers_are_measured_together() -> None:
    nodes = ["/front", "/left", "/rear", "/right"]
    line = TopicStats(topic_name="/scan", publishers=4, publisher_nodes=nodes, count=3).summary()
    assert line.endswith("from /front and /left and /rear and 1 more, 4 publishers together.")


async def test_all_topics_of_a_robot_are_measured_in_one_call(window: Make) -> None:
    names = [f"/t{number}" for number in range(50)]
    source = Recorded([window(name, FLOAT, [(0.1, {})], 1.0) for name in names], GraphSnapshot({}, None, None))
    assert len((await measure(source, names)).topics) == 50
