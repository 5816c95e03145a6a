"""The checks of navigation on evidence as planted causes left it: what is named, and what only follows from it."""

from __future__ import annotations

from dataclasses import replace

from ros2_mcp.ops.navigation.check import judged
from ros2_mcp.ops.navigation.checks import nav_findings_in
from ros2_mcp.ops.navigation.evidence import States
from support.made_navigation import (
    ODOMETRY,
    ODOMS,
    READ,
    SCAN,
    SERVERS,
    WELL,
    found,
    frames,
    heard,
    odometry,
    parts_of,
    scan,
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
