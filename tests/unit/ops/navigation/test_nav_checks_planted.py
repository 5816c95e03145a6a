"""The checks of navigation on evidence as planted causes left it: what is named, and what only follows from it."""

from __future__ import annotations

import math
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np

from ros2_mcp.ops.navigation.check import judged
from ros2_mcp.ops.navigation.checks import nav_findings_in
from ros2_mcp.ops.navigation.evidence import Grids, Heard, NavEvidence, States
from ros2_mcp.ops.sources.source import GraphSnapshot
from ros2_mcp.ops.space.tellers import Publishers, Tellers
from ros2_mcp.robot.seen import Left
from support.made_navigation import (
    ACTIVE,
    CHAIN,
    GRID,
    MANAGER,
    NOW_NS,
    ODOMETRY,
    ODOMS,
    POSE,
    READ,
    SCAN,
    SCANS,
    SERVERS,
    TWIST,
    WELL,
    both,
    found,
    frames,
    grid,
    heard,
    line,
    made,
    odometry,
    parts_of,
    room,
    scan,
    topic,
    twist,
)

from .test_verdict import whole

SLOW = {
    **heard("/scan", SCAN, ["/lidar"], [scan([2.0] * 60)] * 2, frame_id="laser"),
    **heard("/wheel/odom", ODOMETRY, ["/base"], [odometry()] * 4, frame_id="odom"),
    **heard("/odom", ODOMETRY, ["/ekf"]),
}


def test_servers_that_all_do_not_answer_beside_slow_series_are_one_finding_and_no_server_hangs() -> None:
    evidence = whole(states=States(dict.fromkeys(SERVERS, ""), {}), heard=SLOW)
    (finding,) = nav_findings_in(evidence)
    assert (finding.subject, finding.rank) == ("load", "makes it worse")
    assert "3 of 3 services did not answer" in finding.proof and "/scan (1 Hz)" in finding.proof
    assert judged(evidence).verdict == "NOT KNOWN"


def test_series_that_are_all_slow_where_services_are_late_say_nothing_of_the_one_that_is_silent() -> None:
    states = States(dict.fromkeys(SERVERS, "active"), dict.fromkeys(SERVERS, 0.6))
    topics = {**whole().graph.topics, "/odom": replace(READ[1], subscribers=whole().graph.topics["/odom"].subscribers)}
    evidence = whole(states=states, heard=SLOW)
    evidence = replace(evidence, graph=replace(evidence.graph, topics=topics))
    assert [one.subject for one in nav_findings_in(evidence)] == ["load"]
    quick = replace(evidence, states=States(dict.fromkeys(SERVERS, "active"), dict.fromkeys(SERVERS, 0.01)))
    assert [one.subject for one in nav_findings_in(quick)] == ["/odom"]


def test_servers_that_hang_while_all_else_comes_as_ever_are_no_load() -> None:
    evidence = whole(states=States(dict.fromkeys(SERVERS, ""), {}))
    assert all(one.subject != "load" and one.rank == "stops everything" for one in nav_findings_in(evidence))


def test_a_transform_that_takes_its_stamp_from_a_late_scan_is_told_as_following_from_it() -> None:
    ages = [1.8, 1.81, 1.82] * 4
    late = heard("/scan", SCAN, ["/lidar"], [scan([2.0] * 60)] * 5, frame_id="laser", count=12, ages_s=ages)
    fine = heard("/odom", ODOMETRY, ["/base"], [odometry()] * 20, frame_id="odom", ages_s=[0.01] * 12)
    tree = frames(("map", "odom", 0.1), ("odom", "base_link", 0.05), static=[("base_link", "laser")], ahead_s=-0.8)
    (finding,) = found(*READ, **parts_of(tree, {**late, **fine}))
    assert finding.subject == "/scan" and "1.80 s behind" in finding.cause and "map" not in finding.cause
    assert "«map → odom» (+0.80 s) follows from it" in finding.proof


def seen_of(ranges: list[float]) -> str:
    rows = heard("/scan", SCAN, ["/lidar"], [scan(ranges)] * 5, frame_id="laser")
    outline = {"local_costmap/local_costmap": {"robot_radius": 0.2}}
    (finding,) = found(*READ, **parts_of(WELL, {**rows, **ODOMS}, **outline))
    return finding.cause


