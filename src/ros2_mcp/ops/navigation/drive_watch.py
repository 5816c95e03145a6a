"""Observes a robot that navigates: commanded but not moving, stopped by the collision monitor, recovering, driven by a
controller that misses its rate, or on a path that became longer.

Pure: no clock and no ROS. Times are from a steady clock, in s.
"""

from __future__ import annotations

import math
from collections import Counter, deque
from collections.abc import Sequence
from dataclasses import dataclass, field

from ros2_mcp.model.text import named
from ros2_mcp.ops.navigation.checks.collision_monitor import INVALID_SOURCE, Near
from ros2_mcp.ops.navigation.checks.tuning import MISSED

STANDS_MPS, STANDS_RADPS = 0.02, 0.05
"""A base that is slower than this stands: flickering wheel encoders stay below, and no controller drives that slowly
for long."""
_COMMANDED = 0.01
"""A velocity above this (m/s or rad/s) is meant to move the robot."""
_NEW_S = 1.0
"""An older velocity has no effect: bases stop after about 0.5 s without a command."""
_SAID_AFTER_S = 2.0
"""Time until a robot that does not move is reported: a base needs some tenths of a second to begin to move."""
_IDLE_S = 4.0
"""Time without a command until that is reported: a planner needs tenths of a second, and a controller begins at
once."""
_LONGER_M, _LONGER_SHARE, _LONGER_S = 0.8, 0.15, 15.0
"""A path that becomes this much longer at once leads around an obstacle; this is reported for `_LONGER_S`."""
_PLANNED_S = 3.0
"""Until then a longer path is the first one, after an estimate."""
_PROGRESS_M, _NEARER_M = 0.5, 0.1
"""Nav2's own progress checker asks for 0.5 m; the remaining length of the path shows smaller progress."""
_RATE_S, _RATE_KEPT_S = 3.0, 5.0
"""Least time over which a rate is measured, and the time that is looked back: a controller may pause for some tenths of
a second between two paths."""
MONITOR_ACTIONS = {1: "stops", 2: "slows", 3: "slows (approach)", 4: "limits"}
"""Actions of nav2_msgs/msg/CollisionMonitorState, as verbs; 0 means no action."""


@dataclass(slots=True)
class _Link:
    """The last velocity on one topic, and since when it is not 0."""

    speed: float = 0.0
    turn: float = 0.0
    heard_at: float = -math.inf
    since: float = math.inf


