"""Checks why a robot with Nav2 does not navigate: one module for each kind of cause.

Modules of this package are discovered automatically. Each defines `CHECK = NavCheck(needs, find, place)`: `needs` are
the parts of the evidence that it reads, and `find` yields a `NavFinding` for each cause. A finding needs evidence that
it is a cause: conditions that also occur on robots that drive are not findings.
"""

from __future__ import annotations

import pkgutil
from collections.abc import Collection, Sequence
from dataclasses import replace
from importlib import import_module

from ros2_mcp.ops.navigation.checks.busy import busy_in, without_what_is_late
from ros2_mcp.ops.navigation.checks.check import TUNING, NavCheck
from ros2_mcp.ops.navigation.evidence import RANKS, NavEvidence, NavFinding, Need

__all__ = ["CHECKS", "NEEDS", "nav_findings_in", "not_checked"]

CHECKS: dict[str, NavCheck] = {
    found.name: module.CHECK
    for found in pkgutil.iter_modules(__path__)
    if hasattr(module := import_module(f"{__name__}.{found.name}"), "CHECK")
}
"""All checks by module name."""
_NOT_READ: Collection[Need] = ("goal", "probes")
"""The parts of the evidence that there are only if they are asked for."""
NEEDS: frozenset[Need] = frozenset(need for check in CHECKS.values() for need in check.needs)
"""The parts of the evidence that the checks need together."""


def nav_findings_in(evidence: NavEvidence) -> list[NavFinding]:
    """Run all checks; return the findings, the worst rank first, and within a rank in the order of the chain of causes.

    Findings that only follow from another one (its `covers`) are omitted. Without Nav2 there are none.
    """
    if not evidence.is_nav2:
        return []
    covered = set[str]()
    kept: dict[tuple[str, str], NavFinding] = {}
    if busy := busy_in(evidence):
        kept[(busy.subject, busy.cause)] = replace(busy, place=TUNING)
        evidence = without_what_is_late(evidence)
    for check in sorted(CHECKS.values(), key=lambda check: check.place):
        if any(getattr(evidence, need) is None for need in check.needs):
            continue
        for finding in check.find(evidence):
            if finding.subject not in covered:
                kept.setdefault((finding.subject, finding.cause), replace(finding, place=check.place))
                covered.update(finding.covers)
    return sorted(kept.values(), key=lambda finding: RANKS.index(finding.rank))


def not_checked(evidence: NavEvidence) -> Sequence[str]:
    """Return the names of the checks that could not be run because evidence was missing. A goal that was not given, and
    a small motion that was not made, do not count as missing."""
    return [
        name.replace("_", " ")
        for name, check in CHECKS.items()
        if any(getattr(evidence, need) is None for need in check.needs if need not in _NOT_READ)
    ]
