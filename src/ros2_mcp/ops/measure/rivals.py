"""Joint states of several publishers that contradict each other: the same joint here and there in turn."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

from ros2_mcp.model.errors import BadData
from ros2_mcp.model.samples import Sample
from ros2_mcp.ops.sources.source import Stream

_FAR = 0.02
"""rad or m: more than the noise of a joint, and less than what two that disagree tell."""
_LEAST_TURNS = 4
"""There and back twice: a joint that moves turns once, and one that shakes does not turn at every message."""
_SHARE = 0.3
"""Of the messages about a joint, where each publisher sends a third of them at least."""


class Rivals:
    """Which joints jump there and back from message to message, of one topic."""

    def __init__(self, stream: Stream) -> None:
        self.publishers: Sequence[str] = stream.nodes
        self._stream = stream
        self._told: dict[str, int] = {}
        self._last: dict[str, float] = {}
        self._step: dict[str, float] = {}
        self._turns: dict[str, int] = {}
        self._farthest: dict[str, float] = {}

    @property
    def joints(self) -> dict[str, float]:
        """The joints that are told differently, and by how much at most."""
        return {
            name: self._farthest[name]
            for name, turns in self._turns.items()
            if turns >= max(_LEAST_TURNS, _SHARE * self._told[name])
        }

    def add(self, samples: Sequence[Sample]) -> None:
        """Takes in messages, in the order of time; those from before count, too."""
        for sample in samples:
            try:
                message: Any = self._stream.codec.decode(self._stream.type, sample.data)
            except BadData:
                continue  # which the topic's row tells
            for name, position in zip(message.name, message.position, strict=False):
                if math.isfinite(position):
                    self._look_at(str(name), float(position))

    def _look_at(self, name: str, position: float) -> None:
        self._told[name] = self._told.get(name, 0) + 1
        step = position - self._last.get(name, position)
        self._last[name] = position
        if abs(step) > _FAR:
            if step * self._step.get(name, 0.0) < 0:
                self._turns[name] = self._turns.get(name, 0) + 1
            self._farthest[name] = max(self._farthest.get(name, 0.0), abs(step))
        self._step[name] = step if abs(step) > _FAR else 0.0
