"""Diagnostics that are not OK, or that are OK while a message or value says that a part is inactive."""

from __future__ import annotations

import re
from collections.abc import Iterator

from ros2_mcp.model.text import quoted
from ros2_mcp.ops.measure.checks.check import Check
from ros2_mcp.ops.measure.diagnostics import Diagnostic
from ros2_mcp.ops.measure.evidence import Evidence, only
from ros2_mcp.ops.measure.findings import Finding

_IDLE = frozenset({"inactive", "unconfigured", "finalized", "errorprocessing", "not active", "not configured"})
"""States in which lifecycle nodes, controllers and hardware components do nothing."""
_SAYS_IDLE = re.compile(r"\b(inactive|unconfigured|not (active|configured))\b", re.IGNORECASE)
"""Matches messages such as "Managed nodes are inactive", which Nav2's lifecycle manager sends at level OK."""
_SAYS_NONE = re.compile(r"\b(no|none|0|zero)\b[^.,;]*\b(inactive|unconfigured)\b", re.IGNORECASE)
_MOST_PARTS = 6


def _find(evidence: Evidence) -> Iterator[Finding]:
    """Report faults; the node is taken from the component's name, by convention (`diagnostic_updater`) `lidar:
    status`.
    """
    nodes = {*(evidence.graph.nodes or ()), *evidence.graph.left.nodes}
    known = {str(one["name"]) for control in (evidence.ros2_control or {}).values() for one in control.controllers}
    for row in evidence.diagnostics.rows:
        node = row.name.partition(":")[0].strip("/ ")
        cause = only([name for name in nodes if name.strip("/") == node or name.endswith(f"/{node}")])
        if row.level != "OK":
            severity = "critical" if row.level == "ERROR" else "warning"
            problem = f"Diagnostics report {row.level}: {quoted(row.message)}."
            yield Finding(severity, row.name, problem, "Check its values.", cause)
        elif idle := _idle_parts(row, known):
            problem = f"Diagnostics report OK, but an inactive part: {'; '.join(idle[:_MOST_PARTS])}."
            yield Finding("warning", row.name, problem, "Activate the part, if it is needed.", cause)
    for row in () if evidence.is_live else evidence.diagnostics.past:  # recorded faults that have ended since
        problem = f"Diagnostics reported {row.level} at {row.received_at}: {quoted(row.message)}."
        yield Finding("warning", row.name, problem, "It has improved since.")


def _idle_parts(row: Diagnostic, judged: set[str]) -> list[str]:
    """Return the message or the values that name an inactive part, without the controllers in `judged`: these have a
    check of their own.
    """
    said = _SAYS_IDLE.search(row.message) and not _SAYS_NONE.search(row.message)
    values = [
        f"{quoted(key)} is {quoted(value.strip())}"
        for key, value in row.values.items()
        if isinstance(value, str) and value.strip().lower() in _IDLE and key not in judged
    ]
    return [*([quoted(row.message)] if said else []), *values]


CHECK = Check((), _find)
