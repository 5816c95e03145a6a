"""A recording without messages: nothing can be judged."""

from __future__ import annotations

from collections.abc import Iterator

from ros2_mcp.ops.measure.checks.check import FIRST, Check
from ros2_mcp.ops.measure.evidence import Evidence
from ros2_mcp.ops.measure.findings import Finding


def _find(evidence: Evidence) -> Iterator[Finding]:
    if evidence.graph.nodes is None and not evidence.graph.topics:  # nodes are None for a recording
        problem = "The recording has no messages, so nothing can be judged."
        yield Finding("warning", evidence.source_title, problem, "Record again.")


CHECK = Check((), _find, place=FIRST)
