"""The interface of a controller. A controller decides about a motion. It is pure: it needs neither ROS nor a particular
system.

The runner (`motion.py`) passes it the messages of its topics and publishes the velocities that it returns.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple, Protocol

Velocity = Mapping[str, float]
"""Numbers of a velocity command by name, such as `linear.x` (m/s) and `angular.z` (rad/s); the others are 0."""


class Feed(NamedTuple):
    """A topic that a controller uses, and the controller's name for it (`role`)."""

    role: str
    topic: str
    type: str


class Controller(Protocol):
    """The decisions of one motion. Times are monotonic, in s; a controller uses no other clock.

    `feeds` are the topics that it uses. When it has ended, `outcome` is a word for what ended it, such as
    `reached`, and `why` a sentence.
    """

    feeds: Sequence[Feed]
    outcome: str
    why: str

    def awaits(self) -> str:
        """Return in words what has not been received that it needs to begin, as "no message came from /odom"; "" if it
        can begin.
        """
        ...

    def hear(self, role: str, message: Any, now: float, from_before_s: float | None = None) -> None:
        """Take in a message of one of its feeds, as rclpy decodes it, its time of reception, and its age if it was sent
        before the subscription.

        If it raises, the message is ignored.
        """
        ...

    def late_in_s(self, now: float) -> float:
        """Return in how many seconds a feed is late if nothing more comes; `step` is called then."""
        ...

    def step(self, now: float) -> Velocity | None:
        """Return the velocity to command now; None when it has ended.

        Called at least every 0.01 s, once it can begin.
        """
        ...

    def report(self) -> Mapping[str, object]:
        """Return the current state of the motion as JSON, for progress and for its end."""
        ...


Make = Callable[[Mapping[str, Any]], Controller]
"""Makes a controller from the server's JSON.

Raises `KeyError`, `TypeError` or `ValueError` if it has another structure.
"""
