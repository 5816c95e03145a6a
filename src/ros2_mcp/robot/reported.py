"""What has reported the robot's motion in this session, so that it is missed once it falls silent."""

from __future__ import annotations

from collections.abc import Collection, Sequence

_MOST = 1000
"""Joints of each topic, and topics: more than any robot has. No more are noted."""


class Reported:
    """The joints that each topic of joint states has reported."""

    def __init__(self) -> None:
        self._joints: dict[str, dict[str, None]] = {}

    def note_joints(self, topic: str, joints: Collection[str]) -> None:
        """Notes that a topic reported these joints."""
        if topic in self._joints or len(self._joints) < _MOST:
            known = self._joints.setdefault(topic, {})
            known.update(dict.fromkeys([*joints][: max(0, _MOST - len(known))]))

    def joints(self, topic: str) -> Sequence[str]:
        """All joints that the topic has ever reported."""
        return list(self._joints.get(topic, ()))
