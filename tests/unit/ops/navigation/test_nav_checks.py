"""Each check of navigation on evidence made for it: what is a cause, and what looks like one and is none."""

from __future__ import annotations

import math
from collections.abc import Mapping
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from ros2_mcp.ops.measure.diagnostics import Diagnostic
from ros2_mcp.ops.navigation.checks import CHECKS, nav_findings_in
from ros2_mcp.ops.navigation.evidence import Goal, Grids, Heard, NavEvidence, NavFinding, States
from ros2_mcp.ops.sources.source import GraphSnapshot
from ros2_mcp.world.map_fit import share_that_fits
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
    STAMPED,
    TWIST,
    WELL,
    both,
    found,
    frames,
    grid,
    heard,
    in_room,
    line,
    made,
    managed,
    odometry,
    parts_of,
    room,
    scan,
    told,
    topic,
    twist,
)

MONITOR = "nav2_msgs/msg/CollisionMonitorState"


def test_there_are_checks_and_a_robot_without_nav2_has_no_findings() -> None:
    assert len(CHECKS) >= 14
    assert nav_findings_in(NavEvidence(graph=GraphSnapshot({}, ["/arm"]))) == []


# ── the command chain ────────────────────────────────────────────────────────────────────────────────────────────


def test_a_chain_that_reaches_the_base_is_fine_with_docking_as_a_second_publisher_and_a_recorder() -> None:
    recorder = topic("/cmd_vel_unused", TWIST, ["/docking_server"], ["/rosbag2_recorder"])
    assert found(*made(*CHAIN), recorder) == []


def test_two_types_on_one_topic_never_meet() -> None:
    base = both(
        "/cmd_vel", topic("/cmd_vel", TWIST, ["/collision_monitor"], []), topic("/cmd_vel", STAMPED, [], ["/base"])
    )
    (finding,) = found(*made(*CHAIN[:2]), base, topic(*CHAIN[3]))
    assert "/collision_monitor sends Twist, and /base listens for TwistStamped" in finding.cause
    assert (finding.rank, finding.subject) == ("stops everything", "/cmd_vel")


def test_an_output_that_nobody_reads_is_named_with_where_the_base_listens_though_a_recorder_hears_it() -> None:
    ends = topic("/cmd_vel_out", TWIST, ["/collision_monitor"], ["/rosbag2_recorder"])
    (finding,) = found(*made(*CHAIN[:2]), ends, topic("/cmd_vel", TWIST, [], ["/base"]), topic(*CHAIN[3]))
    assert (
        "/cmd_vel_out, which no node subscribes to; /base listens on /cmd_vel, where no node publishes" in finding.cause
    )


def test_a_multiplexer_that_lacks_the_input_is_named() -> None:
    mux = topic("/mux/navigation", TWIST, [], ["/twist_mux"])
    out = topic("/base/cmd_vel", TWIST, ["/twist_mux"], ["/base"])
    (finding,) = found(
        *made(*CHAIN[:2]), topic("/cmd_vel", TWIST, ["/collision_monitor"], []), mux, out, topic(*CHAIN[3])
    )
    assert "/cmd_vel, which no node subscribes to; /twist_mux listens on /mux/navigation" in finding.cause


def test_who_sends_beside_nav2_is_a_cause_and_who_only_may_is_none() -> None:
    parts: dict[str, Any] = {"parameters": {}, "diagnostics": ()}
    rival = both("/cmd_vel", topic(*CHAIN[2]), topic("/cmd_vel", TWIST, ["/teleop"], []))
    rows = [*made(*CHAIN[:2]), rival, topic(*CHAIN[3])]
    silent = heard("/cmd_vel", TWIST, ["/collision_monitor", "/teleop"])
    assert found(*rows, heard=silent, **parts) == []
    sends = heard("/cmd_vel", TWIST, ["/collision_monitor", "/teleop"], [twist()] * 40)
    (finding,) = found(*rows, heard=sends, **parts)
    assert "/teleop sends zeros on /cmd_vel over Nav2's commands" in finding.cause and "20 Hz" in finding.proof


