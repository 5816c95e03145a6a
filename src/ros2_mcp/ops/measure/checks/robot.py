"""Further faults found by `ros2_robot`: joints that are not reported, a low battery, faults, a lost localisation."""

from __future__ import annotations

from collections.abc import Iterator

from ros2_mcp.ops.measure.checks.check import LAST, Check
from ros2_mcp.ops.measure.evidence import Evidence
from ros2_mcp.ops.measure.findings import Finding


def _find(evidence: Evidence) -> Iterator[Finding]:
    for problem in evidence.robot or ():
        yield Finding("warning", "robot", problem, "ros2_robot shows the robot as a whole.")


CHECK = Check(("robot",), _find, place=LAST)
