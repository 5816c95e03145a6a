"""Why a robot with Nav2 does not navigate, as `ros2_nav_check` says, once: a stack that is down is one fault."""

from __future__ import annotations

from collections.abc import Iterator

from ros2_mcp.ops.measure.checks.check import FIRST, Check
from ros2_mcp.ops.measure.evidence import Evidence
from ros2_mcp.ops.measure.findings import Finding
from ros2_mcp.ops.navigation.checks.check import CHAIN, LOCALISER, MAP, SERVERS
from ros2_mcp.ops.navigation.evidence import RANKS

_PLACES = (LOCALISER, SERVERS, CHAIN, MAP)
"""Clocks, sensors and frames have checks of their own here; settings are no state of a robot."""


def _find(evidence: Evidence) -> Iterator[Finding]:
    for found in evidence.navigation or ():
        if found.rank != RANKS[0] or found.place not in _PLACES:
            continue
        is_down = found.place in (LOCALISER, SERVERS)
        covers = [found.subject, *found.covers] if is_down else ()
        severity = "critical" if is_down else "warning"
        yield Finding(severity, found.subject, str(found), found.remedy, covers=covers)


CHECK = Check(("navigation",), _find, place=FIRST)
