"""Several types on one topic or service, and types that are not installed where the bridge runs."""

from __future__ import annotations

from collections.abc import Iterator

from ros2_mcp.model.errors import UnknownInterface
from ros2_mcp.model.qos import Endpoint
from ros2_mcp.model.text import listed, named
from ros2_mcp.ops.measure.checks.check import Check
from ros2_mcp.ops.measure.evidence import MAX_NAMES, Evidence, nodes_of
from ros2_mcp.ops.measure.findings import Finding
from ros2_mcp.ops.sources.source import Missing


def _find(evidence: Evidence) -> Iterator[Finding]:
    for name, topic in evidence.graph.topics.items():
        by_type: dict[str, list[Endpoint]] = {}
        for publisher in topic.publishers:
            by_type.setdefault(publisher.type, []).append(publisher)
        if len(by_type) > 1:  # a subscriber receives messages of its own type only
            who = "; ".join(f"{nodes_of(found)} publishes {type_name}" for type_name, found in by_type.items())
            severity = "critical" if name in evidence.expected.topics else "warning"
            advice = "Stop or remap the wrong publisher; the topic cannot be measured until then."
            yield Finding(severity, name, f"Several types on one topic: {who}.", advice)
    for name, types in (evidence.graph.services or {}).items():
        if len(set(types)) > 1:
            problem = f"One service with {len(set(types))} types: {', '.join(map(named, sorted(set(types))))}."
            if servers := sorted(set((evidence.servers or {}).get(name, ()))):
                problem += f" Offered by {listed(servers, MAX_NAMES)}."
            advice = "Stop or remap the wrong server, or the client that asks with the wrong type."
            yield Finding("warning", name, problem, advice)
    topics: dict[str, list[Missing]] = {}
    for missing in evidence.not_measured:
        if isinstance(missing.error, UnknownInterface):
            topics.setdefault(missing.error.message, []).append(missing)
    for problem, (first, *others) in topics.items():
        also = f" The same holds for {listed([other.topic for other in others], MAX_NAMES)}." if others else ""
        told = f"The topic cannot be measured or read. {problem}{also}"
        yield Finding("warning", first.topic, told, first.error.hint)


CHECK = Check((), _find)
