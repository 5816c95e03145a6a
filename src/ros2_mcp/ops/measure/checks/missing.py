"""Expected names that are missing; services and nodes that a source does not record are not judged."""

from __future__ import annotations

from collections.abc import Iterator

from ros2_mcp.model import names
from ros2_mcp.ops.measure.checks.check import FIRST, Check
from ros2_mcp.ops.measure.evidence import Evidence, only
from ros2_mcp.ops.measure.findings import Finding


def _find(evidence: Evidence) -> Iterator[Finding]:
    graph, expected = evidence.graph, evidence.expected
    for name in expected.topics:
        cause = only(graph.left.topics.get(name, ()))
        if name not in graph.topics:
            hint = names.did_you_mean(name, list(graph.topics), "Start the node that publishes it.")
            yield Finding("critical", name, "The expected topic does not exist.", hint, cause)
        elif not graph.topics[name].publishers:
            yield Finding("critical", name, "The expected topic has no publisher.", "Start its publisher.", cause)
    kinds = (("service", expected.services, graph.services), ("node", expected.nodes, graph.nodes))
    for kind, expected_names, present in kinds:
        for name in expected_names if present is not None else ():
            if name not in (present or ()):
                hint = names.did_you_mean(name, list(present or ()), "Start its node, or correct the name.")
                cause = name if kind == "node" else ""
                yield Finding("critical", name, f"The expected {kind} is missing.", hint, cause)


CHECK = Check((), _find, place=FIRST)
