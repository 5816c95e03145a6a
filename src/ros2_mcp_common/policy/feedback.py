"""The watchdog: compares the speed and the pose that the robot reports with what it was commanded. Needs no ROS.

It stops the robot if the robot moves although it was commanded to stop, is faster than the policy allows, reports
nothing while it is driven, or could not stop inside its zone. What drives it towards a keep-out zone is ended. Wrong
odometry cannot be detected.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, cast

from ros2_mcp_common.geometry import yaw_rad
from ros2_mcp_common.policy.checks import Zone, outside
from ros2_mcp_common.policy.field_values import Unfit
from ros2_mcp_common.policy.keep_out import (
    Entry,
    KeepOut,
    Near,
    Pose,
    Way,
    arc,
    keep_out_of,
    path_of,
    poses_of,
)
from ros2_mcp_common.policy.transform_chain import TransformChain

# The time from a message of the robot to a zero at its driver: a check every 0.02 s, and both transmissions, with a
# margin.
REACTION_S = 0.15
# The most headings between going straight on and the sharpest turn that are judged at each look.
MOST_HEADINGS = 12
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
# After a finding about a keep-out zone, the next comes after this time: a cancellation takes as long to arrive.
KEPT_OUT_AGAIN_S = 0.1
# Goals of other clients are cancelled so often while the robot moves on towards a zone.
OTHERS_AGAIN_S = 0.5
# A path that begins farther from the robot is a preview of another one.
FOLLOWED_M = 1.0
# A zone that is farther away is measured less precisely, and only told to be nearer than it is.
NEAR_M = 0.5
# The longest way to stop that is judged (m or rad): a robot that tells such a speed is near to every zone.
FARTHEST_STOP = 1000.0
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
    """Where the robot reports its pose, the zone that it may not leave while it is driven, and the zones that it may
    not enter.

    `brake_mps2` and `brake_radps2` are the decelerations with which it brakes. With a `base`, the topic has transforms,
    and those from `frame_id` to `base` are the pose; `path` is then not used.
    """

    topic: str
    type: str
    path: str
    max_age_s: float
    brake_mps2: float
    frame_id: str
    zone: Zone | None = None
    base: str = ""
    brake_radps2: float = 2.0
    keep_out: Sequence[KeepOut] = ()


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
        more: dict[str, Any] = {"zone": made, "keep_out": [keep_out_of(each) for each in pose.get("keep_out", ())]}
        pose = PoseRule(**{**pose, **more})
    return None if speed is None else SpeedRule(**speed), pose


@dataclass
class Seen:
    """The last speed message: when it was received (monotonic, s), and what it reported.

    `speed` has the lengths in m/s and rad/s by part, `velocity` is (x, y) in m/s, `turn` the speed about z in rad/s.
    """

    at: float = -math.inf
    speed: Mapping[str, float] = field(default_factory=dict[str, float])
    velocity: tuple[float, float] = (0.0, 0.0)
    turn: float = 0.0


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
        self._place: Pose | None = None
        self._chain = TransformChain(pose.frame_id, pose.base) if pose and pose.base else None
        self._placed_at = -math.inf
        self._near_at: Pose | None = None
        self._nearest: Sequence[tuple[KeepOut, Near]] = ()
        self._plan_problem = ""
        self._too_fast, self._faster = 0, ""
        self._no_speed, self._no_place = (
            rule and Silence(rule.topic, rule.type, rule.max_age_s) for rule in (speed, pose)
        )
        self._began = math.inf
        self._found_at = self._goal_until = self._kept_out_at = -math.inf
        self._driven_since: float | None = None
        self._stand_since: float | None = None
        self.latches = True
        """Whether the last finding sets the latch (only an operator resets it), or only ends what drives the robot."""

    @property
    def place(self) -> Pose | None:
        """The last known pose of the robot, in the frame of the zones; None before the first."""
        return self._place

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
        self._speed = Seen(now, speed, (parts["linear"][0], parts["linear"][1]), parts["angular"][2])
        self._faster = self._too_fast_now(now)
        self._too_fast = self._too_fast + 1 if self._faster else 0
        answers_s = min(ANSWERS_S, self.speed_rule.within_s / 2)
        if self._stand_since is not None and now > self._stand_since + answers_s and not self._moves():
            self._stand_since = None

    def heard_pose(self, message: Any, frame_id: str, now: float) -> None:
        """Record a message with the robot's pose in a frame."""
        rule, silence = self.pose_rule, self._no_place
        assert rule and silence
        if self._chain:
            self._heard_transforms(self._chain, message, now)
            return
        x, y = _numbers(message, f"{rule.path}.position", "xy")
        yaw = yaw_rad(*_numbers(message, f"{rule.path}.orientation", "xyzw"))
        problem = "" if all(map(math.isfinite, (x, y, yaw))) else f"no numbers at {rule.path}"
        if frame_id != rule.frame_id:  # the zone is in another frame
            problem = f"its frame is {frame_id[:MAX_NAME]!a}, not {rule.frame_id!r}"
        if silence.heard(now, problem):
            self._place = Pose(x, y, yaw)

    def _heard_transforms(self, chain: TransformChain, message: Any, now: float) -> None:
        """Record a message with transforms; a pose is known if all transforms of the chain are new enough."""
        rule, silence = self.pose_rule, self._no_place
        assert rule and silence
        chain.take(message, now)
        try:
            self._place, age_s = chain.place(now, rule.max_age_s / 2)
        except Unfit as unfit:
            silence.heard(now, str(unfit))
        else:
            self._placed_at = now - age_s
            silence.heard(self._placed_at, "")

    def heard_plan(self, message: Any) -> None:
        """Record a path that the robot's own software has planned; it counts as followed if it begins at the robot.

        A path in another frame cannot be judged, and is left out.
        """
        self._plan_problem = ""
        if self._place is None or self._driven_since is None:
            return
        for keep_out, here in self._near():
            try:
                poses = poses_of(keep_out, message)
                if not poses or math.dist(poses[0][:2], self._place[:2]) > FOLLOWED_M:
                    continue
                entered = keep_out.entered_from(here, path_of(poses, keep_out.swing_m, self._place))
            except Unfit:
                continue
            if entered:
                self._plan_problem = f"on the path that it follows now, {entered}"

    # ── output ────────────────────────────────────────────────────────────────────────────────────────────────────

    def look(self, now: float) -> str:
        """Return a sentence that says why the robot has to be stopped now; "" if there is no reason."""
        if not self.is_busy:
            return ""
        self.latches = True
        found = self._of_speed(now) or self._of_place(now) or self._too_near()
        if not found and now - self._kept_out_at > KEPT_OUT_AGAIN_S and (found := self._of_keep_out(now)):
            self.latches, self._kept_out_at = False, now
        elif found:
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

    def _too_near(self) -> str:
        """Return why the robot may not be driven at all: its outline is in a keep-out zone, or near to its edge."""
        if self._place is None or self._driven_since is None:
            return ""
        for keep_out, here in self._near():
            if here.distance_m < keep_out.latched_m:
                told = Entry(here.zone, self._place, here.distance_m).told("is")
                return f"{told}: only an operator may drive it from there"
        return ""

    def _of_keep_out(self, now: float) -> str:
        """Return why the motion has to end because of a keep-out zone: the robot could not stop before it, or its
        planned path enters it.
        """
        if self._place is None or self._driven_since is None:
            return ""
        problem, self._plan_problem = self._plan_problem if now <= self._goal_until else "", ""
        velocity = (*self._speed.velocity, self._speed.turn)
        return self._of_velocity(velocity, now, "before it could stop") or problem

    @property
    def is_moved_by_others(self) -> bool:
        """Whether there are keep-out zones and the robot reports motion although nothing of this server drives it."""
        rule = self.pose_rule
        return bool(rule and rule.keep_out) and self._driven_since is None and self._moves()

    def look_at_others(self, now: float) -> str:
        """Return why goals of other clients have to end, at most twice a second; "" if there is no reason."""
        if not self.is_moved_by_others or now - self._kept_out_at < OTHERS_AGAIN_S or now - self._speed.at > FIRST_S:
            return ""
        found = self._of_velocity((*self._speed.velocity, self._speed.turn), now, "before it could stop")
        if found:
            self._kept_out_at = now
        return found

    def problem_of_velocity(self, velocity: tuple[float, float, float], now: float) -> str:
        """Return why this velocity (m/s, m/s, rad/s) may not be commanded, by the keep-out zones; "" if it may."""
        return self._unplaced(now) or self._of_velocity(velocity, now, "with this velocity")

    def problem_of_start(self, now: float) -> str:
        """Return why no goal may drive the robot from its present pose, by the keep-out zones; "" if a goal may."""
        if problem := self._unplaced(now):
            return problem
        for keep_out, here in self._near():
            if self._place and here.distance_m < keep_out.watched_m:
                told = Entry(here.zone, self._place, here.distance_m).told("is")
                return f"{told}: only a velocity that leads away from it may drive it"
        return ""

    def problem_of_straight(self, length_m: float, now: float) -> str:
        """Return why the robot may not drive this far straight ahead (negative: back), by the keep-out zones; "" if it
        may.
        """
        if problem := self._unplaced(now):
            return problem
        for keep_out, here in self._near():
            assert self._place
            back = math.pi if length_m < 0 else 0.0
            way = arc(self._place, self._place.yaw + back, min(abs(length_m), FARTHEST_STOP), 0.0, keep_out.swing_m)
            try:
                if entered := keep_out.entered_from(here, way):
                    return f"on the way straight {'back' if back else 'ahead'}, {entered}"
            except Unfit as unfit:
                return str(unfit)
        return ""

    def _unplaced(self, now: float) -> str:
        """Return why the place of the robot is not known, if there are keep-out zones."""
        rule = self.pose_rule
        if rule is None or not rule.keep_out:
            return ""
        if self._place is None:
            why = self._no_place.why if self._no_place else ""
            return f"{rule.topic} has told no pose{why} yet, and there are keep-out zones"
        if self._chain and now - self._placed_at > rule.max_age_s:
            return f"{rule.topic} has told no pose for {now - self._placed_at:.1f} s, and there are keep-out zones"
        return ""

    def _of_velocity(self, velocity: tuple[float, float, float], now: float, when: str) -> str:
        """Return which keep-out zone the robot would come too near to before it stands, if it moves at this velocity
        now.
        """
        for keep_out, here in self._near():
            try:
                for way in self._ways_to_stop(keep_out, velocity, now):
                    if entered := keep_out.entered_from(here, way, keep_out.watched_m):
                        return f"{when}, {entered}"
            except Unfit as unfit:
                return str(unfit)
        return ""

    def _near(self) -> Sequence[tuple[KeepOut, Near]]:
        """Return each policy's keep-out zones with the nearest of them; computed once for each pose."""
        rule, place = self.pose_rule, self._place
        if rule is None or place is None:
            return ()
        if self._near_at != place:
            self._nearest, self._near_at = [(each, each.nearest(place, NEAR_M)) for each in rule.keep_out], place
        return self._nearest

    def _ways_to_stop(self, keep_out: KeepOut, velocity: tuple[float, float, float], now: float) -> Sequence[Way]:
        """Return how a robot with this velocity may move until it stands, if it is stopped now.

        It may turn less than it could, so the corner of a zone may lie between two headings: they are so near to each
        other that what is between them comes nearer by half of the watched distance at most.
        """
        rule, place, silences = self.pose_rule, self._place, filter(None, (self._no_speed, self._no_place))
        assert rule and place
        forward, left, turning = velocity
        wait_s = max(silence.length_s(now) for silence in silences) + REACTION_S
        length_m = _way_to_stop(math.hypot(forward, left), wait_s, rule.brake_mps2, self._still("linear"))
        turned_rad = _way_to_stop(abs(turning), wait_s, rule.brake_radps2, self._still("angular"))
        turn_rad = math.copysign(min(turned_rad, 2 * math.pi), turning)
        heading = place.yaw + math.atan2(left, forward)
        swept_m = abs(turn_rad) * (keep_out.swing_m + length_m)
        parts = max(1, min(MOST_HEADINGS, math.ceil(swept_m / keep_out.watched_m)))
        turns = [turn_rad * part / parts for part in range(parts + 1)] if turn_rad else [0.0]
        ways = [arc(place, heading, length_m, turn, keep_out.swing_m) for turn in turns]
        return [*ways, arc(place, heading, 0.0, turn_rad, keep_out.swing_m)] if length_m and turn_rad else ways

    def _still(self, part: str) -> float:
        return self.speed_rule.still.get(part, 0.0) if self.speed_rule else 0.0

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


def _way_to_stop(speed: float, wait_s: float, brake: float, still: float) -> float:
    """Return how far a robot moves (m or rad) until it stands, if it is told to stop after `wait_s`.

    Meanwhile it may become faster as quickly as it brakes, unless it stands.
    """
    faster = speed + (brake * wait_s if speed > still else 0.0)
    return min((speed + faster) / 2 * wait_s + faster * faster / (2 * brake), FARTHEST_STOP)


def _numbers(message: Any, path: str, names: str) -> tuple[float, ...]:
    """Return the numbers with these names below a path; all NaN if a number is missing."""
    found = message
    try:
        for step in path.split("."):
            found = _field(found, step)
        return tuple(float(_field(found, name)) for name in names)
    except (AttributeError, KeyError, TypeError, ValueError):
        return (math.nan,) * len(names)


def _field(value: Any, name: str) -> Any:
    return cast("Mapping[str, Any]", value)[name] if isinstance(value, Mapping) else getattr(value, name)
