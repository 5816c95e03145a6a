"""Lifecycle nodes that failed, were not configured, are not active, or do not report their state."""

from __future__ import annotations

from collections.abc import Iterator

from ros2_mcp.model.text import listed, named
from ros2_mcp.ops.measure.checks.check import FIRST, Check
from ros2_mcp.ops.measure.evidence import MAX_NAMES, Evidence
from ros2_mcp.ops.measure.findings import Finding

_ADVICE = {
    "unconfigured": "Configure and activate it with ros2_lifecycle_change; ros2_log_read may show why it is not.",
    "inactive": "Activate it with ros2_lifecycle_change, if it is needed.",
}
_FAILED = "It has failed or was shut down: start its node again; ros2_log_read may show why."
_MEANS = {
    "unconfigured": "never configured, or its configuration failed",
    "inactive": "configured, and does nothing",
    "finalized": "shut down, or failed for good",
}


def _find(evidence: Evidence) -> Iterator[Finding]:
    by_state: dict[str, list[str]] = {}
    of_nav2 = {name for found in evidence.navigation or () for name in (found.subject, *found.covers)}
    for node in evidence.lifecycle or ():
        if node.node in of_nav2:
            continue
        if node.error:
            yield Finding("warning", node.node, f"Its lifecycle state is not known: {node.error}", _FAILED, node.node)
        elif node.state != "active":
            by_state.setdefault(node.state, []).append(node.node)
    for state, nodes in by_state.items():
        means = f" ({_MEANS[state]})" if state in _MEANS else ""
        advice = _ADVICE.get(state, _FAILED)
        if len(nodes) == 1:  # as the cause, so that the silence of its topics is not a second fault
            yield Finding("warning", nodes[0], f"It is {named(state)}{means}.", advice, nodes[0])
        else:
            problem = f"{len(nodes)} nodes are {named(state)}{means}: {listed(nodes, MAX_NAMES)}."
            yield Finding("warning", "lifecycle", problem, advice)


CHECK = Check(("lifecycle",), _find, place=FIRST)
