"""The verdict on robots made for the purpose: what is a fault, and above all what is none."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import pytest

from ros2_mcp.model.qos import Endpoint, QoS
from ros2_mcp.ops.measure.health_check import Expectations, Health, check_health, to_measure
from ros2_mcp.ops.sources.source import GraphSnapshot
from ros2_mcp.robot import TopicEndpoints
from support.made_windows import Make, Recorded, Window

SCAN = "sensor_msgs/msg/LaserScan"
TWIST = "geometry_msgs/msg/Twist"
DIAGNOSTICS = "diagnostic_msgs/msg/DiagnosticArray"


def endpoint(node: str, type_name: str, **qos: Any) -> Endpoint:
    return Endpoint(node, type_name, "", node, QoS(**qos))


def topic(name: str, publishers: Sequence[Endpoint] = (), subscribers: Sequence[Endpoint] = ()) -> TopicEndpoints:
    return TopicEndpoints(name, publishers, subscribers)


async def check(present: Sequence[TopicEndpoints], windows: Sequence[Window], **expected: Any) -> Health:
    scene = GraphSnapshot({each.topic: each for each in present}, ["/lidar", "/nav"], ["/reset"])
    source = Recorded(windows, scene)
    source.is_live = True
    return await check_health(source, Expectations(**expected))


def at(rate_hz: float, duration_s: float = 3.0) -> list[tuple[float, dict[str, Any]]]:
    return [(0.05 + i / rate_hz, {}) for i in range(int((duration_s - 0.05) * rate_hz) + 1)]


PASSING = [(1.0, 0, "fine"), (2.0, 2, "no data"), (3.0, 0, "fine")]
LIDAR = topic("/scan", [endpoint("/lidar", SCAN)])


@pytest.mark.parametrize(
    ("rate_hz", "verdict", "state"),
    [(10, "HEALTHY", "OK"), (1.0, "HEALTHY", "OK"), (0.95, "HEALTHY", "OK"), (0.5, "DEGRADED", "SLOW")],
)
async def test_a_sensor_slower_than_expected_degrades(window: Make, rate_hz: float, verdict: str, state: str) -> None:
    found = await check([LIDAR], [window("/scan", SCAN, at(rate_hz), 3.0)])
    assert (found.verdict, found.topics[0].state) == (verdict, state)


async def test_a_single_message_tells_how_slow_it_is_at_least(window: Make) -> None:
    found = await check([LIDAR], [window("/scan", SCAN, [(1.0, {})], 3.0)])
    assert (found.verdict, found.topics[0].rate_hz) == ("DEGRADED", None)


async def test_a_sensor_that_stopped_degrades_and_an_expected_one_is_critical(window: Make) -> None:
    stopped = window("/scan", SCAN, at(20, 3.0), 6.0)
    found = await check([LIDAR], [stopped])
    assert (found.verdict, found.topics[0].state) == ("DEGRADED", "STOPPED")
    assert found.findings[0].problem.startswith("It has stopped: nothing in the last 3.0 s, from ")
    assert (await check([LIDAR], [stopped], topics=["scan"])).verdict == "CRITICAL"
    assert (await check([LIDAR], [window("/scan", SCAN, at(20, 5.1), 6.0)])).verdict == "HEALTHY"


async def test_a_sensor_that_was_interrupted_degrades_and_it_is_told_when(window: Make) -> None:
    times = [at / 20 for at in (*range(1, 40), *range(100, 200))]
    found = await check([LIDAR], [window("/scan", SCAN, [(at, {}) for at in times], 10.0)])
    assert (found.verdict, found.topics[0].state) == ("DEGRADED", "INTERRUPTED")
    assert found.findings[0].problem.startswith("It was interrupted: nothing for 3.0 s from ")


async def test_a_sensor_that_stopped_has_stopped_although_it_was_interrupted_for_longer_before(window: Make) -> None:
    times = [at / 20 for at in (*range(1, 40), *range(140, 180))]
    found = await check([LIDAR], [window("/scan", SCAN, [(at, {}) for at in times], 12.0)])
    assert found.topics[0].state == "STOPPED"


async def test_of_a_recording_it_is_told_what_a_component_said_that_is_well_again(window: Make) -> None:
    said = [(at, {"status": [{"level": level, "name": "lidar", "message": text}]}) for at, level, text in PASSING]
    there = topic("/diagnostics", [endpoint("/lidar", DIAGNOSTICS)])
    source = Recorded([window("/diagnostics", DIAGNOSTICS, said, 4.0)], GraphSnapshot({"/diagnostics": there}))
    source.is_live = True
    assert (await check_health(source, Expectations())).verdict == "HEALTHY"
    source.is_live = False
    found = await check_health(source, Expectations())
    assert (found.verdict, found.diagnostics[0].level) == ("DEGRADED", "OK")
    assert "said ERROR at" in found.findings[0].problem and "no data" in found.findings[0].problem


async def test_a_silent_sensor_degrades_and_an_expected_one_is_critical(window: Make) -> None:
    dead = window("/scan", SCAN, [], 3.0)
    found = await check([LIDAR], [dead])
    assert (found.verdict, found.findings[0].subject) == ("DEGRADED", "/scan")
    assert "/lidar" in found.findings[0].recommendation
    assert (await check([LIDAR], [dead], topics=["scan"])).verdict == "CRITICAL"


@pytest.mark.parametrize(
    "quiet",
    [
        topic("/cmd_vel", [endpoint("/nav", TWIST)]),
        topic("/map", [endpoint("/maps", "nav_msgs/msg/OccupancyGrid", durability="transient_local")]),
        topic("/scan_once", [endpoint("/lidar", SCAN, durability="transient_local")]),
        topic("/image/compressedDepth", [endpoint("/camera", "sensor_msgs/msg/CompressedImage")]),
        topic("/goal", (), [endpoint("/nav", "geometry_msgs/msg/PoseStamped")]),
        topic("/rosout", [endpoint("/nav", "rcl_interfaces/msg/Log")]),
        topic("/go/_action/feedback", [endpoint("/nav", SCAN)]),
    ],
    ids=lambda each: each.topic,
)
async def test_silence_that_is_meant_is_no_fault(window: Make, quiet: TopicEndpoints) -> None:
    found = await check([quiet], [window(quiet.topic, quiet.types[0], [], 3.0)])
    assert (found.verdict, found.findings) == ("HEALTHY", [])


async def test_what_is_expected_and_not_there_is_critical_with_the_nearest_name(window: Make) -> None:
    found = await check(
        [LIDAR], [window("/scan", SCAN, at(10), 3.0)], topics=["/scam"], services=["/rest"], nodes=["/lidr", "/nav"]
    )
    assert found.verdict == "CRITICAL"
    assert [(each.subject, each.recommendation) for each in found.findings] == [
        ("/scam", "Did you mean /scan?"),
        ("/rest", "Did you mean /reset?"),
        ("/lidr", "Did you mean /lidar?"),
    ]


async def test_a_mismatch_of_qos_degrades(window: Make) -> None:
    pair = topic("/scan", [endpoint("/lidar", SCAN, reliability="best_effort")], [endpoint("/nav", SCAN)])
    found = await check([pair], [window("/scan", SCAN, at(10), 3.0)])
    assert found.verdict == "DEGRADED"
    assert found.findings[0].problem.startswith("/lidar → /nav: the publisher offers best_effort")


async def test_a_node_that_waits_for_a_sensor_that_nobody_publishes_degrades(window: Make) -> None:
    found = await check([topic("/scan", (), [endpoint("/nav", SCAN)])], [window("/x", SCAN, [], 3.0)])
    assert (found.verdict, found.findings[0].problem) == ("DEGRADED", "/nav waits for it, but nobody publishes.")
    assert found.subscribers_without_publishers == ["/scan"]


async def test_two_nodes_of_one_name_degrade() -> None:
    found = await check_health(Recorded([], GraphSnapshot({}, ["/nav", "/nav"], [])), Expectations())
    assert (found.verdict, found.findings[0].problem) == ("DEGRADED", "2 nodes have this name.")


@pytest.mark.parametrize(
    ("level", "verdict"), [(b"\x00", "HEALTHY"), (b"\x01", "DEGRADED"), (b"\x02", "CRITICAL"), (b"\x03", "DEGRADED")]
)
async def test_the_newest_diagnostics_count(window: Make, level: bytes, verdict: str) -> None:
    statuses = [{"status": [{"name": "lidar", "level": each[0], "message": "hm"}]} for each in (b"\x02", level)]
    messages = [(float(i), status) for i, status in enumerate(statuses)]
    found = await check(
        [topic("/diagnostics", [endpoint("/lidar", DIAGNOSTICS)])], [window("/diagnostics", DIAGNOSTICS, messages, 3.0)]
    )
    assert found.verdict == verdict
    assert [each.message for each in found.diagnostics] == ["hm"]


async def test_a_source_that_knows_no_nodes_misses_none(window: Make) -> None:
    source = Recorded([window("/scan", SCAN, at(10), 3.0)], GraphSnapshot({"/scan": LIDAR}, None, None))
    found = await check_health(source, Expectations(nodes=["/lidar"], services=["/reset"]))
    assert (found.verdict, found.note) == ("HEALTHY", "Nodes and services are not known here.")


def test_costly_topics_are_measured_only_up_to_a_bound_but_always_if_expected() -> None:
    image = "sensor_msgs/msg/Image"
    cameras = [topic(f"/camera{i}", [endpoint("/camera", image)]) for i in range(6)]
    scene = GraphSnapshot({each.topic: each for each in [*cameras, LIDAR]}, [], [])
    chosen, left_out = to_measure(scene, Expectations(["/camera5"]))
    assert chosen == ["/camera5", "/camera0", "/camera1", "/camera2", "/camera3", "/scan"]
    assert left_out == ["/camera4"]


async def test_a_very_broken_robot_still_gives_a_short_report(window: Make) -> None:
    pairs = [
        topic(f"/scan{i}", [endpoint("/lidar", SCAN, reliability="best_effort")], [endpoint("/nav", SCAN)])
        for i in range(200)
    ]
    found = await check(pairs, [window("/x", SCAN, [], 3.0)])
    assert found.counts["findings"] == 200
    assert len(found.findings) == 40 and len(found.topics) == 60


async def test_an_expected_latched_topic_needs_its_one_message_and_no_rate(window: Make) -> None:
    grid = "nav_msgs/msg/OccupancyGrid"
    latched = topic("/map", [endpoint("/maps", grid, durability="transient_local")])
    assert (await check([latched], [window("/map", grid, [(-60.0, {})], 3.0)], topics=["/map"])).verdict == "HEALTHY"
    assert (await check([latched], [window("/map", grid, [], 3.0)], topics=["/map"])).verdict == "CRITICAL"