def test_commanded_and_not_moving_is_told_with_the_link_at_which_the_command_ends() -> None:
    parts: dict[str, Any] = {"parameters": {}, "diagnostics": ()}
    drives = heard("/cmd_vel", TWIST, ["/collision_monitor"], [twist(0.3)] * 20)
    stands = heard("/odom", ODOMETRY, ["/base"], [odometry()] * 20)
    (finding,) = found(*made(*CHAIN), heard={**drives, **stands}, **parts)
    assert "/base gets the commands and does not move" in finding.cause and "0.30 m/s" in finding.proof
    moves = heard("/odom", ODOMETRY, ["/base"], [odometry(0.3)] * 20)
    assert found(*made(*CHAIN), heard={**drives, **moves}, **parts) == []
    asks = heard("/cmd_vel_smoothed", TWIST, ["/velocity_smoother"], [twist(0.3)] * 20)
    zeros = heard("/cmd_vel", TWIST, ["/collision_monitor"], [twist()] * 20)
    (held,) = found(*made(*CHAIN), heard={**asks, **zeros, **stands}, **parts)
    assert "/collision_monitor passes on nothing but zeros on /cmd_vel" in held.cause


def test_motors_that_are_off_and_a_limit_of_0_are_causes() -> None:
    off = Diagnostic("base: status", "", "WARN", "motors are disabled", {}, "")
    warm = Diagnostic("battery: status", "", "WARN", "42 °C", {}, "")
    parts: dict[str, Any] = {"heard": {}, "parameters": {}}
    assert "motors are disabled" in told(found(*made(*CHAIN), diagnostics=[off, warm], **parts))[0]
    limit = {"/base": {"max_linear_speed": 0.0, "linear.x.min_velocity": 0.0}}
    (finding,) = found(*made(*CHAIN), heard={}, diagnostics=(), parameters=limit)
    assert "/base has the limit max_linear_speed = 0.0" in finding.cause


# ── servers ──────────────────────────────────────────────────────────────────────────────────────────────────────


def test_all_active_is_fine_and_lines_of_before_that_are_over() -> None:
    lost = line(MANAGER, "CRITICAL FAILURE: SERVER planner_server IS DOWN after not receiving a heartbeat", age_s=60)
    assert managed(ACTIVE, lost) == []
    up = line(MANAGER, "Managed nodes are active", "INFO", 30)
    paused = dict.fromkeys(SERVERS, "inactive")
    (finding,) = managed(paused, lost, up)
    assert (finding.subject, "paused" in finding.cause) == (MANAGER, True)


def test_servers_that_do_not_answer_beside_a_manager_that_does_not_are_told_once_and_not_as_hanging() -> None:
    late = {**ACTIVE, "/planner_server": "", "/controller_server": ""}
    (finding,) = found(states=late, parameters={}, log=[])
    assert "2 servers of Nav2 do not answer: /planner_server, /controller_server" in finding.cause
    assert "too busy" in finding.cause and "node_names" not in finding.proof
    (one,) = found(states={**ACTIVE, "/planner_server": ""}, parameters={}, log=[])
    assert "node_names" not in one.proof and f"{MANAGER} did not answer either" in one.proof


def test_a_lost_bond_tells_whether_the_server_lives_hangs_or_died() -> None:
    lost = line(MANAGER, "CRITICAL FAILURE: SERVER planner_server IS DOWN after not receiving a heartbeat", age_s=12)
    down = dict.fromkeys(SERVERS, "unconfigured")
    (lives,) = managed(down, lost)
    assert "Nav2 is down since 12 s: /planner_server missed its heartbeat, and lives" in lives.cause
    assert "took 2 others down" in lives.cause
    (hangs,) = managed({**down, "/planner_server": ""}, lost)
    assert "/planner_server died, or hangs" in hangs.cause


