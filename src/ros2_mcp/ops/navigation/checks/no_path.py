"""A planner that fails again and again: recoveries clear the costmap, so that the goal looks free in between."""

from __future__ import annotations

import re
from collections.abc import Iterator

from ros2_mcp.model.text import named
from ros2_mcp.ops.navigation.checks.check import GOAL, NavCheck
from ros2_mcp.ops.navigation.evidence import NavEvidence, NavFinding, line_age_s, said

_FAILED = r"failed to plan|failed to (create|generate|make) .*(plan|path)|no valid path"
_GOAL = re.compile(r"to (\(-?[\d.]+, -?[\d.]+\))")
_RECENT_S, _LEAST = 60.0, 3
"""One failure is followed by a recovery and a new plan; three within a minute are no chance."""


def _find(evidence: NavEvidence) -> Iterator[NavFinding]:
    failed = [
        line
        for line in evidence.lines(_FAILED, "planner_server")
        if (age_s := line_age_s(evidence, line)) is not None and age_s < _RECENT_S
    ]
    if len(failed) < _LEAST:
        return
    goal = _GOAL.search(failed[-1].text)
    yield NavFinding(
        rank="stops some goals",
        subject=failed[-1].node,
        cause=f"{named(failed[-1].node)} finds no path{f' to {goal[1]}' if goal else ''}, again and again.",
        proof=f"{len(failed)} failures within {_RECENT_S:g} s; last, {said(failed[-1])}. Recoveries clear the costmap, "
        "which then looks free until the obstacle is seen again.",
        remedy="Open the way, such as a door, or choose another goal; ros2_nav_preview shows where the way ends.",
    )


CHECK = NavCheck(("log",), _find, GOAL)
