"""A condition that is asked of the messages of one topic beside the robot, and what of them is told."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import Any

from ros2_mcp_common.language.conditions import Condition, condition
from ros2_mcp_common.language.field_types import Types
from ros2_mcp_common.language.paths import FieldPath, parse

# Of texts and fields that are told to the server: a condition is about few, and a name is short. Chosen.
_MOST_CHARACTERS, _MOST_FIELDS = 200, 16


class Asking:
    """One condition: `ask` it of each message; `is_met` stays so once it was met.

    `part` gives what of a message it is about, such as the feedback in the message that carries it; None for a message
    that it is not about.
    """

    def __init__(
        self, types: Types, type_name: str, text: str, part: Callable[[Any], Any] = lambda message: message
    ) -> None:
        self._condition: Condition = condition(types, type_name, text)
        single = [parse(types, type_name, path) for path in self._condition.fields]
        self._shown: list[FieldPath] = [path for path in single if not path.is_list and not path.type.is_message]
        self._part = part
        self._last: Any = None
        self.is_met = False
        self.looked_at = 0
        self.undecided = 0

    def ask(self, message: Any) -> bool:
        """Whether it was met by this message, or by one before."""
        asked = self._part(message)
        if asked is None or self.is_met:
            return self.is_met
        self.looked_at += 1
        self._last = asked
        answer = self._condition.holds(asked)
        self.undecided += answer is None
        self.is_met = bool(answer)
        return self.is_met

    def report(self) -> Mapping[str, object]:
        """How many messages were looked at, and the values of the last one, which met it if one did; as JSON."""
        return {
            "met": self.is_met,
            "looked_at": self.looked_at,
            "undecided": self.undecided,
            "why_undecided": self._condition.why_undecided(self._last) if self._last is not None else "",
            "values": self._values() if self._last is not None else {},
        }

    def _values(self) -> Mapping[str, object]:
        found: dict[str, object] = {}
        for path in self._shown[:_MOST_FIELDS]:
            try:
                found[path.path] = _as_json(path.value_in(self._last))
            except ValueError:  # a list is too short
                found[path.path] = None
        return {**found, **self._condition.values(self._last)}


def _as_json(value: Any) -> object:
    if isinstance(value, float) and not math.isfinite(value):
        return str(value)
    return value[:_MOST_CHARACTERS] if isinstance(value, str) else value