def test_the_first_that_failed_is_named_with_its_own_line_and_an_old_plugin_name() -> None:
    states = {"/controller_server": "inactive", "/planner_server": "unconfigured", "/bt_navigator": "unconfigured"}
    own = line("/planner_server", "Failed to create global planner: nav2_navfn_planner/NavfnPlanner does not exist")
    false = line("/bt_navigator", "Control loop missed its desired rate")
    plugin = {"/planner_server": {"GridBased.plugin": "nav2_navfn_planner/NavfnPlanner"}}
    (finding,) = managed(states, false, own, parameters=plugin)
    assert finding.subject == "/planner_server" and "2 others only wait" in finding.cause
    assert "does not exist" in finding.proof and "older distribution" in finding.proof


def test_a_node_that_never_comes_and_a_stack_that_was_never_started_are_told() -> None:
    down = dict.fromkeys(SERVERS, "unconfigured")
    (waits,) = managed(down, names=[*SERVERS, "/route_server"])
    assert "waits for /route_server, which does not run" in waits.cause
    (never,) = managed(down, of_supervisor={"autostart": False})
    assert "not started" in never.cause and "autostart" in never.proof


def test_a_server_without_a_manager_and_one_that_is_missing_are_told() -> None:
    graph = GraphSnapshot({}, ["/bt_navigator", "/planner_server"], {"/compute_path_to_pose/_action/send_goal": ["x"]})
    evidence = NavEvidence(graph=graph, states={"/planner_server": "inactive"}, parameters={}, log=(), now_ns=NOW_NS)
    causes = [one.cause for one in nav_findings_in(evidence)]
    assert "/planner_server is inactive." in causes
    assert any("There is no controller_server" in cause for cause in causes)


# ── clocks and frames ────────────────────────────────────────────────────────────────────────────────────────────


def timed(**ages: float) -> dict[str, Heard]:
    kinds = {"scan": SCAN, "odom": ODOMETRY, "imu": "sensor_msgs/msg/Imu"}
    rows: dict[str, Heard] = {}
    for name, age_s in ages.items():
        rows |= heard(
            f"/{name}", kinds[name], [f"/{name}_driver"], count=20, ages_s=[age_s, age_s + 0.02, age_s + 0.01] * 4
        )
    return rows


@pytest.mark.parametrize(
    ("ages", "words"),
    [
        ({"scan": 0.02, "odom": 1.8, "imu": 0.01}, "/odom are 1.80 s behind the others"),
        ({"scan": -0.6, "odom": 0.01}, "/scan are 0.5"),
        ({"scan": 0.7, "odom": 0.02}, ""),
        ({"scan": 3.0, "odom": 3.0}, ""),
        ({"scan": -0.1, "odom": 0.02}, ""),
    ],
    ids=["behind", "ahead", "a delay", "all alike", "a little"],
)
def test_a_clock_is_off_where_the_stamps_of_some_are_always_off(ages: dict[str, float], words: str) -> None:
    said = told(found(heard=timed(**ages), frames=frames(static=[("base_link", "laser")]), parameters={}))
    clocks = [one for one in said if "clocks differ" in one]
    assert (words in clocks[0]) if words else not clocks


def test_the_minority_runs_on_another_time_or_all_on_one_that_stands() -> None:
    clock = topic("/clock", "rosgraph_msgs/msg/Clock", ["/gazebo"], [])
    by_wall = {"/ekf": {"use_sim_time": False}, **{f"/n{number}": {"use_sim_time": True} for number in range(9)}}
    assert "/ekf runs on wall time" in told(found(clock, heard={}, frames=WELL, parameters=by_wall))[0]
    display = {"/rviz2": {"use_sim_time": False}, **{f"/n{number}": {"use_sim_time": True} for number in range(3)}}
    assert found(clock, heard={}, frames=WELL, parameters=display) == []
    stands = {"/ekf": {"use_sim_time": True}, "/n": {"use_sim_time": False}}
    assert "/clock has no publisher" in told(found(heard={}, frames=WELL, parameters=stands))[0]


def test_frames_that_are_well_have_no_finding_though_amcl_stamps_ahead_and_static_stamps_are_old() -> None:
    assert found(*READ, **parts_of(WELL, {**SCANS, **ODOMS})) == []


