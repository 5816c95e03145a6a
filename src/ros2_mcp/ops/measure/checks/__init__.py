"""The checks for faults of a robot: each in a file of its own, with the evidence that it needs and a function that
finds the fault.

A module of this package is found automatically. It has `CHECK = Check(needs, find)`: `needs` are the parts of the
evidence read for it, besides the graph, the flows and the diagnostics, which are always present; `find` yields a
`Finding` for each fault. A check is skipped if one of its parts could not be read.
"""

from __future__ import annotations

import pkgutil
from collections.abc import Sequence
from importlib import import_module

from ros2_mcp.ops.measure.checks.check import Check
from ros2_mcp.ops.measure.evidence import Evidence, Need
from ros2_mcp.ops.measure.findings import Finding

__all__ = ["CHECKS", "NEEDS", "findings_in"]

CHECKS: Sequence[Check] = [
    module.CHECK
    for found in pkgutil.iter_modules(__path__)
    if hasattr(module := import_module(f"{__name__}.{found.name}"), "CHECK")
]
"""All checks, in the order of their file names."""
NEEDS: frozenset[Need] = frozenset(need for check in CHECKS for need in check.needs)
"""All parts of the evidence that checks need."""


def findings_in(evidence: Evidence) -> list[Finding]:
    """Return the findings of all checks, by their `place`; checks whose evidence was not read are skipped."""
    return [
        finding
        for check in sorted(CHECKS, key=lambda check: check.place)
        if all(getattr(evidence, need) is not None for need in check.needs)
        for finding in check.find(evidence)
    ]
