"""Start times of trajectories: a stamp near the present is set to zero (start on arrival), others are refused.

The rules are in `policy/stamps.py`.
"""

from __future__ import annotations

import copy
from collections.abc import Callable
from dataclasses import replace
from time import monotonic
from typing import Any, cast

from ros2_mcp.model.commands import Publish, Repeat, SendGoal, ServiceCall
from ros2_mcp.model.errors import BadValue
from ros2_mcp.robot.prepared import Prepared
from ros2_mcp_common.policy import stamps

_REMEMBERED_S = 660.0
"""The time for which a stamp is remembered, in s: an approval waits up to 600 s for a person, and is valid for 60 s
(`guard.approvals`)."""
_MOST = 256
_NOTE = "The stamp of the trajectory was set to zero: it begins when it arrives."

Key = tuple[str, str, str]


class Beginnings:
    """The stamps that were within a second of the present at their first call. The call is repeated once a person has
    approved it, when its stamp is old.
    """

    def __init__(self, now: Callable[[], float] = monotonic) -> None:
        self._now = now
        self._honest: dict[Key, float] = {}

    async def settle(self, prepared: Prepared[Any], now_ns: Callable[[], int]) -> Prepared[Any]:
        """Return the command with each such stamp set to zero; raises `BadValue` for a stamp of any other time."""
        command = prepared.command
        if not isinstance(command, Publish | Repeat | SendGoal | ServiceCall) or not _has_stamp(command.value):
            return prepared
        full = await prepared.full()
        full = full["goal"] if isinstance(command, SendGoal) else full
        given = [(path, stamps.time_ns(stamp)) for path, stamp in stamps.acting_stamps(full)]
        if not any(at_ns for _, at_ns in given):
            return prepared
        key = command.principal.name, command.name, repr(given)
        self._honest = {key: until for key, until in self._honest.items() if until > self._now()}
        if key not in self._honest:
            if problem := stamps.problem(full, now_ns()):
                raise BadValue(given[0][0], f"{problem}; nothing was sent.", "Leave the stamp out.")
            if len(self._honest) >= _MOST:
                del self._honest[next(iter(self._honest))]
            self._honest[key] = self._now() + _REMEMBERED_S
        prepared.session.notes.append(_NOTE)
        value: Any = copy.deepcopy(command.value)
        _zero(value)
        return prepared.changed(replace(command, value=value))


def _has_stamp(value: object) -> bool:
    """Return whether a value may have the stamp of a trajectory. A quick test, because every command takes it."""
    if isinstance(value, dict):
        fields = cast("dict[str, Any]", value)
        header = fields.get("header")
        if "points" in fields and isinstance(header, dict) and "stamp" in header:
            return True
        return any(map(_has_stamp, fields.values()))
    elements = cast("list[Any]", value) if isinstance(value, list) else []
    return bool(elements) and isinstance(elements[0], dict) and any(map(_has_stamp, elements))


def _zero(value: Any) -> None:
    """Remove the stamp of each trajectory from a value; its default is zero."""
    if isinstance(value, dict):
        fields = cast("dict[str, Any]", value)
        header = fields.get("header")
        if "points" in fields and isinstance(header, dict):
            cast("dict[str, Any]", header).pop("stamp", None)
        for below in fields.values():
            _zero(below)
    elif isinstance(value, list) and value and isinstance(value[0], dict):
        for each in cast("list[Any]", value):
            _zero(each)