def test_a_transform_that_died_is_told_by_receipt() -> None:
    late = frames(("map", "odom", 0.1), ("odom", "base_link", 14.0), static=[("base_link", "laser")])
    (finding,) = found(*READ, **parts_of(late, SCANS))
    assert finding.subject == "odom → base" and "14.0 s ago" in finding.proof
    ahead = frames(("map", "odom", 2.0), ("odom", "base_link", 0.1), static=[("base_link", "laser")], ahead_s=1.0)
    (stale,) = found(*READ, **parts_of(ahead, SCANS))
    assert stale.subject == "map → odom" and "2.0 s ago" in stale.proof


def test_a_silent_scan_is_named_and_not_the_transform_that_waits_for_it() -> None:
    late = frames(("map", "odom", 5.0), ("odom", "base_link", 0.1), static=[("base_link", "laser")], ahead_s=1.0)
    (finding,) = found(*READ, **parts_of(late, {**heard("/scan", SCAN, ["/lidar"]), **ODOMS}))
    assert finding.subject == "/scan" and "/lidar publishes it, and nothing comes" in finding.cause


def test_odometry_without_its_transform_names_the_switch() -> None:
    no_odom = frames(static=[("base_link", "laser")])
    causes = told(
        found(*READ, **parts_of(no_odom, {**SCANS, **ODOMS}, diff_drive_controller={"enable_odom_tf": False}))
    )
    assert any("No node publishes the transform from odom" in one and "enable_odom_tf" in one for one in causes)


def test_a_frame_that_nobody_tells_is_named_with_the_one_that_is_meant() -> None:
    wants = {"local_costmap/local_costmap": {"robot_base_frame": "base_footprint", "global_frame": "odom"}}
    (finding,) = found(*READ, **parts_of(WELL, {**SCANS, **ODOMS}, **wants))
    assert "base_footprint, which no transform has; there is base_link" in finding.cause
    scans = heard("/scan", SCAN, ["/lidar"], [scan([2.0] * 60, "laser_link")] * 5, frame_id="laser_link")
    (header,) = found(*READ, **parts_of(WELL, {**scans, **ODOMS}))
    assert "/scan is in the frame laser_link, which no transform has; there is laser" in header.cause


def test_amcl_that_was_never_told_waits_and_no_localiser_is_another_cause() -> None:
    lost = frames(("odom", "base_link", 0.1), static=[("base_link", "laser")])
    the_map = topic("/map", GRID, ["/map_server"], ["/amcl"], durability="transient_local")
    well = {**SCANS, **ODOMS}
    amcl = found(*READ, the_map, states={}, log=(), **parts_of(lost, well, amcl={"set_initial_pose": False}))
    assert "/amcl does not know where the robot is" in amcl[0].cause
    without = topic("/scan", SCAN, ["/lidar"], ["/local_costmap/local_costmap"])
    none = found(without, READ[1], states={}, log=(), **parts_of(lost, well))
    assert "No localiser runs" in none[0].cause


# ── sensors, map, localisation ───────────────────────────────────────────────────────────────────────────────────


def test_a_costmap_that_listens_elsewhere_is_told_where_the_scan_is() -> None:
    wrong = topic("/robot1/local_costmap/scan", SCAN, [], ["/robot1/local_costmap/local_costmap"])
    right = topic("/robot1/scan", SCAN, ["/lidar"], ["/robot1/amcl"])
    (finding,) = found(wrong, right, heard={})
    assert "which has no publisher; the LaserScan is on /robot1/scan" in finding.cause


def test_a_volatile_map_and_no_map_are_told() -> None:
    readers = topic("/map", GRID, ["/map_server"], ["/global_costmap/global_costmap"])
    assert "publishes /map as volatile" in told(found(readers))[0]
    assert found(topic("/map", GRID, ["/map_server"], ["/amcl"], durability="transient_local")) == []
    assert "There is no map" in told(found(topic("/map", GRID, [], ["/amcl"])))[0]


