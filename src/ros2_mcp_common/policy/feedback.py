"""The watchdog: compares the speed and the pose that the robot reports with what it was commanded. Needs no ROS.

It stops the robot if the robot moves although it was commanded to stop, is faster than the policy allows, reports
nothing while it is driven, or could not stop inside its zone. It cannot detect wrong odometry.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, cast

from ros2_mcp_common.geometry import yaw_rad
from ros2_mcp_common.policy.checks import Zone, outside

# The time from a message of the robot to a zero at its driver: a check every 0.02 s, and both transmissions, with a
# margin.
REACTION_S = 0.15
# How long the watchdog waits for the first message after its start: a publisher that missed our announcement is
# discovered with the next one, 3 s later (decision 13).
FIRST_S = 4.0
# After a finding the watchdog stays silent for this time, even if the robot is driven on: a stop takes as long to
# arrive.
AGAIN_S = 1.0
# Reports within this time after the zero do not count: a robot commanded to stop before it began to move still reports
# that it is at rest. Drivers usually react within 0.2 s. Half of `within_s` if that is less.
ANSWERS_S = 0.3
# So many consecutive messages have to be too fast: a single one is noise.
TOO_FAST_MESSAGES = 3
# The longest name of a frame in a message about it; longer names are cut.
MAX_NAME = 40
PARTS = ("linear", "angular")
UNITS = {"linear": "m/s", "angular": "rad/s"}


@dataclass(frozen=True)
class SpeedRule:
    """Where the robot reports its speed, and which speeds stop it. `most` are the policy's limits, by part.

    `still` are the speeds (m/s, rad/s) below which the robot counts as at rest, `within_s` is how long it may take to
    stop after its zero, `over` the factor by which it may exceed `most`, `max_age_s` how long it may report nothing.
    While a goal runs the robot's own software drives it, and `goals` holds instead of `most`.
    """

    topic: str
    type: str
    path: str
    within_s: float
    over: float
    max_age_s: float
    still: Mapping[str, float] = field(default_factory=dict[str, float])
    most: Mapping[str, float] = field(default_factory=dict[str, float])
    goals: Mapping[str, float] = field(default_factory=dict[str, float])


@dataclass(frozen=True)
class PoseRule:
    """Where the robot reports its pose, and the zone that it may not leave while it is driven.

    `brake_mps2` is the deceleration with which it brakes, in m/s².
    """

    topic: str
    type: str
    path: str
    max_age_s: float
    brake_mps2: float
    frame_id: str
    zone: Zone | None = None


def rules_of(value: Mapping[str, Any]) -> tuple[SpeedRule | None, PoseRule | None]:
    """Return the watchdog's rules from the JSON of the policy.

    Raise `TypeError` or `KeyError` if it has another structure.
    """
    speed: Any = value.get("feedback")
    pose: Any = value.get("pose")
    if pose is not None:
        zone = pose.get("zone")
        made: Any = (
            Zone(zone["frame_id"], tuple((x, y) for x, y in zone["polygon"]), zone["margin_m"]) if zone else None
        )
        pose = PoseRule(**{**pose, "zone": made})
    return None if speed is None else SpeedRule(**speed), pose


@dataclass
class Seen:
    """The last speed message: when it was received (monotonic, s), and what it reported.

    `speed` has the lengths in m/s and rad/s by part, `velocity` is (x, y) in m/s.
    """

    at: float = -math.inf
    speed: Mapping[str, float] = field(default_factory=dict[str, float])
    velocity: tuple[float, float] = (0.0, 0.0)


@dataclass
class Silence:
    """How long the robot has been driven while a topic reported nothing usable; `why` is what was
    wrong with the last message.

    Only the time during which it is driven counts, summed over all motions. So a robot that does not report cannot be
    driven on in many short motions, and silence at rest does no harm.
    """

    topic: str
    type: str
    max_age_s: float
    why: str = ""
    was_heard: bool = False
    before_s: float = 0.0
    driven_at: float | None = None

    def told(self, is_driven: bool, now: float) -> None:
        """Record whether the robot is driven from now on."""
        self.before_s = self.length_s(now)
        self.driven_at = now if is_driven else None

    def heard(self, now: float, problem: str) -> bool:
        """Record a message and what is wrong with it ("": nothing). Return whether it is usable."""
        self.was_heard, self.why = True, problem and f" that can be used ({problem})"
        if not problem:
            self.before_s = 0.0
            self.driven_at = None if self.driven_at is None else now
        return not problem

    def length_s(self, now: float) -> float:
        """Return how long the silence has lasted, in s."""
        return self.before_s + (0.0 if self.driven_at is None else now - self.driven_at)

    def too_long(self, began: float, now: float) -> str:
        """Return a sentence if the silence lasts too long, else "".

        `began` is when the topic was first subscribed to.
        """
        if self.length_s(now) <= self.max_age_s or not (self.was_heard or now - began > FIRST_S):
            return ""
        why = self.why or ("" if self.was_heard else f" yet as {self.type}")
        return f"{self.topic} has sent nothing{why} for {self.length_s(now):.2f} s while the robot is driven"


class Watchdog:
    """Judges what the robot reports; times are monotonic, in s. Call `look` often while the robot is driven."""

    def __init__(self, speed: SpeedRule | None, pose: PoseRule | None) -> None:
        self.speed_rule = speed
        self.pose_rule = pose
        self._speed = self._speed_before = Seen()
        self._place: tuple[float, float, float] | None = None
        self._too_fast, self._faster = 0, ""
        self._no_speed, self._no_place = (
            rule and Silence(rule.topic, rule.type, rule.max_age_s) for rule in (speed, pose)
        )
        self._began = math.inf
        self._found_at = self._goal_until = -math.inf
        self._driven_since: float | None = None
        self._stand_since: float | None = None

    @property
    def is_busy(self) -> bool:
        """Whether `look` has to be called often: the robot is driven, or has not been observed at rest since."""
        return self._driven_since is not None or self._stand_since is not None

    # ── input ──────────────────────────────────────────────────────────────────────────────────────────────────────

    def told(self, is_driven: bool, now: float, *, by_goal: bool = False) -> None:
        """Record whether a nonzero command or a goal (`by_goal`) drives the robot now."""
        self._began = min(self._began, now)
        for silence in filter(None, (self._no_speed, self._no_place)):
            silence.told(is_driven, now)
        if by_goal and self.speed_rule:
            self._goal_until = now + self.speed_rule.within_s  # the robot may take this long to slow down
        if is_driven and self._driven_since is None and now > self._found_at + AGAIN_S:
            self._driven_since, self._stand_since, self._too_fast = now, None, 0
        elif not is_driven and self._driven_since is not None:
            self._driven_since, self._stand_since = None, now

    def heard_speed(self, message: Any, now: float) -> None:
        """Record a message with the robot's speed.

        Numbers that are not finite do not count, so the speed becomes stale.
        """
        assert self.speed_rule and self._no_speed
        parts = {part: _numbers(message, f"{self.speed_rule.path}.{part}", "xyz") for part in PARTS}
        speed = {part: math.hypot(*numbers) for part, numbers in parts.items()}
        problem = "" if all(map(math.isfinite, speed.values())) else f"no numbers at {self.speed_rule.path}"
        if not self._no_speed.heard(now, problem):
            return
        self._speed_before = self._speed
        self._speed = Seen(now, speed, (parts["linear"][0], parts["linear"][1]))
        self._faster = self._too_fast_now(now)
        self._too_fast = self._too_fast + 1 if self._faster else 0
        answers_s = min(ANSWERS_S, self.speed_rule.within_s / 2)
        if self._stand_since is not None and now > self._stand_since + answers_s and not self._moves():
            self._stand_since = None

    def heard_pose(self, message: Any, frame_id: str, now: float) -> None:
        """Record a message with the robot's pose in a frame."""
        rule, silence = self.pose_rule, self._no_place
        assert rule and silence
        x, y = _numbers(message, f"{rule.path}.position", "xy")
        yaw = yaw_rad(*_numbers(message, f"{rule.path}.orientation", "xyzw"))
        problem = "" if all(map(math.isfinite, (x, y, yaw))) else f"no numbers at {rule.path}"
        if frame_id != rule.frame_id:  # the zone is in another frame
            problem = f"its frame is {frame_id[:MAX_NAME]!a}, not {rule.frame_id!r}"
        if silence.heard(now, problem):
            self._place = x, y, yaw

    # ── output ────────────────────────────────────────────────────────────────────────────────────────────────────

    def look(self, now: float) -> str:
        """Return a sentence that says why the robot has to be stopped now; "" if there is no reason."""
        if not self.is_busy:
            return ""
        found = self._of_speed(now) or self._of_place(now)
        if found:
            self._driven_since = self._stand_since = None  # reported once; the latch holds from now on
            self._found_at = now
        return found

    def _of_speed(self, now: float) -> str:
        rule, silence = self.speed_rule, self._no_speed
        if rule is None or silence is None:
            return ""
        if self._too_fast >= TOO_FAST_MESSAGES:
            return f"{rule.topic} reports that the robot moves faster than the policy allows: {self._faster}"
        if self._driven_since is not None:
            return silence.too_long(self._began, now)
        assert self._stand_since is not None
        if now - self._stand_since <= rule.within_s:
            return ""
        if self._speed.at <= max(self._stand_since, now - rule.max_age_s):
            return f"{rule.topic} does not report the robot's speed {rule.within_s:g} s after its zero"
        return f"{rule.topic} reports that the robot still moves {rule.within_s:g} s after its zero: {self._shown()}"

    def _of_place(self, now: float) -> str:
        rule, silence = self.pose_rule, self._no_place
        if rule is None or silence is None or self._driven_since is None:
            return ""
        if silent := silence.too_long(self._began, now):
            return silent
        if rule.zone is None or self._place is None:
            return ""
        x, y, _ = self._place
        for place, where in (((x, y), "is"), (self._stops_at(rule.brake_mps2, now), "would come to a stand")):
            if problem := outside({"x": place[0], "y": place[1]}, rule.zone.frame_id, rule.zone):
                at = "" if problem.startswith("(") else f"({place[0]:.2f}, {place[1]:.2f}) "
                return f"the robot {where} outside of its zone: {at}{problem}"
        return ""

    def _stops_at(self, brake_mps2: float, now: float) -> tuple[float, float]:
        """Return the point (x, y) where the robot would come to rest if it were stopped now.

        From its last reported position, it moves v * (age + REACTION_S) + v² / 2a in its direction. v is the lower
        speed of the last two messages, because a single one that is too fast is noise. The age counts only while the
        robot was driven since: at rest it stays where it is.
        """
        assert self._place and self._no_place
        x, y, yaw = self._place
        forward, left = min(self._speed.velocity, self._speed_before.velocity, key=lambda told: math.hypot(*told))
        speed = math.hypot(forward, left)
        if not speed:
            return x, y
        way_m = speed * (self._no_place.length_s(now) + REACTION_S) + speed * speed / (2 * brake_mps2)
        heading = yaw + math.atan2(left, forward)
        return x + way_m * math.cos(heading), y + way_m * math.sin(heading)

    def _moves(self) -> bool:
        assert self.speed_rule
        return any(self._speed.speed.get(part, 0.0) > bound for part, bound in self.speed_rule.still.items())

    def _too_fast_now(self, now: float) -> str:
        """Return which speeds are too fast, with their limits; "" if none is."""
        rule = self.speed_rule
        assert rule
        limits = rule.goals if now <= self._goal_until else rule.most
        return ", ".join(
            f"{self._speed.speed[part]:.2f} {UNITS[part]} at a limit of {most:g}"
            for part, most in limits.items()
            if self._speed.speed.get(part, 0.0) > most * rule.over
        )

    def _shown(self) -> str:
        return " and ".join(f"{speed:.2f} {UNITS[part]}" for part, speed in self._speed.speed.items())


def _numbers(message: Any, path: str, names: str) -> tuple[float, ...]:
    """Return the numbers with these names below a path; all NaN if one is missing."""
    found = message
    try:
        for step in path.split("."):
            found = _field(found, step)
        return tuple(float(_field(found, name)) for name in names)
    except (AttributeError, KeyError, TypeError, ValueError):
        return (math.nan,) * len(names)


def _field(value: Any, name: str) -> Any:
    return cast("Mapping[str, Any]", value)[name] if isinstance(value, Mapping) else getattr(value, name)
