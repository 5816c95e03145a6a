"""Endpoints that cannot match, and sensor topics that have subscribers but no publisher."""

from __future__ import annotations

from collections.abc import Iterator

from ros2_mcp.ops.graph.remaps import led_nowhere
from ros2_mcp.ops.measure.checks.check import Check
from ros2_mcp.ops.measure.evidence import Evidence, nodes_of, only, streams
from ros2_mcp.ops.measure.findings import Finding
from ros2_mcp.ops.topics.info import mismatches


def _find(evidence: Evidence) -> Iterator[Finding]:
    remapped = led_nowhere(evidence.graph.topics)
    for name, topic in evidence.graph.topics.items():
        for sentence in dict.fromkeys(mismatches(topic.publishers, topic.subscribers)):
            advice = "Give both the same type and compatible QoS; no message passes between them now."
            yield Finding("warning", name, sentence, advice)
        if streams(topic) and topic.subscribers and not topic.publishers and name not in remapped:
            problem = f"{nodes_of(topic.subscribers)} subscribes to it, but it has no publisher."
            cause = only(evidence.graph.left.topics.get(name, ()))
            yield Finding("warning", name, problem, "Start the sensor's driver, or correct a remapping.", cause)


CHECK = Check((), _find)