def pose_of(deviation_m: float) -> dict[str, Heard]:
    covariance = [deviation_m**2 if number in (0, 7) else 0.0 for number in range(36)]
    message = SimpleNamespace(pose=SimpleNamespace(covariance=covariance))
    return heard("/amcl_pose", POSE, ["/amcl"], [message])


def test_a_scan_that_fits_is_localised_however_uncertain_and_one_that_does_not_is_lost() -> None:
    fits = heard("/scan", SCAN, ["/lidar"], [scan(in_room())] * 5, frame_id="laser")
    parts: dict[str, Any] = {"frames": WELL, "grids": Grids(map=room(), map_topic="/map"), "parameters": {}}
    assert found(*READ, heard={**fits, **ODOMS, **pose_of(0.9)}, **parts) == []
    wrong = heard("/scan", SCAN, ["/lidar"], [scan([1.2] * 120)] * 5, frame_id="laser")
    (finding,) = found(*READ, heard={**wrong, **ODOMS, **pose_of(0.3)}, **parts)
    assert "the scan does not fit the map" in finding.cause and "0%" in finding.proof
    unknown: dict[str, Any] = {"frames": WELL, "grids": Grids(), "parameters": {}}
    assert found(*READ, heard={**fits, **ODOMS, **pose_of(0.5)}, **unknown) == []
    assert "deviation is 2.00 m" in told(found(*READ, heard={**fits, **ODOMS, **pose_of(2.0)}, **unknown))[0]


def test_the_share_that_fits_follows_the_place() -> None:
    angles = np.arange(120) * math.tau / 120 - math.pi
    hits = [(r * math.cos(a), r * math.sin(a)) for r, a in zip(in_room(), angles, strict=True)]
    assert share_that_fits(room(), hits, 0.0, 0.0, 0.0)[0] > 0.95
    assert share_that_fits(room(), hits, 0.5, 0.0, 0.0)[0] < 0.7
    assert share_that_fits(room(), hits, 50.0, 0.0, 0.0) == (0.0, 120)


def test_beams_that_always_end_inside_the_outline_are_the_robot_and_cover_the_monitor_that_holds_for_them() -> None:
    ranges = [2.0] * 120
    ranges[57:63] = [0.12] * 6
    sees = heard("/scan", SCAN, ["/lidar"], [scan(ranges)] * 5, frame_id="laser")
    outline = {"local_costmap/local_costmap": {"robot_radius": 0.2}}
    monitor = {
        "observation_sources": ["scan"], "scan.topic": "/scan", "polygons": ["Stop"], "Stop.action_type": "stop",
        "Stop.points": "[[0.3, 0.3], [0.3, -0.3], [-0.3, -0.3], [-0.3, 0.3]]", "Stop.min_points": 4,
    }  # fmt: skip
    rows = parts_of(WELL, {**sees, **ODOMS}, **outline, collision_monitor=monitor)
    (finding,) = found(*READ, nodes=["/collision_monitor"], **rows)
    assert "The lidar sees the robot itself" in finding.cause and "0.12 to 0.12 m" in finding.proof
    (held,) = found(*READ, nodes=["/collision_monitor"], **parts_of(WELL, {**sees, **ODOMS}, collision_monitor=monitor))
    assert "its polygon Stop (stop) is not free" in held.cause
    ranges[57] = 2.0  # a person walked through once
    passed = {**heard("/scan", SCAN, ["/lidar"], [scan(ranges), *[scan([2.0] * 120)] * 4], frame_id="laser"), **ODOMS}
    assert (
        found(*READ, nodes=["/collision_monitor"], **parts_of(WELL, passed, **outline, collision_monitor=monitor)) == []
    )


def test_a_source_of_the_monitor_that_nobody_publishes_is_told() -> None:
    monitor = {"observation_sources": ["cloud"], "cloud.topic": "/cloud", "source_timeout": 1.0}
    (finding,) = found(
        *READ, nodes=["/collision_monitor"], **parts_of(WELL, {**SCANS, **ODOMS}, collision_monitor=monitor)
    )
    assert "its source cloud has no publisher" in finding.cause and "source_timeout is 1 s" in finding.proof