def test_a_sector_over_the_back_is_one_and_two_sectors_are_two() -> None:
    back = [2.0] * 360
    for beam in (*range(351, 360), *range(4)):
        back[beam] = 0.12
    assert "13 beams at 171 to -177° of /scan" in seen_of(back)
    two = [2.0] * 360
    for beam in (*range(80, 86), *range(270, 276)):
        two[beam] = 0.12
    assert "12 beams at -100 to -95°, 90 to 95° of /scan" in seen_of(two)


THE_MAP = topic("/map", GRID, ["/map_server"], ["/amcl"], durability="transient_local")


def test_a_switch_that_is_off_is_named_in_the_cause_and_only_that_of_the_node_that_told_the_transform() -> None:
    late = frames(("map", "odom", 0.1), ("odom", "base_link", 14.0), static=[("base_link", "laser")])
    switches = {"ekf_filter_node": {"publish_tf": False}, "base": {"enable_odom_tf": False}}
    owned = replace(late, tellers=Tellers(late.tree, {"/tf": Publishers(["/ekf_filter_node"])}, {}))
    comes = {**ODOMS, **heard("/scan", SCAN, ["/lidar"], [scan([2.0] * 60)] * 5, frame_id="laser")}
    (finding,) = found(*READ, **parts_of(owned, comes, **switches))
    assert finding.cause.endswith("from odom to the base: publish_tf of /ekf_filter_node is false.")
    unread = found(*READ, nodes=["/ekf_filter_node"], **parts_of(owned, comes, base={"enable_odom_tf": False}))
    assert "/ekf_filter_node publishes it" in unread[0].cause and "parameters, such as publish_tf" in unread[0].proof
    never = found(*READ, **parts_of(frames(static=[("base_link", "laser")]), comes, **switches))
    assert any(one.cause.endswith("to the base: enable_odom_tf of /base is false.") for one in never)


def test_amcl_that_was_started_again_waits_where_its_own_setting_says_so() -> None:
    comes = {**ODOMS, **heard("/scan", SCAN, ["/lidar"], [scan([2.0] * 60)] * 5, frame_id="laser")}
    late = frames(("map", "odom", 19.0), ("odom", "base_link", 0.05), static=[("base_link", "laser")], ahead_s=1.0)
    rows: dict[str, Any] = {"states": {}, "log": ()}
    waits = found(*READ, THE_MAP, **rows, **parts_of(late, comes, amcl={"set_initial_pose": False}))
    assert [one.subject for one in waits] == ["map → odom"] and "waits for /initialpose" in waits[0].cause
    other = found(*READ, THE_MAP, **rows, **parts_of(late, comes, amcl={"set_initial_pose": True}))
    assert "is not told any more" in other[0].cause


def test_settings_that_goals_cannot_meet_are_told_though_nothing_else_was_read() -> None:
    short = found(parameters={"/bt_navigator": {"default_server_timeout": 1}})
    assert [(one.rank, one.subject) for one in short] == [("makes it worse", "/bt_navigator")]
    hurried = {
        "progress_checker.required_movement_radius": 0.5,
        "progress_checker.movement_time_allowance": 3.0,
        "FollowPath.desired_linear_vel": 0.1,
    }
    assert "progress checker asks for more" in found(parameters={"/controller_server": hurried})[0].cause


def test_a_scan_in_which_no_beam_ends_is_told_and_one_beam_is_enough() -> None:
    blind = [math.inf] * 359 + [math.nan]
    rows = heard("/scan", SCAN, ["/lidar"], [scan(blind)] * 5, frame_id="laser")
    (finding,) = found(*READ, **parts_of(WELL, {**rows, **ODOMS}))
    assert finding.rank == "makes it worse" and "0 of 360 beams of /scan" in finding.cause
    once = heard("/scan", SCAN, ["/lidar"], [*[scan(blind)] * 4, scan([2.0, *blind[1:]])], frame_id="laser")
    assert found(*READ, **parts_of(WELL, {**once, **ODOMS})) == []


