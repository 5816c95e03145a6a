"""The goals that this server has sent, and must be able to cancel."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from time import monotonic


@dataclass(frozen=True, slots=True)
class SentGoal:
    """A goal that this server sent and that has not been seen to end."""

    goal_id: str
    action: str
    action_type: str
    sent_at: float
    is_accepted: bool = False


class SentGoals:
    """The goals that this server sent: the last `most`, and which of them have not been seen to end."""

    def __init__(self, most: int = 1000) -> None:
        self._most = most
        self._ids: dict[str, None] = {}
        self._open: dict[str, SentGoal] = {}

    def __contains__(self, goal_id: str) -> bool:
        return goal_id in self._ids

    def sent(self, goal_id: str, action: str, action_type: str) -> None:
        """Notes a goal just before it is sent."""
        if len(self._ids) >= self._most:
            oldest = next(iter(self._ids))
            del self._ids[oldest]
            self.ended(oldest)
        self._ids[goal_id] = None
        self._open[goal_id] = SentGoal(goal_id, action, action_type, monotonic())

    def accepted(self, goal_id: str) -> None:
        """Notes that its server has taken it."""
        if goal_id in self._open:
            self._open[goal_id] = replace(self._open[goal_id], is_accepted=True)

    def is_on_its_way(self, goal_id: str) -> bool:
        """Whether its server has not said yet that it takes it, so that it may know nothing of it."""
        return goal_id in self._open and not self._open[goal_id].is_accepted

    def ended(self, goal_id: str) -> None:
        """Forgets a goal that ended or was not accepted."""
        self._open.pop(goal_id, None)

    @property
    def open(self) -> Mapping[str, SentGoal]:
        """The goals by their ids."""
        return dict(self._open)