IN_AND_OUT = (
    topic("/cmd_vel_smoothed", TWIST, ["/velocity_smoother"], ["/collision_monitor"]),
    topic("/cmd_vel", TWIST, ["/collision_monitor"], ["/base"]),
)
NO_SOURCE = (
    "Robot to stop due to invalid source. Either due to data not published yet, or to lack of new data received within "
    "the sensor timeout, or if impossible to transform data to base frame"
)


def monitor_says(action: int, polygon: str, passed: float = 0.0, **more: Any) -> list[NavFinding]:
    """The findings with a state of the collision monitor (-1: none was heard), which gets 0.2 m/s and passes on so
    much."""
    state = [SimpleNamespace(action_type=action, polygon_name=polygon)] if action >= 0 else []
    flows = {
        **heard("/state", MONITOR, ["/collision_monitor"], state),
        **heard("/cmd_vel_smoothed", TWIST, ["/velocity_smoother"], [twist(0.2)] * 20),
        **heard("/cmd_vel", TWIST, ["/collision_monitor"], [twist(passed)] * 20),
    }
    moving = heard("/odom", ODOMETRY, ["/base"], [odometry(0.2)] * 20, frame_id="odom")
    monitor = {"observation_sources": ["scan"], "scan.topic": "scan", "polygons": ["FootprintApproach"]}
    flows = {**more.pop("scans", SCANS), **moving, **flows}
    rows = parts_of(more.pop("tree", WELL), flows, collision_monitor=monitor)
    return found(*READ, *IN_AND_OUT, nodes=["/collision_monitor"], **rows, **more)


def test_the_monitors_word_for_missing_data_is_no_polygon() -> None:
    (finding,) = monitor_says(1, "invalid source", log=[line("/collision_monitor", NO_SOURCE, "WARN")])
    assert "gives no valid data" in finding.cause and "polygon" not in finding.cause
    assert "Robot to stop due to invalid source" in finding.proof and "/scan" in finding.proof


def test_a_source_without_data_is_found_by_the_monitors_log_where_its_state_came_before_anybody_listened() -> None:
    said = line("/collision_monitor", NO_SOURCE, "WARN", age_s=100.0)
    unseen = frames(("map", "odom", 0.1), ("odom", "base_link", 0.05), ahead_s=1.0)
    causes = told(monitor_says(-1, "", log=[said], tree=unseen))
    assert any("its source /scan has no transform from laser to base_link" in cause for cause in causes)
    assert monitor_says(-1, "", 0.2, log=[said]) == []  # it has data again


@pytest.mark.parametrize("action", [2, 3, 4])
def test_what_slows_the_robot_holds_it_only_where_nothing_is_passed_on(action: int) -> None:
    (finding,) = monitor_says(action, "FootprintApproach")
    assert "its polygon FootprintApproach" in finding.cause and "is not free" in finding.cause
    assert monitor_says(action, "FootprintApproach", 0.08) == []


# ── goal and settings ────────────────────────────────────────────────────────────────────────────────────────────


def test_a_goal_in_unknown_space_is_a_cause_only_where_the_planner_may_not_enter_it() -> None:
    cells = np.zeros((40, 40), np.int8)
    cells[:, 30:] = -1
    cells[:, 10] = 100
    grids = Grids(costs=grid(cells), costs_topic="/global_costmap/costmap")

    def of(x_m: float, *, allowed: bool) -> list[str]:
        values = {"planner_server": {"GridBased.allow_unknown": allowed}}
        return told(found(goal=Goal(x_m=x_m, y_m=0.0), grids=grids, **parts_of(WELL, {}, **values)))

    assert "lies in unknown space" in of(1.5, allowed=False)[0]
    assert of(1.5, allowed=True) == [] and of(0.5, allowed=False) == []
    assert "is occupied" in of(-0.95, allowed=True)[0] and "outside of" in of(9.0, allowed=True)[0]
    assert "no free path" in of(-1.5, allowed=True)[0]


