"""Moving at one velocity until a condition on a topic holds. Pure: times are arguments, monotonic, in s.

The robot stops while that topic, or odometry, is late, and the motion ends if the topic stays silent: the robot must
not drive on without feedback.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

from ros2_mcp_bridge.motion.asking import Asking
from ros2_mcp_bridge.motion.controller import Feed, Velocity
from ros2_mcp_bridge.motion.drive import SILENT_S, Beat, late_in_s
from ros2_mcp_bridge.ros import interfaces
from ros2_mcp_bridge.ros.message_types import MessageTypes
from ros2_mcp_common.finite import not_finite

# The distance is summed in steps of at least this length, in m, so that noise of odometry does not add up.
STRIDE_M = 0.02
# The messages after which the period of a topic is known. A topic of events need not send any.
FIRST_MESSAGES = 3


class Way:
    """The length of the path that the robot has travelled according to odometry."""

    def __init__(self) -> None:
        self._measured_m = 0.0
        self._at: tuple[float, float, float] | None = None
        self._now: tuple[float, float, float] | None = None

    def hear(self, message: Any) -> None:
        """Take in a nav_msgs/msg/Odometry, or another message with a pose.

        Raise `ValueError` if the position is not finite.
        """
        place = getattr(message.pose, "pose", message.pose).position
        within = "pose.pose.position" if hasattr(message.pose, "pose") else "pose.position"
        if why := not_finite(place, "x", "y", "z", within=within):
            raise ValueError(why)
        now = (float(place.x), float(place.y), float(place.z))
        self._now = now
        if self._at is None:
            self._at = now
        elif (step_m := math.dist(self._at, now)) >= STRIDE_M:
            self._measured_m += step_m
            self._at = now

    def begin(self) -> None:
        """Start to measure from the current position."""
        self._measured_m, self._at = 0.0, self._now

    @property
    def length_m(self) -> float:
        """The length up to now, in m."""
        return self._measured_m + (math.dist(self._at, self._now) if self._at and self._now else 0.0)


class Until:
    """A controller (see `controller.Controller`). `outcome` is `met`, `distance` or `silent`.

    `velocity` has the numbers of the command by name. `may_be_silent` is for a topic that reports only events.
    `odometry` is needed with `max_distance_m`, or if the distance is to be reported.
    """

    def __init__(
        self,
        *,
        topic: Feed,
        asking: Asking,
        velocity: Velocity,
        may_be_silent: bool = False,
        odometry: Feed | None = None,
        max_distance_m: float | None = None,
    ) -> None:
        if not any(velocity.values()) or not all(map(math.isfinite, velocity.values())):
            raise ValueError("a velocity is needed")
        if max_distance_m is not None and odometry is None:
            raise ValueError("a limit of the way needs odometry")
        self.outcome = ""
        self.why = ""
        self.feeds: Sequence[Feed] = [topic, odometry] if odometry else [topic]
        self._asking = asking
        self._velocity = velocity
        self._may_be_silent = may_be_silent
        self._max_distance_m = max_distance_m
        self._beats = {feed.role: Beat(feed.topic) for feed in self.feeds}
        self._way = Way()
        self._began_at: float | None = None
        self._met_at: float | None = None
        self._paused_s = self._elapsed_s = 0.0

    @staticmethod
    def of(asked: Mapping[str, Any]) -> Until:
        """Make a controller from the server's JSON.

        Raise `KeyError`, `TypeError` or `ValueError` if that is not possible.
        """
        types = MessageTypes(interfaces.load(asked["type"]))
        odometry, most = asked.get("odometry"), asked.get("max_distance_m")
        return Until(
            topic=Feed("condition", asked["topic"], asked["type"]),
            asking=Asking(types, types.name, asked["condition"]),
            velocity={name: float(value) for name, value in asked["velocity"].items()},
            may_be_silent=bool(asked.get("may_be_silent")),
            odometry=Feed("odometry", odometry["topic"], odometry["type"]) if odometry else None,
            max_distance_m=None if most is None else float(most),
        )

    def awaits(self) -> str:
        """Return from which topics too few messages have come; "" if the condition is met already."""
        if self._asking.is_met:
            return ""
        return " and ".join(
            beat.awaited
            for role, beat in self._beats.items()
            if beat.count < FIRST_MESSAGES and not (role == "condition" and self._may_be_silent)
        )

    def late_in_s(self, now: float) -> float:
        """See `controller.Controller`."""
        return late_in_s(self._beats.values(), now)

    def hear(self, role: str, message: Any, now: float, from_before_s: float | None = None) -> None:
        """Take in odometry, or a message on which to evaluate the condition."""
        if role == "odometry":
            try:
                self._way.hear(message)
            except ValueError as error:
                self._beats[role].problem = str(error)
                raise
        elif self._asking.ask(message, from_before_s) and self._met_at is None:
            self._met_at = now
        self._beats[role].heard(now)

    def step(self, now: float) -> Velocity | None:
        """Return the velocity, or zeros while a topic is late; None when it has ended."""
        if self._began_at is None:
            self._began_at = now
            self._way.begin()
        seconds, self._elapsed_s = now - self._began_at - self._elapsed_s, now - self._began_at
        if self._asking.is_met:
            return self._end("met", "")
        if self._max_distance_m is not None and self._way.length_m >= self._max_distance_m:
            return self._end(
                "distance", f"The limit of {self._max_distance_m:g} m was reached; the condition was not met."
            )
        late = [beat for role, beat in self._beats.items() if self._counts(role) and beat.late_s(now) > 0]
        for beat in late:
            if beat.late_s(now) > SILENT_S:
                return self._end("silent", f"{beat.topic} has sent nothing{beat.unusable} for {beat.age_s(now):.2f} s.")
        if late:
            self._paused_s += seconds
            return dict.fromkeys(self._velocity, 0.0)
        return self._velocity

    def report(self) -> Mapping[str, object]:
        """Return the report of the condition, the distance in m (None without odometry), and times in s."""
        return {
            **self._asking.report(),
            "distance_m": round(self._way.length_m, 4) if "odometry" in self._beats else None,
            "elapsed_s": round(self._elapsed_s, 3),
            "paused_s": round(self._paused_s, 2),
        }

    def _counts(self, role: str) -> bool:
        return not (role == "condition" and self._may_be_silent)

    def _end(self, outcome: str, why: str) -> None:
        self.outcome, self.why = outcome, why
