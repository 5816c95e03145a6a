"""Publishers of joint states that contradict each other: subscribers see the joints jump."""

from __future__ import annotations

from collections.abc import Iterator

from ros2_mcp.model.text import listed, named
from ros2_mcp.ops.measure.checks.check import Check
from ros2_mcp.ops.measure.evidence import MAX_NAMES, Evidence
from ros2_mcp.ops.measure.findings import Finding

_MOST_JOINTS = 4


def _find(evidence: Evidence) -> Iterator[Finding]:
    for topic, rivals in evidence.rivals.items():
        if joints := rivals.joints:
            far = max(joints.values())
            who = listed(sorted(rivals.publishers), MAX_NAMES)
            told = ", ".join(map(named, list(joints)[:_MOST_JOINTS]))
            problem = f"{who} contradict each other: {told} jumps back and forth by up to {far:.3g} rad or m."
            advice = "Stop or remap all publishers but one, or let each publish other joints."
            yield Finding("warning", topic, problem, advice)


CHECK = Check((), _find)
