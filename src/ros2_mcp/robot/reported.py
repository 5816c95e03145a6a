"""What has reported the robot's motion in this session, so that what falls silent is missed."""

from __future__ import annotations

from collections.abc import Collection, Sequence

_MOST = 1000
"""Joints of each topic, and topics: more than any robot has. Beyond, no more are noted."""


class Reported:
    """The joints that each topic of joint states has told of."""

    def __init__(self) -> None:
        self._joints: dict[str, dict[str, None]] = {}

    def note_joints(self, topic: str, joints: Collection[str]) -> None:
        """Notes that a topic told where these joints are."""
        if topic in self._joints or len(self._joints) < _MOST:
            known = self._joints.setdefault(topic, {})
            known.update(dict.fromkeys([*joints][: max(0, _MOST - len(known))]))

    def joints(self, topic: str) -> Sequence[str]:
        """Those that it ever told of."""
        return list(self._joints.get(topic, ()))
