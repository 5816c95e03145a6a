"""What a motion is decided by: a controller, pure, so that it needs neither ROS nor what only some systems have.

The runner (`motion.py`) has it hear topics and publishes what it says.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple, Protocol

Velocity = Mapping[str, float]
"""Numbers of a velocity command by their names, such as `linear.x` (m/s) and `angular.z` (rad/s); the others are 0."""


class Feed(NamedTuple):
    """A topic that a controller hears, and what it calls it."""

    role: str
    topic: str
    type: str


class Controller(Protocol):
    """What decides about one motion. Times are monotonic, in s; it knows no other clock.

    `feeds` are the topics that it hears. As soon as it has ended, `outcome` is a word for what ended it, such as
    `reached`, and `why` a sentence.
    """

    feeds: Sequence[Feed]
    outcome: str
    why: str

    def awaits(self) -> str:
        """What has to be heard before it can begin, in words; "" once it can."""
        ...

    def hear(self, role: str, message: Any, now: float) -> None:
        """A message of one of its feeds, as rclpy decodes it, and when it was received. What it raises is not heard."""
        ...

    def late_in_s(self, now: float) -> float:
        """In how many seconds one of its feeds is late if nothing more comes, so that it is asked again then."""
        ...

    def step(self, now: float) -> Velocity | None:
        """What to command now; None as soon as it has ended. Called every 0.01 s or sooner, first when it can begin."""
        ...

    def report(self) -> Mapping[str, object]:
        """What can be told of it now, as JSON: for progress, and at its end."""
        ...


Make = Callable[[Mapping[str, Any]], Controller]
"""Makes a controller of what the server asks for; raises `KeyError`, `TypeError` or `ValueError` for another shape."""