@dataclass(slots=True, kw_only=True)
class DriveWatch:
    """Collects what the robot's topics report, and summarises it. `began_at` is the time when the goal was accepted."""

    began_at: float
    recovered: Counter[str] = field(default_factory=Counter[str])
    """Number of starts of each recovery, by name."""
    _links: dict[str, _Link] = field(default_factory=dict[str, _Link])
    _odometry: str = ""
    _speed: tuple[float, float] | None = None
    _stands_since: float = math.inf
    _anchor: tuple[float, float] | None = None
    _progress_at: float = -math.inf
    _monitor: tuple[int, str, float] = (0, "", 0.0)
    _monitor_published: bool = False
    _near: Near | None = None
    _wanted_hz: float = 0.0
    _controller: str = ""
    _sent: deque[tuple[float, int]] = field(default_factory=deque[tuple[float, int]])
    _running: dict[str, float] = field(default_factory=dict[str, float])
    _remaining: float = math.inf
    _nearest: float = math.inf
    _longer: tuple[float, float] = (0.0, -math.inf)

    def commanded(self, topic: str, linear: float, angular: float, now: float) -> None:
        """Take a velocity (m/s, rad/s) from a topic between Nav2 and the base."""
        link = self._links.setdefault(topic, _Link())
        link.speed, link.turn, link.heard_at = linear, angular, now
        is_moving = abs(linear) > _COMMANDED or abs(angular) > _COMMANDED
        link.since = min(link.since, now) if is_moving else math.inf

    def chain(self, topics: Sequence[str]) -> None:
        """Set the topics between Nav2 and the base, in order."""
        for topic in topics:
            self._links.setdefault(topic, _Link())

    def rate(self, topic: str, hz: float) -> None:
        """Set the topic on which the controller publishes, and the rate that it is set to, in Hz."""
        self._controller, self._wanted_hz = topic, hz

    def counted(self, topic: str, received: int, at: float) -> None:
        """Take the number of commands received on a topic so far, and the time of the last command, in s of any clock.

        Call it after `commanded`: only the time in which the controller drives counts.
        """
        if topic != self._controller:
            return
        if self._running or self._links[topic].since == math.inf:
            self._sent.clear()
            return
        self._sent.append((at, received))
        while at - self._sent[0][0] > _RATE_KEPT_S:
            self._sent.popleft()

    def moved(self, topic: str, linear: float, angular: float, at: tuple[float, float] | None, now: float) -> None:
        """Take an odometry message: speeds in m/s and rad/s, and the position in m."""
        self._odometry, self._speed = topic, (linear, angular)
        stands = abs(linear) < STANDS_MPS and abs(angular) < STANDS_RADPS
        self._stands_since = min(self._stands_since, now) if stands else math.inf
        if at is not None and (self._anchor is None or math.dist(self._anchor, at) > _PROGRESS_M):
            self._anchor, self._progress_at = at, now
        if abs(angular) > 2 * STANDS_RADPS and not self._running:
            self._progress_at = now  # turning towards the path is progress, too

    def monitor(self, action: int, polygon: str, now: float) -> None:
        """Take the collision monitor's action and the polygon that caused it, as the monitor published them."""
        self._monitor_published = True
        self._acts(action, polygon, now)

    def occupied(self, polygon: str, near: Near | None, now: float) -> None:
        """Take the stop polygon in which points of the sensors are, and the nearest of them; "" if all are free.

        The monitor publishes its action once, when it changes, which may have been before this watch subscribed: then
        what is in its polygons tells why the robot stands. Without effect once the monitor has published.
        """
        if not self._monitor_published:
            self._acts(1 if polygon else 0, polygon, now)
            self._near = near

    def _acts(self, action: int, polygon: str, now: float) -> None:
        if (action, polygon) != self._monitor[:2]:
            self._monitor, self._near = (action, polygon, now), None

    def is_monitor_unknown(self, now: float) -> bool:
        """Whether the robot is commanded and does not move, and the collision monitor has published nothing."""
        return not self._monitor_published and bool(self._commanded_in_vain(now))

    @property
    def is_moving(self) -> bool:
        """Whether odometry reports motion."""
        return self._speed is not None and (abs(self._speed[0]) >= STANDS_MPS or abs(self._speed[1]) >= STANDS_RADPS)

    @property
    def held_by(self) -> str:
        """The polygon by which the collision monitor acts now; "" if it does not."""
        action, polygon, _ = self._monitor
        return polygon if action in MONITOR_ACTIONS else ""

    def near(self, polygon: str, near: Near | None) -> None:
        """Take the point of the sensors that is nearest to the robot in a polygon; None if it is not known."""
        if polygon == self.held_by:
            self._near = near

    def behaviour(self, name: str, *, is_running: bool, now: float) -> None:
        """Take whether one of Nav2's recoveries is running."""
        if not is_running:
            self._running.pop(name, None)
        elif name not in self._running:
            self._running[name] = now
            self.recovered[name] += 1

    def remaining(self, left_m: float, now: float) -> None:
        """Take the remaining length of the path in m, as Nav2 reports it; 0 before there is a path."""
        if left_m <= 0.0:
            return
        longer = left_m - self._remaining
        if (
            math.isfinite(longer)
            and now - self.began_at > _PLANNED_S
            and longer > max(_LONGER_M, _LONGER_SHARE * self._remaining)
        ):
            self._longer = (longer, now)
        self._remaining = left_m
        if left_m < self._nearest - _NEARER_M:
            self._nearest, self._progress_at = left_m, now

    def stuck_s(self, now: float) -> float:
        """Time in s without progress: the robot neither moved half a metre nor came nearer to the goal."""
        return now - max(self._progress_at, self.began_at)

    def sees(self, now: float) -> str:
        """Describe the most important problem in sentences; "" if there is none."""
        told = [self._held(now), self._recovering(now)]
        if not any(told):
            told.append(self._unmoved(now) or self._late(now))
        longer_m, at = self._longer
        if now - at < _LONGER_S:
            told.append(f"The way became {longer_m:.1f} m longer {now - at:.0f} s ago: it was blocked, and replanned.")
        return " ".join(filter(None, told))

    @property
    def recoveries(self) -> str:
        """The recoveries so far, by name and number."""
        return ", ".join(f"{name} ×{count}" if count > 1 else name for name, count in self.recovered.items())

    def _held(self, now: float) -> str:
        action, polygon, since = self._monitor
        if action not in MONITOR_ACTIONS or not (self._monitor_published or self._commanded_in_vain(now)):
            return ""
        verb = "holds" if action == 1 else MONITOR_ACTIONS[action]
        if polygon == INVALID_SOURCE:
            return (
                f"The collision monitor {verb} the robot, for {now - since:.0f} s: a source of it is silent, late or "
                "without a transform."
            )
        by = f"polygon {named(polygon)}" if polygon else "no polygon named"
        near = f", with something at {self._near}" if self._near else ""
        return f"The collision monitor {verb} the robot, for {now - since:.0f} s: {by}{near}."

    def _recovering(self, now: float) -> str:
        return " ".join(f"Nav2 recovers: {name}, for {now - since:.0f} s." for name, since in self._running.items())

    def _late(self, now: float) -> str:
        """Describe a controller that publishes less often than the rate it is set to; "" if it keeps the rate, or is
        not driving.
        """
        link = self._links.get(self._controller)
        if not (link and self._wanted_hz and len(self._sent) > 1 and now - link.heard_at < _NEW_S):
            return ""
        (first, before), (last, received) = self._sent[0], self._sent[-1]
        if last - first < _RATE_S:
            return ""
        rate_hz = (received - before) / (last - first)
        if rate_hz >= MISSED * self._wanted_hz:
            return ""
        return f"The controller misses its rate: {rate_hz:.1f} of {self._wanted_hz:g} Hz on {named(self._controller)}."

    def _unmoved(self, now: float) -> str:
        """Describe a robot that stands although it is commanded, or that is not commanded; "" if it moves."""
        if not self._stands(now) or self._speed is None:
            return ""
        sent = self._commanded_in_vain(now)
        if not sent:
            stands_s = now - max(self._stands_since, self.began_at)
            is_known = bool(self._links) and stands_s > _IDLE_S
            why = "Nav2 plans, waits, or is blocked"
            return f"The robot stands, and no velocity was sent to it for {stands_s:.0f} s: {why}." if is_known else ""
        topic, link = sent[-1]
        after = list(self._links)[list(self._links).index(topic) + 1 :]
        what = f"{link.speed:.2f} m/s" if abs(link.speed) > _COMMANDED else f"{link.turn:.2f} rad/s"
        where = f" The commands end between {named(topic)} and {named(after[0])}." if after else ""
        base = "" if after else " Whatever listens to that topic does not carry them out: motors off, brake, or fault."
        return (
            f"COMMANDED AND NOT MOVING for {now - link.since:.0f} s: {what} on {named(topic)}, and "
            f"{named(self._odometry)} reports {self._speed[0]:.2f} m/s.{where}{base}"
        )

    def _stands(self, now: float) -> bool:
        return self._speed is not None and now - self._stands_since >= _SAID_AFTER_S

    def _commanded_in_vain(self, now: float) -> list[tuple[str, _Link]]:
        """Return the topics, in order, on which a robot that stands is commanded; none if it moves."""
        if not self._stands(now):
            return []
        live = {topic: link for topic, link in self._links.items() if now - link.heard_at < _NEW_S}
        return [(topic, link) for topic, link in live.items() if now - link.since > _SAID_AFTER_S]
