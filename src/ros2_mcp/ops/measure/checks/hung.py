"""No message is received from the robot, and none of its nodes answers."""

from __future__ import annotations

from collections.abc import Iterator

from ros2_mcp.model.text import listed
from ros2_mcp.ops.measure.checks.check import FIRST, Check
from ros2_mcp.ops.measure.evidence import MAX_NAMES, Evidence
from ros2_mcp.ops.measure.findings import Finding


def _find(evidence: Evidence) -> Iterator[Finding]:
    if evidence.hung:
        who = f"one of {listed(evidence.hung, MAX_NAMES)} answers."
        problem = f"Nothing came on any topic, and n{who}" if evidence.expected.check_rates else f"N{who}"
        advice = "Check whether the robot is switched on, connected and not hanging."
        yield Finding("critical", "robot", problem, advice)


CHECK = Check((), _find, place=FIRST)
