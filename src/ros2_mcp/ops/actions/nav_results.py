"""Describe results of Nav2's actions beyond the state of the goal: missed waypoints, and error codes."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, cast

from ros2_mcp.model.nav2 import in_words
from ros2_mcp.model.text import counted, quoted

_OF_NAV2 = "nav2_msgs/action/"
_MOST_NAMED = 5
_NOT_REACHED = {2: "skipped", 3: "failed"}
"""nav2_msgs/msg/WaypointStatus."""


def told_by_result(action_type: str, result: Mapping[str, Any] | None) -> str:
    """Return a sentence on a result of Nav2: missed waypoints first, then its error code. Empty for other
    actions, and if all went well.
    """
    if not result or not action_type.startswith(_OF_NAV2):
        return ""
    missed = _missed(result)
    code, text = int(result.get("error_code") or 0), str(result.get("error_msg") or "")
    told: list[str] = []
    if missed:
        more = f" and {len(missed) - _MOST_NAMED} more" if len(missed) > _MOST_NAMED else ""
        told.append(f"MISSED {counted(len(missed), 'waypoint')}: {', '.join(missed[:_MOST_NAMED])}{more}.")
    if code:
        told.append(f"{in_words(code)}{f': {quoted(text)}' if text else ''}.")
    return " ".join(told)


def _missed(result: Mapping[str, Any]) -> list[str]:
    """Return the waypoints that were not reached, as elements of the goal's `poses`, each with any error code."""
    found: list[str] = []
    for one in cast("Sequence[Any]", result.get("missed_waypoints") or ()):
        if isinstance(one, Mapping):
            entry = cast("Mapping[str, Any]", one)
            code = in_words(int(entry.get("error_code") or 0))
            found.append(f"poses[{entry.get('index')}]{f' ({code})' if code else ''}")
        else:  # Humble: only the indices
            found.append(f"poses[{one}]")
    for one in cast("Sequence[Any]", result.get("waypoint_statuses") or ()):
        entry: Mapping[str, Any] = cast("Mapping[str, Any]", one) if isinstance(one, Mapping) else {}
        how = _NOT_REACHED.get(int(entry.get("waypoint_status") or 0))
        if how:
            code = in_words(int(entry.get("error_code") or 0))
            found.append(f"poses[{entry.get('waypoint_index')}] {how}{f' ({code})' if code else ''}")
    return found
