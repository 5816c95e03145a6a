"""Why a robot with Nav2 does not navigate: one small file for each kind of cause.

A module here is found by itself. It has `CHECK = NavCheck(needs, find, place)`: `needs` are the parts of the evidence
that it judges, `find` yields a `NavFinding` for each cause, and none where all is well. A cause needs evidence that it
is one: what may be so on a robot that drives is no finding.
"""

from __future__ import annotations

import pkgutil
from collections.abc import Sequence
from dataclasses import replace
from importlib import import_module

from ros2_mcp.ops.navigation.checks.busy import busy_in, without_what_is_late
from ros2_mcp.ops.navigation.checks.check import TUNING, NavCheck
from ros2_mcp.ops.navigation.evidence import RANKS, NavEvidence, NavFinding, Need

__all__ = ["CHECKS", "NEEDS", "nav_findings_in", "not_looked_at"]

CHECKS: dict[str, NavCheck] = {
    found.name: module.CHECK
    for found in pkgutil.iter_modules(__path__)
    if hasattr(module := import_module(f"{__name__}.{found.name}"), "CHECK")
}
"""Every check, by the name of its file."""
NEEDS: frozenset[Need] = frozenset(need for check in CHECKS.values() for need in check.needs)
"""What has to be read for all of them."""


def nav_findings_in(evidence: NavEvidence) -> list[NavFinding]:
    """What all checks find: the worst first, and of the same rank what comes first in the chain of causes.

    What only follows from another finding is left out.
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


def not_looked_at(evidence: NavEvidence) -> Sequence[str]:
    """The checks that could not be run, by name."""
    return [
        name.replace("_", " ")
        for name, check in CHECKS.items()
        if any(getattr(evidence, need) is None for need in check.needs if need != "goal")
    ]
