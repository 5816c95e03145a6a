"""Each check on evidence made for it: what is a fault, and what looks like one and is none."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import pytest

from ros2_mcp.model.qos import Endpoint, QoS
from ros2_mcp.ops.measure.checks import CHECKS, findings_in
from ros2_mcp.ops.measure.checks.parameter_ranges import outside
from ros2_mcp.ops.measure.diagnostics import DiagnosticTable
from ros2_mcp.ops.measure.evidence import Evidence, Expectations, Flow, Ros2Control, TopicRow
from ros2_mcp.ops.measure.findings import Finding, joined
from ros2_mcp.ops.measure.rivals import Rivals
from ros2_mcp.ops.nodes.lifecycle import LifecycleState
from ros2_mcp.ops.nodes.parameters import Parameter
from ros2_mcp.ops.sources.source import GraphSnapshot
from ros2_mcp.robot import TopicEndpoints
from support.made_windows import Make

TEXT = "std_msgs/msg/String"


def found_in(graph: GraphSnapshot | None = None, **parts: Any) -> list[Finding]:
    return findings_in(Evidence(graph=graph or GraphSnapshot({}, []), expected=Expectations(), is_live=True, **parts))


def subjects(findings: Sequence[Finding]) -> list[str]:
    return [finding.subject for finding in findings]


def topics(*rows: tuple[str, str, str, str]) -> GraphSnapshot:
    """Of (topic, type, publisher, subscriber); an empty name is nobody."""

    def ends(node: str, kind: str) -> Sequence[Endpoint]:
        return [Endpoint(node, kind, "", node, QoS())] if node else ()

    made = [TopicEndpoints(name, ends(by, kind), ends(to, kind)) for name, kind, by, to in rows]
    return GraphSnapshot({one.topic: one for one in made}, [])


def test_there_are_checks_and_those_whose_evidence_lacks_find_nothing() -> None:
    assert len(CHECKS) > 10
    assert found_in() == []


# ── controllers ──────────────────────────────────────────────────────────────────────────────────────────────────


def controller(name: str, state: str, **interfaces: Sequence[str]) -> Mapping[str, Any]:
    return {"name": name, "state": state, "type": f"some_controllers/{name.title()}", **interfaces}


def component(name: str, state: str, *interfaces: str) -> Mapping[str, Any]:
    rows = [{"name": one} for one in interfaces]
    return {"name": name, "state": {"id": 1, "label": state}, "command_interfaces": rows, "state_interfaces": []}


def managed(controllers: Sequence[Mapping[str, Any]], hardware: Sequence[Mapping[str, Any]] = ()) -> list[Finding]:
    return found_in(ros2_control={"/controller_manager": Ros2Control(controllers, hardware)})


ARM = controller("arm", "active", claimed_interfaces=["joint1/position"])


def test_a_controller_that_is_not_active_is_a_fault() -> None:
    assert managed([ARM]) == []
    wheels = controller("base", "inactive", required_command_interfaces=["left/velocity", "right/velocity"])
    assert subjects(managed([ARM, wheels])) == ["/base"]
    assert subjects(managed([ARM, controller("states", "inactive")])) == ["/states"]
    assert "unconfigured" in managed([controller("arm", "unconfigured")])[0].problem


def test_a_controller_that_waits_while_another_has_its_joints_is_none() -> None:
    assert managed([ARM, controller("by_force", "inactive", required_command_interfaces=["joint1/position"])]) == []


def test_hardware_that_is_not_active_is_named_with_the_controller_above_it() -> None:
    assert managed([ARM], [component("ArmHW", "active", "joint1/position")]) == []
    (finding,) = managed([ARM], [component("ArmHW", "unconfigured", "joint1/position")])
    assert (finding.subject, finding.cause) == ("/arm", "/arm")
    assert "ArmHW is unconfigured, below the active /arm" in finding.problem
    assert subjects(managed([ARM], [component("Gripper", "inactive", "finger/position")])) == ["/Gripper"]


# ── diagnostics ──────────────────────────────────────────────────────────────────────────────────────────────────


class _Status:
    def __init__(self, level: int, name: str, message: str, values: Mapping[str, str]) -> None:
        self.level, self.name, self.message, self.hardware_id = level, name, message, ""
        self.values = [type("KeyValue", (), {"key": key, "value": value})() for key, value in values.items()]


def reported(message: str, ros2_control: Mapping[str, Ros2Control] | None = None, **values: str) -> list[Finding]:
    table = DiagnosticTable()
    table.add(type("Array", (), {"status": [_Status(0, "manager: state", message, values)]})(), 1)
    return found_in(diagnostics=table, ros2_control=ros2_control)


@pytest.mark.parametrize("message", ["Managed nodes are inactive", "gripper not active", "2 parts unconfigured"])
def test_a_message_at_level_ok_that_names_an_inactive_part_counts(message: str) -> None:
    assert "an inactive part" in reported(message)[0].problem


@pytest.mark.parametrize("message", ["", "Managed nodes are active", "no inactive nodes", "deactivation took 2 s"])
def test_a_message_that_names_none_does_not(message: str) -> None:
    assert reported(message) == []


def test_a_value_at_level_ok_that_is_a_state_of_doing_nothing_counts_unless_its_controller_is_judged_anyway() -> None:
    assert "«ArmHW» is «unconfigured»" in reported("all running", ArmHW="unconfigured", arm="active")[0].problem
    waiting = controller("by_force", "inactive", required_command_interfaces=["joint1/position"])
    control = {"/controller_manager": Ros2Control([ARM, waiting])}
    assert reported("all running", control, by_force="inactive") == []


# ── parameters ───────────────────────────────────────────────────────────────────────────────────────────────────


def parameter(value: Any, description: str, name: str = "gain") -> Parameter:
    kind = "bool" if isinstance(value, bool) else "double"
    return Parameter(name=name, type=kind, value=value, description=description)


@pytest.mark.parametrize(
    ("value", "description"),
    [
        (2.5, "Share of the battery, between 0 and 1"),
        (-1, "Speed from 0 to 2 m/s"),
        (7, "Gain [0, 5]"),
        (7, "Gain (0.0 - 5.0)"),
        (400.0, "Angle in degrees, -180..180"),
        (0.0, "Rate in Hz, must be positive"),
        (-3.0, "Must be non-negative and must be positive"),
        (0.05, "Resolution in m, at least 0.1"),
        (12, "Threads, at most 8"),
        (0, "Timeout in s (> 0)"),
        (1.2, "Damping: 0 <= x <= 1"),
        (30, "Queue size. Maximum: 20"),
        (5, "must not exceed 4"),
    ],
)
def test_a_value_outside_of_what_its_description_says_is_a_fault(value: float, description: str) -> None:
    assert outside(parameter(value, description))
    assert subjects(found_in(parameters={"/tuned": [parameter(value, description)]})) == ["/tuned"]


@pytest.mark.parametrize(
    ("value", "description"),
    [
        (0.5, "Share of the battery, between 0 and 1"),
        (1.0, "between 0 and 1"),
        (7, "Number of laser beams"),
        (True, "between 2 and 3"),
        ("fast", "between 2 and 3"),
        (None, "between 2 and 3"),
        (7, "Version 1.2 of the protocol, see chapter 3 to 5 of RFC-2119"),
        (100.0, "Fastest speed [m/s]"),
        (0.0, "Must be non-negative"),
        (3, "Mode: 0 off, 1 on, 3 automatic"),
        (-1.0, "Offset in m; negative is backwards, positive forwards"),
        (float("inf"), "at most 3"),
    ],
)
def test_a_value_within_or_without_a_range_is_none(value: Any, description: str) -> None:
    assert outside(parameter(value, description)) == ""


def clocks(**simulated: bool) -> dict[str, list[Parameter]]:
    return {f"/{node}": [parameter(value, "", "use_sim_time")] for node, value in simulated.items()}


def test_nodes_whose_clock_differs_are_named() -> None:
    clock = topics(("/clock", "rosgraph_msgs/msg/Clock", "/simulator", "/nav"))
    assert found_in(clock, parameters=clocks(nav=True, map=True, simulator=False)) == []
    assert found_in(parameters=clocks(nav=False, map=False)) == []
    (finding,) = found_in(clock, parameters=clocks(nav=True, map=True, lidar=False))
    assert (finding.subject, "false, unlike that of 2 others: /lidar" in finding.problem) == ("/lidar", True)
    (finding,) = found_in(parameters=clocks(nav=True, map=False))
    assert "/clock has no publisher: /nav" in finding.problem


# ── lifecycle, servers, remappings, joint states ─────────────────────────────────────────────────────────────────


def test_lifecycle_nodes_that_failed_or_were_never_configured_are_named_by_state() -> None:
    states = {"a": "active", "b": "unconfigured", "c": "unconfigured", "d": "finalized", "e": "inactive"}
    rows = [LifecycleState(f"/{name}", state, ()) for name, state in states.items()]
    found = found_in(lifecycle=[*rows, LifecycleState("/f", "unknown", (), "it hangs")])
    assert subjects(found) == ["/f", "lifecycle", "/d", "/e"]
    assert "2 nodes are unconfigured" in found[1].problem and "/b, /c" in found[1].problem


def test_a_service_or_an_action_of_two_nodes_is_a_fault() -> None:
    servers = {"/reset": ["/a", "/b"], "/a/get_parameters": ["/a"], "/go/_action/send_goal": ["/a", "/b"]}
    hidden = {"/go/_action/get_result": ["/a", "/b"]}
    (finding,) = found_in(servers=servers | hidden)
    assert "/a, /b offer the service /reset and the action /go" in finding.problem
    assert found_in(servers={"/reset": ["/a"], "/go/_action/send_goal": ["/b"]}) == []


def test_one_service_with_two_types_is_a_fault() -> None:
    graph = GraphSnapshot({}, [], {"/reset": ["std_srvs/srv/Trigger", "std_srvs/srv/Empty"], "/one": ["a/srv/B"]})
    assert subjects(found_in(graph)) == ["/reset"]
    (finding,) = found_in(graph, servers={"/reset": ["/b", "/a"]})
    assert "2 types" in finding.problem and "by /a, /b" in finding.problem


@pytest.mark.parametrize(
    ("published", "awaited"),
    [
        ("/chatter", "/chatter_remapped"),
        ("/robot/chatter", "/chatter"),
        ("/raw_chatter", "/chatter"),
        ("/chater", "/chatter"),
        ("/lidar/scan_front", "/scan/front_lidar"),
    ],
)
def test_a_remapping_that_leads_nowhere_is_a_fault(published: str, awaited: str) -> None:
    graph = topics((published, TEXT, "/talker", ""), (awaited, TEXT, "", "/listener"))
    (finding,) = found_in(graph)
    assert (finding.subject, f"{published}:={awaited}" in finding.recommendation) == (awaited, True)


def test_what_is_silent_because_of_a_remapping_is_told_with_it_and_once() -> None:
    scan = "sensor_msgs/msg/LaserScan"
    graph = topics(
        ("/front/scan", scan, "/lidar", ""), ("/scan/front", scan, "", "/filter"), ("/clean", scan, "/filter", "")
    )
    row = TopicRow("/clean", scan, 1, 0, "SILENT", None, None, expected=False)
    (finding,) = joined(found_in(graph, rows=[row], flows={"/clean": Flow(0, None, 0.0)}))
    assert (finding.subject, "/front/scan:=/scan/front" in finding.recommendation) == ("/scan/front", True)
    assert "/front/scan, which has no subscriber" in finding.problem and "/clean has no messages" in finding.problem


def test_a_topic_that_another_node_publishes_too_is_not_silent_because_of_one_node_that_waits() -> None:
    scan = "sensor_msgs/msg/LaserScan"
    waits = topics(("/scan", scan, "", "/filter"), ("/clean", scan, "/filter", ""))
    both = TopicEndpoints("/clean", [Endpoint(node, scan, "", node, QoS()) for node in ("/filter", "/other")], ())
    row = TopicRow("/clean", scan, 1, 0, "SILENT", None, None, expected=False)

    def problems(graph: GraphSnapshot) -> str:
        return " ".join(one.problem for one in found_in(graph, rows=[row], flows={"/clean": Flow(0, None, 0.0)}))

    assert "; so /clean has no messages" in problems(waits)
    assert "so /clean" not in problems(replace(waits, topics={**waits.topics, "/clean": both}))


@pytest.mark.parametrize(
    "rows",
    [
        [("/chatter", TEXT, "/talker", "/other"), ("/chatter_remapped", TEXT, "", "/listener")],
        [("/chatter", TEXT, "/talker", ""), ("/chatter_remapped", "std_msgs/msg/Bool", "", "/listener")],
        [("/left/wheel/speed", TEXT, "/talker", ""), ("/speed/wheel/right", TEXT, "", "/listener")],
        [("/status", TEXT, "/talker", ""), ("/command", TEXT, "", "/listener")],
        [("/chatter", TEXT, "/talker", ""), ("/chatter_in", TEXT, "", "/talker")],
        [("/a/chatter", TEXT, "/x", ""), ("/b/chatter", TEXT, "/y", ""), ("/chatter", TEXT, "", "/listener")],
    ],
    ids=["somebody hears it", "another type", "another word", "another name", "its own node", "which of two"],
)
def test_what_only_looks_like_a_remapping_is_none(rows: list[tuple[str, str, str, str]]) -> None:
    assert found_in(topics(*rows)) == []


def told(window: Make, positions: Sequence[float]) -> list[Finding]:
    kind = "sensor_msgs/msg/JointState"
    messages = [(0.1 * i, {"name": ["elbow"], "position": [at]}) for i, at in enumerate(positions)]
    made = window("/joint_states", kind, messages, 0.1 * len(positions) + 0.1)
    rivals = Rivals(made.stream())
    rivals.add(made.samples)
    return found_in(rivals={"/joint_states": rivals})


def test_joint_states_that_contradict_each_other_are_a_fault(window: Make) -> None:
    (finding,) = told(window, [0.0, 1.0] * 10)
    assert (finding.subject, "elbow jumps back and forth by up to 1 rad" in finding.problem) == ("/joint_states", True)
    assert told(window, [0.0, 0.0, 1.0] * 10)


@pytest.mark.parametrize(
    "positions",
    [[0.1 * i for i in range(20)], [0.0] * 20, [0.0, 0.005] * 10, [0.0] * 10 + [1.0] * 10, [0.0, float("nan")] * 10],
    ids=["moves", "stands", "noise", "one jump", "not known"],
)
def test_joint_states_that_agree_are_none(window: Make, positions: Sequence[float]) -> None:
    assert told(window, positions) == []
