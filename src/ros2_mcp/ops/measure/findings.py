"""Findings of a health check, combined by cause: a lidar that is switched off is one fault, not four."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Literal

from ros2_mcp.model.text import named
from ros2_mcp.ops.results.results import HIDDEN

Severity = Literal["critical", "warning"]

_MOST_JOINED = 6
"""The most findings combined in one sentence; a node may publish a hundred topics, which the table lists."""


@dataclass(frozen=True, slots=True)
class Finding:
    """A fault and its remedy. Findings with the same `cause`, the name of a node, are combined."""

    severity: Severity
    subject: str
    problem: str
    recommendation: str
    cause: str = field(default="", metadata=HIDDEN)
    covers: Sequence[str] = field(default=(), metadata=HIDDEN)
    """Nodes and topics whose own findings are consequences of this finding and are omitted."""


def joined(findings: Sequence[Finding]) -> list[Finding]:
    """Return the findings, critical findings first; findings with the same cause are combined."""
    covered = {name for finding in findings for name in finding.covers}
    findings = [one for one in findings if one.covers or not {one.cause, one.subject} & covered]
    by_cause: dict[str, list[Finding]] = {}
    for number, finding in enumerate(sorted(findings, key=lambda finding: finding.severity)):
        by_cause.setdefault(finding.cause or f"#{number}", []).append(finding)
    return [group[0] if len(group) == 1 else _as_one(group) for group in by_cause.values()]


def _as_one(findings: Sequence[Finding]) -> Finding:
    worst, cause = findings[0], findings[0].cause
    told = [
        finding.problem if finding.subject == cause else f"{named(finding.subject)}: {finding.problem}"
        for finding in findings[:_MOST_JOINED]
    ]
    more = len(findings) - _MOST_JOINED
    told += [f"{more} more topics of this node have a problem."] if more > 0 else []
    return Finding(worst.severity, cause, " ".join(told), worst.recommendation, cause)
