"""Joint states of several publishers that contradict each other: a joint's position alternates between messages."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

from ros2_mcp.model.errors import BadData
from ros2_mcp.model.samples import Sample
from ros2_mcp.ops.sources.source import Stream

_FAR = 0.02
"""Least change that counts as a jump, in rad or m: more than noise, and less than publishers that disagree differ."""
_LEAST_TURNS = 4
"""Least number of reversals, back and forth twice: a moving joint reverses once, and a vibrating one not at every
message."""
_SHARE = 0.3
"""Least share of reversals among the messages of a joint, if each publisher sends at least a third of them."""


class Rivals:
    """Finds the joints of one topic whose positions jump back and forth from message to message."""

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
        """The joints with contradicting positions, and the largest jump of each in rad or m."""
        return {
            name: self._farthest[name]
            for name, turns in self._turns.items()
            if turns >= max(_LEAST_TURNS, _SHARE * self._told[name])
        }

    def add(self, samples: Sequence[Sample]) -> None:
        """Add messages, in the order of time, including replayed messages."""
        for sample in samples:
            try:
                message: Any = self._stream.codec.decode(self._stream.type, sample.data)
            except BadData:
                continue  # reported in the topic's row
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
