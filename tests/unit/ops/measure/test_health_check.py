"""The verdict on robots made for the purpose: what is a fault, and above all what is none."""

from __future__ import annotations

import json
from collections.abc import Sequence
from typing import Any

import pytest

from ros2_mcp.model.qos import Endpoint, QoS
from ros2_mcp.ops.measure.health_check import Expectations, Health, check_health, to_measure
from ros2_mcp.ops.sources.source import GraphSnapshot
from ros2_mcp.robot import TopicEndpoints
from ros2_mcp.robot.seen import Left
from support.made_windows import START_NS, Make, Recorded, Window

SCAN = "sensor_msgs/msg/LaserScan"
IMU = "sensor_msgs/msg/Imu"
ODOMETRY = "nav_msgs/msg/Odometry"
TWIST = "geometry_msgs/msg/Twist"
TF = "tf2_msgs/msg/TFMessage"
DIAGNOSTICS = "diagnostic_msgs/msg/DiagnosticArray"


def endpoint(node: str, type_name: str, **qos: Any) -> Endpoint:
    return Endpoint(node, type_name, "", node, QoS(**qos))


def topic(name: str, publishers: Sequence[Endpoint] = (), subscribers: Sequence[Endpoint] = ()) -> TopicEndpoints:
    return TopicEndpoints(name, publishers, subscribers)


async def check(present: Sequence[TopicEndpoints], windows: Sequence[Window], **expected: Any) -> Health:
    scene = GraphSnapshot(
        {each.topic: each for each in present}, ["/lidar", "/nav"], {"/reset": ["std_srvs/srv/Trigger"]}
    )
    source = Recorded(windows, scene)
    source.is_live = True
    return await check_health(source, Expectations(**expected))


def state_of(found: Health, name: str) -> str:
    rows: dict[str, str] = {row.topic_name: row.state for row in found.topics}
    return rows[name] if name in rows else found.other_topics[name].partition(",")[0]


def at(rate_hz: float, duration_s: float = 3.0) -> list[tuple[float, dict[str, Any]]]:
    return [(0.05 + i / rate_hz, {}) for i in range(int((duration_s - 0.05) * rate_hz) + 1)]


async def test_where_no_robot_is_seen_it_is_critical_and_what_was_there_is_named() -> None:
    absence = "No robot is seen in domain 7. Seen earlier in this session, and gone: nodes /lidar; topics /scan."
    gone = GraphSnapshot({}, [], [], absence=absence, left=Left(["/lidar"], {"/scan": ["/lidar"]}))
    found = await check_health(Recorded([], gone), Expectations())
    assert (found.verdict, [row.subject for row in found.findings]) == ("CRITICAL", ["robot"])
    assert found.findings[0].problem == absence


async def test_what_was_published_in_this_session_and_has_no_publisher_any_more_is_critical() -> None:
    types = {"/imu": "sensor_msgs/msg/Imu", "/scan": "sensor_msgs/msg/LaserScan", "/pose": "nav_msgs/msg/Odometry"}
    left = Left(["/camera", "/lidar"], {"/imu": ["/lidar"], "/scan": ["/lidar"], "/pose": ["/nav"]}, types)
    found = await check_health(Recorded([], GraphSnapshot({}, ["/nav"], [], left=left)), Expectations())
    assert found.verdict == "CRITICAL"
    assert [(row.severity, row.subject, row.problem) for row in found.findings] == [
        ("critical", "/lidar", "/lidar has left: no publisher is left on /imu, /scan."),
        ("critical", "/nav", "/nav is there, but no publisher is left on /pose."),
        ("warning", "/camera", "It was running earlier in this session, and has left."),
    ]


