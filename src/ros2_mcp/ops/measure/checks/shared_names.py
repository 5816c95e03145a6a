"""Names shared by several nodes."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator

from ros2_mcp.model.text import listed
from ros2_mcp.ops.measure.checks.check import Check
from ros2_mcp.ops.measure.evidence import Evidence
from ros2_mcp.ops.measure.findings import Finding

_MAX_SHARED = 12
"""The most shared names listed: as many as a robot has nodes, so that a robot started twice is recognised."""

_RESTARTED = "If they were killed and started again, the old ones vanish within 20 s: look again then."
"""Middlewares keep a participant that ended without notice for the time of its lease, mostly 20 s."""


def _find(evidence: Evidence) -> Iterator[Finding]:
    shared = {name: count for name, count in Counter(evidence.graph.nodes or ()).items() if count > 1}
    if len(shared) > 1:  # most likely two robots, or one started twice: one fault
        problem = f"{len(shared)} names are shared by several nodes each: {listed(list(shared), _MAX_SHARED)}."
        remedy = f"{_RESTARTED} If two robots share this domain, separate them, or stop one."
        yield Finding("warning", "nodes", problem, remedy)
    for name, count in shared.items() if len(shared) == 1 else ():
        yield Finding(
            "warning", name, f"{count} nodes have this name.", f"{_RESTARTED} Else rename or stop all but one."
        )


CHECK = Check((), _find)
