"""A subscribed topic without a publisher, and a similar topic without a subscriber: most likely a missing remapping."""

from __future__ import annotations

from collections.abc import Iterator

from ros2_mcp.ops.graph.remaps import led_nowhere
from ros2_mcp.ops.measure.checks.check import FIRST, Check
from ros2_mcp.ops.measure.evidence import Evidence, nodes_of, only
from ros2_mcp.ops.measure.findings import Finding


def _find(evidence: Evidence) -> Iterator[Finding]:
    for name, published in led_nowhere(evidence.graph.topics).items():
        awaited = evidence.graph.topics[name]
        who, by = nodes_of(awaited.subscribers), nodes_of(published.publishers)
        other = f"{by} publishes {published.topic}, which has no subscriber"
        problem = f"{who} subscribes to it, but it has no publisher; {other}."
        advice = f"If they belong together, remap one: {published.topic}:={name}."
        yield Finding("warning", name, problem, advice, only(evidence.graph.left.topics.get(name, ())) or name)


CHECK = Check((), _find, place=FIRST)
