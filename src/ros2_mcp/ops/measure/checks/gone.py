"""No robot is found, or nodes and topics that were present earlier in this session have left."""

from __future__ import annotations

from collections.abc import Iterator

from ros2_mcp.model.text import listed
from ros2_mcp.ops.measure.checks.check import FIRST, Check
from ros2_mcp.ops.measure.evidence import MAX_NAMES, ONCE_A_SECOND, STREAM_TYPES, Evidence, only
from ros2_mcp.ops.measure.findings import Finding

_STEADY = STREAM_TYPES | ONCE_A_SECOND


def _find(evidence: Evidence) -> Iterator[Finding]:
    """Report nodes and publishers that have left. This is critical for sensors and expected names; other nodes (a
    display, a remote control, one of several localisations) may have been closed on purpose. While discovery is under
    way, all of them may still appear.
    """
    graph, expected = evidence.graph, evidence.expected
    if graph.absence:
        severity = "critical" if graph.settled else "warning"
        yield Finding(severity, "robot", graph.absence, "Start the robot, or start this server in the robot's domain.")
        return
    silenced: dict[tuple[str, ...], list[str]] = {}
    for topic, publishers in graph.left.topics.items():
        silenced.setdefault(tuple(publishers), []).append(topic)
    for publishers, topics in silenced.items():
        gone = [node for node in publishers if node in graph.left.nodes]
        who = f"{listed(gone, MAX_NAMES)} has left:" if gone else f"{listed(publishers, MAX_NAMES)} is there, but"
        problem = f"{who} no publisher is left on {listed(sorted(topics), MAX_NAMES)}."
        advice = "Start the node again; ros2_log_read may show why it ended."
        is_needed = any(graph.left.types.get(name) in _STEADY or name in expected.topics for name in topics)
        severity = "critical" if is_needed and graph.settled else "warning"
        yield Finding(severity, publishers[0], problem, advice, only(publishers))
    missed = {node for publishers in silenced for node in publishers}
    for node in sorted(set(graph.left.nodes) - missed):
        problem = "It was running earlier in this session, and has left."
        yield Finding("warning", node, problem, "Start the node again if it is needed.", node)


CHECK = Check((), _find, place=FIRST)
