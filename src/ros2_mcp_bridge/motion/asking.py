"""A condition that is evaluated in the bridge on the messages of one topic, and its report."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import Any

from ros2_mcp_common.language.conditions import Condition, condition
from ros2_mcp_common.language.field_types import Types
from ros2_mcp_common.language.paths import FieldPath, parse

# The longest string, and the most fields, in a report: a condition is on few fields, and a name is short.
_MOST_CHARACTERS, _MOST_FIELDS = 200, 16


class Asking:
    """One condition: call `ask` with each message; `is_met` stays True once it was met.

    `part` returns the part of a message that the condition is about, such as the feedback in a feedback message; None
    for a message that it is not about.
    """

    def __init__(
        self, types: Types, type_name: str, text: str, part: Callable[[Any], Any] = lambda message: message
    ) -> None:
        self._condition: Condition = condition(types, type_name, text)
        single = [parse(types, type_name, path) for path in self._condition.fields]
        self._shown: list[FieldPath] = [path for path in single if not path.is_list and not path.type.is_message]
        self._part = part
        self._last: Any = None
        self._from_before_s: float | None = None
        self.is_met = False
        self.looked_at = 0
        self.undecided = 0

    def ask(self, message: Any, from_before_s: float | None = None) -> bool:
        """Evaluate the condition on a message. Return whether it is met by this message, or was by an earlier one.
        `from_before_s` is the age of a message that was sent before the subscription.
        """
        asked = self._part(message)
        if asked is None or self.is_met:
            return self.is_met
        self.looked_at += 1
        self._last, self._from_before_s = asked, from_before_s
        answer = self._condition.holds(asked)
        self.undecided += answer is None
        self.is_met = bool(answer)
        return self.is_met

    def report(self) -> Mapping[str, object]:
        """Return as JSON how many messages were evaluated, and the values of the last message: the message that met the
        condition, if any did. `from_before_s` is its age if it was sent before the subscription.
        """
        return {
            "met": self.is_met,
            "looked_at": self.looked_at,
            "undecided": self.undecided,
            "why_undecided": self._condition.why_undecided(self._last) if self._last is not None else "",
            "values": self._values() if self._last is not None else {},
            "from_before_s": None if self._from_before_s is None else round(self._from_before_s, 3),
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
