"""Names that several nodes share."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator

from ros2_mcp.model.text import listed
from ros2_mcp.ops.measure.checks.check import Check
from ros2_mcp.ops.measure.evidence import Evidence
from ros2_mcp.ops.measure.findings import Finding

_MAX_SHARED = 12
"""Names that several nodes share: a robot's nodes, so that it is seen whether all of them are there twice."""


def _find(evidence: Evidence) -> Iterator[Finding]:
    shared = {name: count for name, count in Counter(evidence.graph.nodes or ()).items() if count > 1}
    if len(shared) > 1:  # most likely two robots, or one that was started twice: one fault
        problem = f"{len(shared)} names are shared by several nodes each: {listed(list(shared), _MAX_SHARED)}."
        yield Finding("warning", "nodes", problem, "If two robots share this domain, separate them, or stop one.")
    for name, count in shared.items() if len(shared) == 1 else ():
        yield Finding("warning", name, f"{count} nodes have this name.", "Rename or stop all but one.")


CHECK = Check((), _find)