def test_different_maps_on_one_topic_are_told_and_not_that_localisation_is_lost() -> None:
    wrong = heard("/scan", SCAN, ["/lidar"], [scan([1.2] * 120)] * 5, frame_id="laser")
    empty = grid(np.zeros((40, 40), np.int8))
    two = topic("/map", GRID, ["/map_server", "/map_server_2"], ["/amcl"], durability="transient_local")
    grids = Grids(map=empty, map_topic="/map", maps=[room(), empty])
    (finding,) = found(*READ, two, grids=grids, **parts_of(WELL, {**wrong, **ODOMS}))
    assert finding.subject == "/map" and "/map_server, /map_server_2" in finding.cause
    assert "40 x 40 cells" in finding.proof
    alike = Grids(map=room(), map_topic="/map", maps=[room()])
    (lost,) = found(*READ, two, grids=alike, **parts_of(WELL, {**wrong, **ODOMS}))
    assert lost.subject == "localisation"


def test_a_static_transform_whose_publisher_has_gone_is_said_as_such_below_a_server_that_is_down() -> None:
    tree = frames(
        ("map", "odom", 0.1), ("odom", "base_link", 0.05), static=[("base_link", "laser"), ("odom", "base_link")],
        ahead_s=1.0,
    )  # fmt: skip
    tree.tree.edges["base_link"].is_left = True
    states = {**ACTIVE, "/planner_server": "inactive"}
    server, left = nav_findings_in(whole(frames=tree, states=states))
    assert server.subject == "/planner_server"
    assert left.rank == "makes it worse" and "was told as static by a node that has gone" in left.cause
    mount = frames(("map", "odom", 0.1), ("odom", "base_link", 0.05), static=[("base_link", "laser")], ahead_s=1.0)
    mount.tree.edges["laser"].is_left = True
    server, left = nav_findings_in(whole(frames=mount, states=states))
    assert (server.subject, left.subject) == ("/planner_server", "base_link → laser")
    assert left.rank == "makes it worse" and "by a node that has gone" in left.cause


def test_a_scan_that_fits_the_map_only_if_it_is_turned_is_a_heading_or_a_lidar_that_is_turned() -> None:
    cells = np.zeros((40, 80), np.int8)
    cells[0], cells[-1], cells[:, 0], cells[:, -1] = 100, 100, 100, 100
    angles = [-math.pi + number * 2 * math.pi / 120 for number in range(120)]
    ranges = [min(3.9 / (abs(math.cos(one)) + 1e-9), 1.95 / (abs(math.sin(one)) + 1e-9)) for one in angles]

    def cause(turned: int) -> list[str]:
        rows = heard("/scan", SCAN, ["/lidar"], [scan(ranges[turned:] + ranges[:turned])] * 5, frame_id="laser")
        grids = Grids(map=grid(cells, corner=(-4.0, -2.0)), map_topic="/map")
        return [one.cause for one in found(*READ, THE_MAP, grids=grids, **parts_of(WELL, {**rows, **ODOMS}))]

    assert cause(0) == []
    (turned,) = cause(30)
    assert "only if it is turned by 90°" in turned or "only if it is turned by -90°" in turned


def test_a_costmap_that_takes_its_map_from_another_topic_is_told_where_the_map_is() -> None:
    takes = {"/global_costmap/global_costmap": {"static_layer.map_topic": "/office/map_v2"}}
    wanted = topic("/office/map_v2", GRID, [], ["/global_costmap/global_costmap"])
    (finding,) = found(THE_MAP, wanted, parameters=takes)
    assert "takes its map from /office/map_v2, which has no publisher; the map is on /map" in finding.cause
    assert (finding.rank, finding.remedy) == ("stops everything", "Set its map_topic to /map, or remap it.")
    (alone,) = found(wanted, parameters=takes)
    assert "waits for /office/map_v2, which has no publisher" in alone.cause


