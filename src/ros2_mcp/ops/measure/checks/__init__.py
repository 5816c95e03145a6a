"""What can be wrong with a robot: one small file for each check, which says what it reads and yields findings.

A module here is found by itself. It has `CHECK = Check(needs, find)`: `needs` are the parts of the evidence that are
read for it, beside the graph, the flows and the diagnostics, which are always there; `find` yields a `Finding` for each
fault, and none where all is well. A check whose parts could not be read is not run.
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
"""Every check, by the names of their files."""
NEEDS: frozenset[Need] = frozenset(need for check in CHECKS for need in check.needs)
"""What has to be read for all of them."""


def findings_in(evidence: Evidence) -> list[Finding]:
    """What all checks find, in their order; those of which something could not be read find nothing."""
    return [
        finding
        for check in sorted(CHECKS, key=lambda check: check.place)
        if all(getattr(evidence, need) is not None for need in check.needs)
        for finding in check.find(evidence)
    ]
