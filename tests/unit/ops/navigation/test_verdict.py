"""The verdict of `ros2_nav_check`: FINE only where what it needs was read."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import pytest

from ros2_mcp.ops.navigation.check import judged
from ros2_mcp.ops.navigation.evidence import NavEvidence
from ros2_mcp.ops.sources.source import GraphSnapshot
from support.made_navigation import ACTIVE, CHAIN, MANAGER, NOW_NS, ODOMS, READ, SCANS, SERVERS, WELL, made

NODES = [*SERVERS, MANAGER, "/velocity_smoother", "/collision_monitor", "/base", "/lidar", "/amcl"]


def whole(**more: Any) -> NavEvidence:
    """A robot with Nav2 of which all was read, and nothing is wrong."""
    topics = {one.topic: one for one in (*made(*CHAIN), READ[0])}
    services = {f"{node}/get_parameters": ["rcl_interfaces/srv/GetParameters"] for node in NODES}
    services |= {f"{node}/get_state": ["lifecycle_msgs/srv/GetState"] for node in SERVERS}
    parameters: dict[str, dict[str, Any]] = {node: {"use_sim_time": False} for node in NODES}
    parameters[MANAGER] = {"use_sim_time": False, "node_names": [name.strip("/") for name in SERVERS]}
    well = NavEvidence(
        graph=GraphSnapshot(topics, NODES, services),
        parameters=parameters,
        states=dict(ACTIVE),
        heard={**SCANS, **ODOMS},
        frames=WELL,
        log=(),
        diagnostics=(),
        now_ns=NOW_NS,
    )
    return replace(well, **more)


def test_all_read_and_nothing_found_is_fine() -> None:
    checked = judged(whole())
    assert (checked.verdict, list(checked.unread), list(checked.findings)) == ("FINE", [], [])


@pytest.mark.parametrize(
    ("lacks", "said"),
    [
        ({"states": None}, "the states of Nav2's servers (no answer within 8 s)"),
        ({"states": {"/planner_server": "active"}}, "the states of 2 of 3 servers (/controller_server, /bt_navigator"),
        ({"parameters": None}, "the parameters (no answer in time)"),
        ({"heard": None}, "scans, odometry and commands"),
        ({"heard": ODOMS}, "the sensors (/scan could not be listened to)"),
        ({"heard": SCANS}, "odometry (/odom could not be listened to)"),
        ({"frames": None}, "the transforms"),
    ],
    ids=["states", "some states", "parameters", "topics", "scan", "odometry", "frames"],
)
def test_what_was_not_read_is_told_in_place_of_fine(lacks: dict[str, Any], said: str) -> None:
    checked = judged(whole(**lacks), {"states": "no answer within 8 s"})
    assert checked.verdict == "NOT KNOWN"
    assert said in checked.summary()[0] and checked.summary()[0].startswith("NOT KNOWN: not read: ")


def test_parameters_of_a_server_that_did_not_answer_are_told_and_a_node_without_such_a_service_is_not() -> None:
    evidence = whole()
    parameters = {node: values for node, values in (evidence.parameters or {}).items() if node != "/controller_server"}
    checked = judged(replace(evidence, parameters=parameters))
    assert checked.verdict == "NOT KNOWN" and "(/controller_server: no answer in time)" in checked.unread[0]
    services = {name: types for name, types in (evidence.graph.services or {}).items() if "controller" not in name}
    graph = GraphSnapshot(evidence.graph.topics, NODES, services)
    assert judged(replace(evidence, graph=graph, parameters=parameters)).verdict == "FINE"


def test_a_cause_that_was_found_stays_the_headline_and_what_was_not_read_is_told_beside_it() -> None:
    checked = judged(whole(frames=None, states={**ACTIVE, "/planner_server": "inactive"}))
    assert checked.verdict == "STOPPED"
    assert any(line.startswith("Not read: the transforms") for line in checked.summary())


def test_docks_are_listed_with_their_places() -> None:
    docking = {"docks": ["charger", "parking"], "charger.pose": [-1.7, 0.0, 3.14], "use_sim_time": False}
    well = whole()
    nodes = [*NODES, "/docking_server"]
    graph = replace(well.graph, nodes=nodes)
    checked = judged(replace(well, graph=graph, parameters={**(well.parameters or {}), "/docking_server": docking}))
    assert "Docks: charger at (-1.70, 0.00), parking" in checked.seen