def test_odometry_that_comes_late_while_its_transform_with_the_same_stamp_is_in_time_is_no_clock() -> None:
    tree = frames(("map", "odom", 0.1), ("odom", "base_link", 0.05), static=[("base_link", "laser")], ahead_s=1.0)
    stamp_ns = tree.tree.edges["base_link"].moving[-1].stamp_ns

    def odometry_of(at_ns: int) -> Any:
        message = odometry()
        message.header = SimpleNamespace(
            stamp=SimpleNamespace(sec=at_ns // 1_000_000_000, nanosec=at_ns % 1_000_000_000), frame_id="odom"
        )
        return message

    def causes(at_ns: int) -> list[str]:
        ages = [1.4, 1.41, 1.42] * 4
        late = heard("/odom", ODOMETRY, ["/base"], [odometry_of(at_ns)] * 20, frame_id="odom", ages_s=ages)
        comes = heard("/scan", SCAN, ["/lidar"], [scan([2.0] * 60)] * 5, frame_id="laser", ages_s=[0.02] * 12)
        return [one.cause for one in found(*READ, **parts_of(tree, {**late, **comes}))]

    assert causes(stamp_ns) == []
    assert "The stamps of /odom are 1.40 s behind" in causes(stamp_ns - 1_450_000_000)[0]


def test_amcl_without_a_transform_is_a_cause_whether_its_last_pose_is_old_or_new() -> None:
    comes = {**ODOMS, **heard("/scan", SCAN, ["/lidar"], [scan([2.0] * 60)] * 5, frame_id="laser")}
    lost = frames(("odom", "base_link", 0.05), static=[("base_link", "laser")])
    rows: dict[str, Any] = {"states": {}, "log": ()}

    def cause(poses: dict[str, Heard], **amcl: Any) -> str:
        return found(*READ, THE_MAP, **rows, **parts_of(lost, {**comes, **poses}, amcl=amcl))[0].cause

    before = heard("/amcl_pose", POSE, ["/amcl"], kept=[SimpleNamespace()])
    assert "does not know where the robot is: it waits" in cause(before, set_initial_pose=False)
    assert "does not localise the robot now" in cause(before, set_initial_pose=True)
    now = heard("/amcl_pose", POSE, ["/amcl"], [SimpleNamespace(pose=SimpleNamespace(covariance=[0.04] * 36))] * 5)
    assert "publishes the robot's pose, but not the transform map → odom" in cause(now, tf_broadcast=False)


def test_a_source_that_comes_more_seldom_than_the_monitor_waits_is_told() -> None:
    monitor = {"observation_sources": ["scan"], "scan.topic": "/scan", "source_timeout": 2.0}

    def causes(gap_s: float) -> list[str]:
        slow = heard("/scan", SCAN, ["/lidar"], [scan([2.0] * 60)] * 2, frame_id="laser", longest_gap_s=gap_s)
        rows = parts_of(WELL, {**slow, **ODOMS}, collision_monitor=monitor)
        return [one.cause for one in found(*READ, nodes=["/collision_monitor"], **rows)]

    told = ["/collision_monitor stops the robot again and again: its source scan comes too seldom."]
    assert causes(1.9) == []
    assert causes(3.4) == told
    remapped = topic("/filtered", SCAN, ["/filter"], ["/collision_monitor"])
    slow = heard("/filtered", SCAN, ["/filter"], [scan([2.0] * 60)] * 2, frame_id="laser", longest_gap_s=3.4)
    rows = parts_of(WELL, {**SCANS, **slow, **ODOMS}, collision_monitor=monitor)
    assert [one.cause for one in found(*READ, remapped, nodes=["/collision_monitor"], **rows)] == told


def test_a_base_with_two_parents_is_not_also_one_without_odometry() -> None:
    two = frames(("map", "odom", 0.05), ("odom", "base_link", 0.05), ("base_footprint", "base_link", 0.05))
    rows = parts_of(two, ODOMS)
    subjects = [one.cause for one in found(*READ, **rows)]
    assert len(subjects) == 1 and "has two parents" in subjects[0]


def test_a_scan_in_an_unknown_frame_is_told_the_frame_of_the_sensor_and_never_that_of_the_base() -> None:
    lidar = frames(("map", "odom", 0.05), ("odom", "base_link", 0.05), static=[("base_link", "laser")])
    named = heard("/scan", SCAN, ["/lidar"], [scan([2.0] * 60, "base_scan")] * 5, frame_id="base_scan")
    (finding,) = found(*READ, **parts_of(lidar, {**named, **ODOMS}))
    assert finding.remedy == "Set the driver's frame_id to laser."


def test_zeros_of_another_node_explain_that_the_robot_stands_and_no_base_is_blamed() -> None:
    drives = heard("/cmd_vel_smoothed", TWIST, ["/velocity_smoother"], [twist(0.3)] * 20)
    both_send = heard("/cmd_vel", TWIST, ["/collision_monitor", "/joystick"], [*[twist(0.3)] * 10, *[twist()] * 30])
    rows_of = [
        (at, message, 1 if number < 10 else 2) for number, (at, message, _) in enumerate(both_send["/cmd_vel"].messages)
    ]
    zeros = {"/cmd_vel": replace(both_send["/cmd_vel"], messages=rows_of)}
    stands = heard("/odom", ODOMETRY, ["/base"], [odometry()] * 20)
    rival = both("/cmd_vel", topic(*CHAIN[2]), topic("/cmd_vel", TWIST, ["/joystick"], []))
    rows: dict[str, Any] = {"parameters": {}, "diagnostics": ()}
    causes = [one.cause for one in found(*made(*CHAIN[:2]), rival, heard={**drives, **zeros, **stands}, **rows)]
    assert causes == ["/joystick sends zeros on /cmd_vel over Nav2's commands."]


def test_a_node_on_another_time_explains_that_its_scan_is_old() -> None:
    old = heard("/scan", SCAN, ["/lidar"], [scan([2.0] * 60)] * 9, frame_id="laser", ages_s=[1.7e9] * 9)
    monitor = {"observation_sources": ["scan"], "scan.topic": "/scan", "use_sim_time": False}
    link = topic("/scan", SCAN, ["/lidar"], ["/collision_monitor"])
    clock = topic("/clock", "rosgraph_msgs/msg/Clock", ["/player"], ["/lidar"])
    nodes = {"lidar": {"use_sim_time": True}, "amcl": {"use_sim_time": False}, "collision_monitor": monitor}
    causes = [one.cause for one in found(link, clock, **parts_of(WELL, {**old, **ODOMS}, **nodes))]
    assert causes == ["/lidar runs on simulated time, the others do not."]


def test_a_planner_that_fails_again_and_again_is_told_though_the_costmap_looks_free() -> None:
    def causes(*ages_s: float) -> list[str]:
        text = 'GridBased plugin failed to plan from (0.79, 0.77) to (6.40, 1.20): "Failed to create plan"'
        lines = [line("/planner_server", text, "WARN", age_s=age_s) for age_s in ages_s]
        return [one.cause for one in found(nodes=SERVERS, log=lines)]

    assert causes(50, 30) == causes(300, 200, 10) == []
    assert causes(50, 30, 10) == ["/planner_server finds no path to (6.40, 1.20), again and again."]


def test_what_nav2_publishes_with_the_stamp_of_a_silent_scan_is_no_clock() -> None:
    points = "sensor_msgs/msg/PointCloud2"
    old = heard("/local_costmap/clearing_endpoints", points, ["/local_costmap/local_costmap"], ages_s=[3.9] * 20)
    causes = [one.cause for one in found(*READ, **parts_of(WELL, {**SCANS, **ODOMS, **old}))]
    assert causes == []


def test_a_server_that_is_only_unseen_is_not_called_dead_and_its_costmap_is_no_finding_of_its_own() -> None:
    active = dict.fromkeys((*SERVERS[1:], "/global_costmap/global_costmap"), "active")
    left = Left(nodes=["/controller_server", "/local_costmap/local_costmap"])
    names = {MANAGER: {"node_names": [name.strip("/") for name in SERVERS]}}
    graph = GraphSnapshot({}, [*SERVERS[1:], MANAGER, "/global_costmap/global_costmap"], {}, left=left)
    findings = nav_findings_in(NavEvidence(graph=graph, now_ns=NOW_NS, states=active, parameters=names, log=()))
    assert [one.cause for one in findings] == [
        "/controller_server has left the graph: it died, or is not seen any more."
    ]
