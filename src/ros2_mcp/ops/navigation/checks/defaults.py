"""Parameter files that were never applied: all values of a node are Nav2's defaults: these fit no real robot."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from typing import Any

from ros2_mcp.model.text import counted, listed, named
from ros2_mcp.ops.navigation.checks.check import TUNING, NavCheck
from ros2_mcp.ops.navigation.evidence import NavEvidence, NavFinding, is_of_role

_DEFAULTS: Mapping[str, Mapping[str, Any]] = {
    "local_costmap": {
        "width": 5,
        "height": 5,
        "resolution": 0.1,
        "robot_radius": 0.1,
        "footprint": "[]",
        "rolling_window": False,
    },
    "global_costmap": {"width": 5, "height": 5, "resolution": 0.1, "robot_radius": 0.1, "footprint": "[]"},
    "controller_server": {
        "controller_frequency": 20.0,
        "min_x_velocity_threshold": 0.0001,
        "min_theta_velocity_threshold": 0.0001,
        "progress_checker.required_movement_radius": 0.5,
        "progress_checker.movement_time_allowance": 10.0,
        "general_goal_checker.xy_goal_tolerance": 0.25,
    },
    "planner_server": {"expected_planner_frequency": 1.0, "GridBased.tolerance": 0.5, "GridBased.use_astar": False},
}
_LEAST = 4
_ALONE = ("local_costmap", "global_costmap")
"""Nodes whose defaults are never intended: 5 × 5 m, cells of 0.1 m, a robot of 0.1 m. Other nodes are reported only if
their name differs from the usual one."""


def _find(evidence: NavEvidence) -> Iterator[NavFinding]:
    for role, defaults in _DEFAULTS.items():
        for node in evidence.of_role(role):
            values = (evidence.parameters or {}).get(node, {})
            known = {name: value for name, value in defaults.items() if name in values}
            if len(known) < min(_LEAST, len(defaults)) or not all(
                _same(values[name], value) for name, value in known.items()
            ):
                continue
            last = node.rpartition("/")[2]
            is_renamed = last != role and is_of_role(node, role)
            if role not in _ALONE and not is_renamed:
                continue
            named_so = f"Its section in the file is probably called {role}. " if is_renamed else ""
            yield NavFinding(
                rank="stops some goals",
                subject=node,
                cause=f"{named(node)} has only default values: its parameter file was probably never applied.",
                proof=f"{named_so}{counted(len(known), 'value')} checked, all equal to Nav2's defaults: "
                f"{listed([f'{name} = {values[name]}' for name in known], 3)}.",
                remedy=f"Give the file's section the name of the node ({last}), or the node the name {role}.",
            )


def _same(value: Any, default: Any) -> bool:
    if isinstance(value, (int, float)) and isinstance(default, (int, float)):
        return math.isclose(value, default, rel_tol=1e-9)
    return value == default or (default == "[]" and value in ("", "[]"))


CHECK = NavCheck(("parameters",), _find, TUNING)