async def test_what_may_have_been_closed_on_purpose_or_is_not_yet_discovered_is_a_warning() -> None:
    types = {"/goal_pose": "geometry_msgs/msg/PoseStamped"}
    closed = GraphSnapshot({}, ["/nav"], [], left=Left(["/rviz"], {"/goal_pose": ["/rviz"]}, types))
    found = await check_health(Recorded([], closed), Expectations())
    assert (found.verdict, [row.subject for row in found.findings]) == ("DEGRADED", ["/rviz"])
    assert (await check_health(Recorded([], closed), Expectations(["/goal_pose"]))).verdict == "CRITICAL"
    absence = "No robot is seen in domain 7 yet: discovery is still under way, ask again."
    early = GraphSnapshot({}, [], [], False, absence=absence)
    assert (await check_health(Recorded([], early), Expectations())).verdict == "DEGRADED"


PASSING = [(1.0, 0, "fine"), (2.0, 2, "no data"), (3.0, 0, "fine")]
LIDAR = topic("/scan", [endpoint("/lidar", SCAN)])


@pytest.mark.parametrize(
    ("rate_hz", "verdict", "state"),
    [(10, "HEALTHY", "OK"), (1.0, "HEALTHY", "OK"), (0.95, "HEALTHY", "OK"), (0.5, "DEGRADED", "SLOW")],
)
async def test_a_sensor_slower_than_expected_degrades(window: Make, rate_hz: float, verdict: str, state: str) -> None:
    found = await check([LIDAR], [window("/scan", SCAN, at(rate_hz), 3.0)])
    assert (found.verdict, state_of(found, "/scan")) == (verdict, state)


async def test_topics_that_are_as_they_should_be_are_told_in_short(window: Make) -> None:
    present = [topic(f"/scan{i}", [endpoint("/lidar", SCAN)]) for i in range(20)]
    windows = [window(one.topic, SCAN, at(9.87654321), 3.0) for one in present]
    found = await check([LIDAR, *present], [*windows, window("/scan", SCAN, [], 3.0)], topics=["/scan3"])
    assert [(row.topic_name, row.state, row.rate_hz) for row in found.topics] == [
        ("/scan", "SILENT", None),
        ("/scan3", "OK", 9.877),
    ]
    assert len(found.other_topics) == 19 and set(found.other_topics.values()) == {"OK, 9.877 Hz"}
    short = len(json.dumps(found.other_topics))
    assert short < 700


async def test_the_topics_that_nav2_has_for_itself_are_one_line_and_a_fault_of_one_is_told(window: Make) -> None:
    own = [f"/{node}/{name}" for node in ("planner_server", "amcl", "bt_navigator") for name in "abcdefghijklmnopqrst"]
    present = [topic(name, [endpoint(name.rpartition("/")[0], "lifecycle_msgs/msg/TransitionEvent")]) for name in own]
    plan = topic("/plan", [endpoint("/planner_server", SCAN)])
    windows = [window("/scan", SCAN, at(10), 3.0), window("/plan", SCAN, [], 3.0)]
    found = await check([LIDAR, plan, *present], windows, topics=["/plan"])
    assert found.other_topics == {"/scan": "OK, 10 Hz", "60 topics that only Nav2 publishes": "60 NOT MEASURED"}
    assert [row.topic_name for row in found.topics] == ["/plan"]
    assert found.publishers_without_subscribers == ["/plan", "/scan"]


async def test_a_sensor_that_comes_in_pairs_has_not_stopped(window: Make) -> None:
    pairs = [(at + shift, {}) for at in range(1, 6) for shift in (0.0, 0.015)]
    found = await check([LIDAR], [window("/scan", SCAN, pairs, 6.9)])
    assert (found.verdict, state_of(found, "/scan")) == ("HEALTHY", "OK")


async def test_a_single_message_tells_how_slow_it_is_at_least(window: Make) -> None:
    found = await check([LIDAR], [window("/scan", SCAN, [(1.0, {})], 3.0)])
    assert (found.verdict, found.topics[0].rate_hz) == ("DEGRADED", None)


async def test_a_sensor_that_stopped_degrades_and_an_expected_one_is_critical(window: Make) -> None:
    stopped = window("/scan", SCAN, at(20, 3.0), 6.0)
    found = await check([LIDAR], [stopped])
    assert (found.verdict, found.topics[0].state) == ("DEGRADED", "STOPPED")
    assert found.findings[0].problem.startswith("It has stopped: no message in the last 3.0 s, from ")
    assert (await check([LIDAR], [stopped], topics=["scan"])).verdict == "CRITICAL"
    assert (await check([LIDAR], [window("/scan", SCAN, at(20, 5.1), 6.0)])).verdict == "HEALTHY"