def settings(**values: Mapping[str, Any]) -> list[str]:
    return told(found(parameters={f"/{node}": each for node, each in values.items()}, log=(), heard={}))


def test_a_progress_that_cannot_be_made_and_a_time_out_without_time_are_told() -> None:
    usual = {"progress_checker.required_movement_radius": 0.5, "progress_checker.movement_time_allowance": 10.0}
    assert settings(controller_server={**usual, "FollowPath.desired_linear_vel": 0.4}) == []
    hurried = {**usual, "progress_checker.movement_time_allowance": 3.0, "FollowPath.desired_linear_vel": 0.1}
    assert "0.5 m in 3 s is asked (0.17 m/s), 0.1 m/s is allowed" in settings(controller_server=hurried)[0]
    assert settings(bt_navigator={"default_server_timeout": 20}) == []
    assert "gives up before the servers can answer" in settings(bt_navigator={"default_server_timeout": 1})[0]
    late = line("/bt_navigator", "Timed out while waiting for action server to acknowledge goal request", "WARN")
    said = told(found(parameters={}, log=[late], heard={}))
    assert "Timed out while waiting" in said[0]


def test_a_server_that_answers_far_slower_than_the_others_is_told_against_the_time_out() -> None:
    wants = {"/bt_navigator": {"default_server_timeout": 20}}
    others = {f"/n{number}": 0.004 for number in range(5)}
    late = States(ACTIVE, {**others, "/planner_server": 0.09})
    (finding,) = found(parameters=wants, log=(), heard={}, states=late)
    assert "/planner_server takes 90 ms" in finding.proof and "default_server_timeout is 20 ms" in finding.proof
    loaded = States(ACTIVE, {**dict.fromkeys(others, 0.08), "/planner_server": 0.09})
    assert found(parameters=wants, log=(), heard={}, states=loaded) == []


def test_a_missed_rate_is_measured_and_the_warning_alone_is_nothing() -> None:
    false = line("/controller_server", "Control loop missed its desired rate of 20.0000 Hz", "WARN")
    wants = {"/controller_server": {"controller_frequency": 20.0}}
    assert found(parameters=wants, log=[false], heard={}) == []
    slow = heard("/cmd_vel_nav", TWIST, ["/controller_server"], [twist(0.2)] * 20)
    (finding,) = found(parameters=wants, log=[], heard=slow)
    assert finding.rank == "makes it worse" and "10.0 of 20 Hz" in finding.proof


def test_the_rate_is_that_of_the_controller_and_not_of_the_behaviours_on_its_topic() -> None:
    wants = {"/controller_server": {"controller_frequency": 20.0}}
    both_publish = ["/behavior_server", "/controller_server"]
    steering = heard("/cmd_vel_nav", TWIST, both_publish, [twist(0.2, 0.01), *[twist(0.2)] * 19])
    (finding,) = found(parameters=wants, log=[], heard=steering)
    assert finding.subject == "/controller_server" and "10.0 of 20 Hz" in finding.proof
    backing = heard("/cmd_vel_nav", TWIST, both_publish, [twist(-0.1)] * 20)
    assert found(parameters=wants, log=[], heard=backing) == []
    teleop = heard("/cmd_vel_nav", TWIST, ["/controller_server", "/joy"], [twist(0.2, 0.1)] * 20)
    assert found(parameters=wants, log=[], heard=teleop) == []


def test_a_costmap_all_of_whose_values_are_defaults_never_got_its_file() -> None:
    defaults = {"width": 5, "height": 5, "resolution": 0.1, "robot_radius": 0.1, "footprint": "[]"}
    node = "local_costmap/local_costmap"
    rows = parts_of(WELL, {}, **{node: defaults})
    (finding,) = found(nodes=[f"/{node}"], **rows)
    assert "its parameter file was probably never applied" in finding.cause
    assert found(nodes=[f"/{node}"], **parts_of(WELL, {}, **{node: {**defaults, "robot_radius": 0.22}})) == []
