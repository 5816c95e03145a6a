"""Faults of Nav2 as found by `ros2_nav_check`, combined: a stack that is down is one fault."""

from __future__ import annotations

from collections.abc import Iterator

from ros2_mcp.ops.measure.checks.check import FIRST, Check
from ros2_mcp.ops.measure.evidence import Evidence
from ros2_mcp.ops.measure.findings import Finding
from ros2_mcp.ops.navigation.checks.check import CHAIN, LOCALISER, MAP, SERVERS
from ros2_mcp.ops.navigation.evidence import RANKS

_PLACES = (LOCALISER, SERVERS, CHAIN, MAP)
"""The places of faults reported here: clocks, sensors and frames have their own checks, and settings are no fault."""


def _find(evidence: Evidence) -> Iterator[Finding]:
    for found in evidence.navigation or ():
        if found.rank != RANKS[0] or found.place not in _PLACES:
            continue
        is_down = found.place in (LOCALISER, SERVERS)
        covers = [found.subject, *found.covers] if is_down else ()
        severity = "critical" if is_down else "warning"
        yield Finding(severity, found.subject, str(found), found.remedy, covers=covers)


CHECK = Check(("navigation",), _find, place=FIRST)