@pytest.mark.parametrize(
    ("age_s", "verdict", "state"),
    [
        (0.1, "HEALTHY", "OK"),
        (47.0, "DEGRADED", "OLD STAMPS"),
        (-5.0, "DEGRADED", "OLD STAMPS"),
        (1.7e9, "HEALTHY", "OK"),
    ],
)
async def test_a_sensor_with_old_stamps_degrades(window: Make, age_s: float, verdict: str, state: str) -> None:
    stamps = [(time, START_NS + round((time - age_s) * 1e9)) for time, _ in at(10)]
    headers = [(time, {"header": {"stamp": {"sec": ns // 10**9, "nanosec": ns % 10**9}}}) for time, ns in stamps]
    found = await check([LIDAR], [window("/scan", SCAN, headers, 3.0)])
    assert (found.verdict, state_of(found, "/scan")) == (verdict, state)
    if state != "OK":
        assert found.topics[0].age_s == pytest.approx(age_s)
    assert ("47 s old on average" in found.summary()[-1]) == (age_s == 47.0)


async def test_one_young_message_among_old_ones_is_no_fault_of_the_clock(window: Make) -> None:
    times = [(time, START_NS + round((time - (0.0 if i == 3 else 2.0)) * 1e9)) for i, (time, _) in enumerate(at(10))]
    headers = [(time, {"header": {"stamp": {"sec": ns // 10**9, "nanosec": ns % 10**9}}}) for time, ns in times]
    assert (await check([LIDAR], [window("/scan", SCAN, headers, 3.0)])).verdict == "HEALTHY"


async def test_a_sensor_that_was_interrupted_degrades_and_it_is_told_when(window: Make) -> None:
    times = [at / 20 for at in (*range(1, 40), *range(100, 200))]
    found = await check([LIDAR], [window("/scan", SCAN, [(at, {}) for at in times], 10.0)])
    assert (found.verdict, found.topics[0].state) == ("DEGRADED", "INTERRUPTED")
    assert found.findings[0].problem.startswith("It was interrupted: no message for 3.0 s from ")


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
    source.is_live, source.began_ns = False, START_NS - 60 * 10**9
    found = await check_health(source, Expectations())
    assert (found.verdict, found.diagnostics[0].level) == ("DEGRADED", "OK")
    problem = found.findings[0].problem
    assert "reported ERROR at 2023-11-14T22:13:22.000000Z (62 s in)" in problem and "no data" in problem


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
    windows = [window(quiet.topic, quiet.types[0], [], 3.0), window("/front", SCAN, at(10), 3.0)]
    found = await check([quiet, topic("/front", [endpoint("/lidar", SCAN)])], windows)
    assert (found.verdict, found.findings) == ("HEALTHY", [])


@pytest.mark.parametrize("check_rates", [True, False])
async def test_where_nothing_was_measured_nothing_is_called_healthy(window: Make, check_rates: bool) -> None:
    chatter = topic("/chatter", [endpoint("/talker", "std_msgs/msg/String")])
    found = await check([chatter], [window("/chatter", "std_msgs/msg/String", [], 3.0)], check_rates=check_rates)
    assert (found.verdict, [row.subject for row in found.findings]) == ("DEGRADED", ["robot"])
    assert found.findings[0].problem.startswith("Nothing was measured")


async def test_a_topic_that_ran_in_this_session_and_is_silent_is_silent_but_not_what_runs_for_a_while(
    window: Make,
) -> None:
    pressure = topic("/pressure", [endpoint("/pump", "sensor_msgs/msg/FluidPressure")])
    orders = topic("/cmd_vel", [endpoint("/teleop", TWIST)])
    windows = [window(one.topic, one.types[0], [], 3.0) for one in (pressure, orders)]
    windows.append(window("/scan", SCAN, at(10), 3.0))
    graph = GraphSnapshot({one.topic: one for one in (pressure, orders, LIDAR)}, [], {})
    assert (await check_health(Recorded(windows, graph), Expectations())).verdict == "HEALTHY"
    graph = GraphSnapshot(graph.topics, [], {}, ran=("/pressure", "/cmd_vel", "/scan"))
    found = await check_health(Recorded(windows, graph), Expectations())
    assert [(row.subject, row.problem) for row in found.findings] == [
        ("/pressure", "/pump publishes it, but no message came.")
    ]


@pytest.mark.parametrize("seconds", [1.0, 3.0])
@pytest.mark.parametrize("kind", ["nav_msgs/msg/Odometry", "sensor_msgs/msg/JointState", TF, DIAGNOSTICS])
async def test_what_is_published_steadily_is_silent_in_any_session_whatever_its_qos(
    window: Make, kind: str, seconds: float
) -> None:
    is_slow = kind in (TF, DIAGNOSTICS)  # of once a second nothing can be said after one
    qos = {} if is_slow else {"durability": "transient_local"}
    present = [topic("/told", [endpoint("/base", kind, **qos)]), LIDAR]
    windows = [window("/told", kind, [], seconds), window("/scan", SCAN, at(10, seconds), seconds)]
    found = await check(present, windows)
    assert (found.verdict, state_of(found, "/told")) == (
        ("HEALTHY", "QUIET") if is_slow and seconds < 3 else ("DEGRADED", "SILENT")
    )


async def test_a_stream_of_which_only_a_message_from_before_came_is_silent_and_its_age_is_told(window: Make) -> None:
    qos = {"durability": "transient_local"}
    odometry = topic("/odom", [endpoint("/base", ODOMETRY, **qos)])
    grid = topic("/map", [endpoint("/maps", "nav_msgs/msg/OccupancyGrid", **qos)])
    windows = [
        window("/odom", ODOMETRY, [(-5.0, {})], 3.0),
        window("/map", grid.types[0], [(-60.0, {})], 3.0),
        window("/scan", SCAN, at(10), 3.0),
    ]
    found = await check([odometry, grid, LIDAR], windows)
    assert [row.problem for row in found.findings] == [
        "/base publishes it, but nothing new came: 1 message, 8 s old, from before."
    ]
    assert found.other_topics["/map"] == "OK, 1 message, 63 s old, from before"


async def test_the_first_in_a_chain_is_named(window: Make) -> None:
    """The joint states wait for a description that nobody publishes; odometry waits for the joint states."""
    latched = {"durability": "transient_local"}
    joints = "sensor_msgs/msg/JointState"
    present = [
        topic("/robot_description", (), [endpoint("/joints", "std_msgs/msg/String", **latched)]),
        topic("/joint_states", [endpoint("/joints", joints)], [endpoint("/base", joints)]),
        topic("/odom", [endpoint("/base", ODOMETRY)]),
        LIDAR,
    ]
    windows = [window("/joint_states", joints, [], 3.0), window("/odom", ODOMETRY, [], 3.0)]
    found = await check(present, [*windows, window("/scan", SCAN, at(10), 3.0)])
    [finding] = found.findings
    assert (finding.subject, finding.recommendation) == (
        "/robot_description",
        "Start the node that publishes /robot_description.",
    )
    assert "/joints subscribes to /robot_description, which has no publisher" in finding.problem
    assert "/odom" in finding.problem and "/joint_states" in finding.problem


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


async def test_what_is_expected_is_listed_whether_it_is_there_or_not(window: Make) -> None:
    expected = {"topics": ["/scan"], "services": ["/rest", "/reset"], "nodes": ["/nav", "/odd"]}
    found = await check([LIDAR], [window("/scan", SCAN, at(10), 3.0)], **expected)
    assert [row.topic_name for row in found.topics] == ["/scan"]
    assert found.services == {"/rest": "MISSING", "/reset": "OK"} and found.nodes == {"/nav": "OK", "/odd": "MISSING"}
    recorded = GraphSnapshot({"/scan": LIDAR}, None, None)
    found = await check_health(Recorded([window("/scan", SCAN, at(10), 3.0)], recorded), Expectations(**expected))
    assert set(found.services.values()) == set(found.nodes.values()) == {"UNKNOWN"}


@pytest.mark.parametrize("is_expected", [False, True])
async def test_odometry_that_is_not_a_number_is_a_fault_with_its_fields_and_time(
    window: Make, is_expected: bool
) -> None:
    bad = {"pose": {"pose": {"position": {"x": float("nan")}}}, "twist": {"covariance": [float("inf")] * 36}}
    messages = [(time, bad if 1.0 < time < 1.3 else {}) for time, _ in at(10)]
    odometry = topic("/odom", [endpoint("/base", ODOMETRY)])
    found = await check([odometry], [window("/odom", ODOMETRY, messages, 3.0)], topics=["/odom"] if is_expected else [])
    [finding] = found.findings
    assert (found.verdict, state_of(found, "/odom")) == ("CRITICAL" if is_expected else "DEGRADED", "NOT FINITE")
    told = "3 of 30 messages have NaN or infinite values, in pose.pose, twist.covariance, first at 1.050 s (2023"
    assert finding.problem.startswith(told) and finding.subject == "/odom"


@pytest.mark.parametrize(
    ("message", "verdict"),
    [
        ({"orientation": {"x": float("nan")}}, "DEGRADED"),
        ({"angular_velocity": {"z": float("-inf")}}, "DEGRADED"),
        ({"orientation": {"x": float("nan")}, "orientation_covariance": [-1.0] + [0.0] * 8}, "HEALTHY"),
        ({"header": {"frame_id": "a frame"}}, "HEALTHY"),
    ],
)
async def test_an_imu_may_send_anything_where_it_says_that_it_does_not_know(
    window: Make, message: dict[str, Any], verdict: str
) -> None:
    imu = topic("/imu", [endpoint("/base", IMU)])
    found = await check([imu], [window("/imu", IMU, [(time, message) for time, _ in at(10)], 3.0)])
    assert found.verdict == verdict


async def test_what_has_one_cause_is_one_finding_of_that_node(window: Make) -> None:
    status = {"status": [{"name": "lidar: status", "level": 2, "message": "no data"}]}
    present = [LIDAR, topic("/diagnostics", [endpoint("/watch", DIAGNOSTICS)])]
    windows = [window("/scan", SCAN, [], 3.0), window("/diagnostics", DIAGNOSTICS, [(1.0, status)], 3.0)]
    found = await check(present, windows)
    [finding] = found.findings
    assert (finding.severity, finding.subject, found.counts["findings"]) == ("critical", "/lidar", 1)
    assert finding.problem == (
        "«lidar: status»: Diagnostics report ERROR: «no data». /scan: /lidar publishes it, but no message came."
    )


async def test_a_node_that_left_is_one_finding_with_what_is_missing_without_it(window: Make) -> None:
    left = Left(["/lidar"], {"/scan": ["/lidar"]}, {"/scan": SCAN})
    waits = topic("/scan", (), [endpoint("/nav", SCAN)])
    gone = GraphSnapshot({"/scan": waits}, ["/nav"], [], left=left)
    found = await check_health(Recorded([], gone), Expectations(topics=["/scan"], nodes=["/lidar", "/other"]))
    assert [finding.subject for finding in found.findings] == ["/lidar", "/other"]
    problem = found.findings[0].problem
    assert problem.startswith("/lidar has left: no publisher is left on /scan. /scan: The expected topic has no")
    assert "The expected node is missing." in problem and "/nav subscribes to it" in problem


class Hanging(Recorded):
    """A robot of which no node answers."""

    async def hung(self, nodes: Sequence[str]) -> Sequence[str]:
        return nodes


async def test_whether_nodes_answer_is_asked_also_where_no_rates_are_checked(window: Make) -> None:
    source = Hanging([window("/scan", SCAN, at(10), 3.0)], GraphSnapshot({"/scan": LIDAR}, ["/lidar"], []))
    source.is_live = True
    found = await check_health(source, Expectations(check_rates=False))
    assert (found.verdict, found.findings[0].problem) == ("CRITICAL", "None of /lidar answers.")
    assert (await check_health(source, Expectations())).verdict == "HEALTHY"


async def test_a_burst_is_no_rate_and_slow(window: Make) -> None:
    found = await check([LIDAR], [window("/scan", SCAN, [(1.0, {}), (1.00002, {})], 3.0)])
    assert (state_of(found, "/scan"), found.topics[0].rate_hz) == ("SLOW", None)
    assert "too few messages came to measure its rate" in found.findings[0].problem


async def test_a_mismatch_of_qos_degrades(window: Make) -> None:
    pair = topic("/scan", [endpoint("/lidar", SCAN, reliability="best_effort")], [endpoint("/nav", SCAN)])
    found = await check([pair], [window("/scan", SCAN, at(10), 3.0)])
    assert found.verdict == "DEGRADED"
    assert found.findings[0].problem.startswith("/lidar → /nav: the publisher offers best_effort")


async def test_a_node_that_waits_for_a_sensor_that_nobody_publishes_degrades(window: Make) -> None:
    found = await check([topic("/scan", (), [endpoint("/nav", SCAN)])], [window("/x", SCAN, [], 3.0)])
    assert (found.verdict, found.findings[0].problem) == ("DEGRADED", "/nav subscribes to it, but it has no publisher.")
    assert found.subscribers_without_publishers == ["/scan"]


@pytest.mark.promise("ros2_health_check", "duplicate nodes")
async def test_several_types_on_one_topic_degrade_and_are_critical_where_it_is_expected() -> None:
    rivals = [endpoint("/base", "nav_msgs/msg/Odometry"), endpoint("/odd", "std_msgs/msg/String")]
    graph = GraphSnapshot({"/odom": TopicEndpoints("/odom", rivals, ())}, ["/base", "/odd"], [])
    found = await check_health(Recorded([], graph), Expectations())
    told = "Several types on one topic: /base publishes nav_msgs/msg/Odometry; /odd publishes std_msgs/msg/String."
    assert (found.verdict, [row.problem for row in found.findings]) == ("DEGRADED", [told])
    assert (await check_health(Recorded([], graph), Expectations(["/odom"]))).verdict == "CRITICAL"


async def test_an_empty_recording_is_not_called_healthy() -> None:
    found = await check_health(Recorded([], GraphSnapshot({}, None, None)), Expectations())
    assert (found.verdict, found.findings[0].subject) == ("DEGRADED", "made")
    assert "nothing can be judged" in found.findings[0].problem


async def test_two_nodes_of_one_name_degrade() -> None:
    found = await check_health(Recorded([], GraphSnapshot({}, ["/nav", "/nav"], [])), Expectations())
    assert (found.verdict, found.findings[0].problem) == ("DEGRADED", "2 nodes have this name.")


async def test_a_second_robot_of_the_same_names_is_one_finding() -> None:
    found = await check_health(Recorded([], GraphSnapshot({}, ["/nav", "/lidar", "/map"] * 2, [])), Expectations())
    [finding] = found.findings
    assert finding.problem == "3 names are shared by several nodes each: /nav, /lidar, /map."


@pytest.mark.promise("ros2_health_check", "diagnostics")
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
    assert (found.verdict, found.note) == ("HEALTHY", "A recording does not say which nodes and services ran.")


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
    assert len(found.findings) == 40 and len({*(row.topic_name for row in found.topics), *found.other_topics}) == 60


async def test_an_expected_latched_topic_needs_its_one_message_and_no_rate(window: Make) -> None:
    grid = "nav_msgs/msg/OccupancyGrid"
    latched = topic("/map", [endpoint("/maps", grid, durability="transient_local")])
    assert (await check([latched], [window("/map", grid, [(-60.0, {})], 3.0)], topics=["/map"])).verdict == "HEALTHY"
    assert (await check([latched], [window("/map", grid, [], 3.0)], topics=["/map"])).verdict == "CRITICAL"
