"""The watchdog: what the robot itself tells of its speed and place, against what it was told. Needs no ROS.

It stops the robot where it moves although it was told to stand, is faster than the policy lets anybody command, tells
nothing while it is driven, or would not come to a stand inside of its zone. Odometry that lies is believed.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, cast

from ros2_mcp_common.geometry import yaw_rad
from ros2_mcp_common.policy.checks import Zone, outside

# From a message about the robot to a zero at its driver: a look every 0.02 s, and the way of both. Chosen, with room.
REACTION_S = 0.15
# From its beginning on, the watchdog waits so long for a first message: a publisher that missed our announcement is
# discovered with the next one, 3 s later (decision 13).
FIRST_S = 4.0
# What it has found it says no sooner again, where the robot is driven on: a stop takes as long to arrive. Chosen.
AGAIN_S = 1.0
# A robot that is told to stand before it has begun to move still tells that it stands: what it tells so soon after its
# zero counts for nothing. Drivers answer within 0.2 s, as a rule. Half of `within_s` where that is less.
ANSWERS_S = 0.3
# Messages that are too fast, one after the other: a single one is noise.
TOO_FAST_MESSAGES = 3
# Of the name of a frame that the robot tells: longer ones are cut in what is said of them. Chosen.
MAX_NAME = 40
PARTS = ("linear", "angular")
UNITS = {"linear": "m/s", "angular": "rad/s"}


@dataclass(frozen=True)
class SpeedRule:
    """Where the robot's speed is told, and what of it stops the robot. `most` are the policy's limits, by part.

    `still` are the lengths (m/s, rad/s) below which it counts as standing, `within_s` how long it may take to stand
    after its zero, `over` by how many times it may be faster than `most`, `max_age_s` how long it may be silent. While
    a goal runs the robot's own software drives, and `goals` holds instead of `most`.
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
    """Where the robot's place is told, and the zone that it may not leave while it is driven; it brakes so hard."""

    topic: str
    type: str
    path: str
    max_age_s: float
    brake_mps2: float
    frame_id: str
    zone: Zone | None = None


def rules_of(value: Mapping[str, Any]) -> tuple[SpeedRule | None, PoseRule | None]:
    """The rules in the JSON that comes down with the policy; raises `TypeError` or `KeyError` for another shape."""
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
    """The last message of a kind: when it came (monotonic, s), and what it told."""

    at: float = -math.inf
    speed: Mapping[str, float] = field(default_factory=dict[str, float])
    velocity: tuple[float, float] = (0.0, 0.0)


@dataclass
class Silence:
    """How long the robot is driven while a topic tells nothing that can be used; `why` is what its last message lacks.

    Only the time in which it is driven counts, over all motions: nobody drives a robot on of which nothing is known by
    driving it a little at a time, and who is silent at rest does no harm.
    """

    topic: str
    type: str
    max_age_s: float
    why: str = ""
    was_heard: bool = False
    before_s: float = 0.0
    driven_at: float | None = None

    def told(self, is_driven: bool, now: float) -> None:
        """Whether the robot is driven from now on."""
        self.before_s = self.length_s(now)
        self.driven_at = now if is_driven else None

    def heard(self, now: float, problem: str) -> bool:
        """A message has come, with what is wrong about it; whether it can be used."""
        self.was_heard, self.why = True, problem and f" that can be used ({problem})"
        if not problem:
            self.before_s = 0.0
            self.driven_at = None if self.driven_at is None else now
        return not problem

    def length_s(self, now: float) -> float:
        """How long it has lasted."""
        return self.before_s + (0.0 if self.driven_at is None else now - self.driven_at)

    def too_long(self, began: float, now: float) -> str:
        """That it lasts too long; "" while it does not. `began` is when the topic was listened to first."""
        if self.length_s(now) <= self.max_age_s or not (self.was_heard or now - began > FIRST_S):
            return ""
        why = self.why or ("" if self.was_heard else f" yet as {self.type}")
        return f"{self.topic} has sent nothing{why} for {self.length_s(now):.2f} s while the robot is driven"


class Watchdog:
    """Judges what it is told; times are monotonic, in s. `look` is to be called often while the robot is driven."""

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
        """Whether it has to look often: something is driven, or has not been seen to stand since."""
        return self._driven_since is not None or self._stand_since is not None

    # ── what it is told ────────────────────────────────────────────────────────────────────────────────────────────

    def told(self, is_driven: bool, now: float, *, by_goal: bool = False) -> None:
        """Whether something drives the robot now: a command that is no zero, a goal."""
        self._began = min(self._began, now)
        for silence in filter(None, (self._no_speed, self._no_place)):
            silence.told(is_driven, now)
        if by_goal and self.speed_rule:
            self._goal_until = now + self.speed_rule.within_s  # it may take so long to slow down
        if is_driven and self._driven_since is None and now > self._found_at + AGAIN_S:
            self._driven_since, self._stand_since, self._too_fast = now, None, 0
        elif not is_driven and self._driven_since is not None:
            self._driven_since, self._stand_since = None, now

    def heard_speed(self, message: Any, now: float) -> None:
        """The robot has told its speed. What is not finite is not heard, so that it becomes stale."""
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
        """The robot has told its place, in a frame."""
        rule, silence = self.pose_rule, self._no_place
        assert rule and silence
        x, y = _numbers(message, f"{rule.path}.position", "xy")
        yaw = yaw_rad(*_numbers(message, f"{rule.path}.orientation", "xyzw"))
        problem = "" if all(map(math.isfinite, (x, y, yaw))) else f"no numbers at {rule.path}"
        if frame_id != rule.frame_id:  # it says nothing of where the zone is
            problem = f"its frame is {frame_id[:MAX_NAME]!a}, not {rule.frame_id!r}"
        if silence.heard(now, problem):
            self._place = x, y, yaw

    # ── what follows ───────────────────────────────────────────────────────────────────────────────────────────────

    def look(self, now: float) -> str:
        """Why the robot is to be stopped now, as a sentence; "" while all is well."""
        if not self.is_busy:
            return ""
        found = self._of_speed(now) or self._of_place(now)
        if found:
            self._driven_since = self._stand_since = None  # said once; the latch holds from now on
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
        """Where it comes to a stand if it is stopped now: from its last place on, v * (age of that place + reaction) +
        v² / 2a in its direction. v is the slower one of its last two messages: a single one that is too fast is noise.
        The age is the time in which it was driven since: at rest it stays where it is.
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
        """What is too fast, with the limit; "" where nothing is."""
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
    """The numbers of these names below a path; all NaN where they are not there."""
    found = message
    try:
        for step in path.split("."):
            found = _field(found, step)
        return tuple(float(_field(found, name)) for name in names)
    except (AttributeError, KeyError, TypeError, ValueError):
        return (math.nan,) * len(names)


def _field(value: Any, name: str) -> Any:
    return cast("Mapping[str, Any]", value)[name] if isinstance(value, Mapping) else getattr(value, name)
