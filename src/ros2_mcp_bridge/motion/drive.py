"""Driving a distance, an angle or an arc, controlled by odometry and guarded by scans or clouds. No ROS; times in s.

The robot accelerates and decelerates on a ramp, follows its course, stops, measures where it stopped, and
corrects the difference. It stops as soon as odometry or a sensor is late, and goes on if that was a short pause;
otherwise the drive ends.
"""

from __future__ import annotations

import itertools
import math
from collections import deque
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

from ros2_mcp_bridge.motion.clearance import LEAST_MPS, LEAST_RADPS, NOTHING_NEAR, Allowed, Clearance, Guard
from ros2_mcp_bridge.motion.controller import Feed, Velocity
from ros2_mcp_bridge.motion.course import Circle, Line, Place, Pose, Turn, wrapped
from ros2_mcp_bridge.motion.nudges import Nudge, Nudges
from ros2_mcp_common.finite import not_finite
from ros2_mcp_common.geometry import yaw_rad
from ros2_mcp_common.wire.limits import STEER_MOST

# The acceleration, m/s² and rad/s²: what small robots do without slipping.
SPEED_UP_MPS2, SPEED_UP_RADPS2 = 0.5, 1.5
# The deceleration towards the end, m/s² and rad/s², and the delay after which a command shows in the odometry, which is
# allowed for, so that a slow robot does not overshoot. With a margin.
SLOW_DOWN_MPS2, SLOW_DOWN_RADPS2, ANSWERS_S = 0.4, 1.0, 0.2
# The slowest command, m/s and rad/s, and how much it grows per second while the robot does not move: many robots do not
# turn their wheels below some speed.
CREEP_MPS, CREEP_RADPS = 0.03, 0.06
PUSH_MPS2, PUSH_RADPS2 = 0.06, 0.3
# The robot does not move if in this time it moves by less than this share of the commanded distance; the slowest
# command grows for at most so many seconds.
PUSH_AFTER_S, PUSH_SHARE, MOST_PUSHED = 0.6, 0.3, 3.0
# The end is reached within the first, besides the distance that the robot still rolls. An error above the second after
# it stopped is corrected, up to CORRECTIONS times; after that an error within the third is good enough.
REACHED_M, REACHED_RAD = 0.003, math.radians(0.2)
WRONG_M, WRONG_RAD = 0.01, math.radians(0.6)
BAR_M, BAR_RAD = 0.02, math.radians(1.0)
CORRECTIONS = 10
# From this correction on, nudges are used (`nudges.py`), because so many others have failed, as with friction.
NUDGED_FROM = 3
# The longest time that a robot is presumed to roll on after a stop; the time is learnt from each stop.
MOST_ROLLED_S = 0.8
# Steering back to the course: rad/s for each rad of heading error, at most `STEER_MOST`.
STEER_PER_S = 1.5
# The robot is at rest if the mean poses of two halves of this time differ by less than these (m, rad). After the last
# time it is presumed to be at rest.
STILL_S, STILL_M, STILL_RAD, STANDS_WITHIN_S = 0.4, 0.002, math.radians(0.15), 2.0
# A topic is late LATE_S after its period, which is the longest of its last intervals. The zero has to leave within 0.1
# s after the mean interval. If the intervals are so uneven that this would be at risk, the topic is late
# LATE_AFTER_MEAN_S after the mean interval, but no sooner than LATE_AFTER_LONGEST_S after the longest.
LATE_S, LATE_AFTER_MEAN_S, LATE_AFTER_LONGEST_S = 0.06, 0.075, 0.035
# After being late for this time a topic is silent, and the drive ends. A shorter pause, such as that of a loaded
# computer, only makes the robot stop.
SILENT_S = 0.5
# The number of intervals that determine the period of a topic, and the longest period.
PERIODS, LONGEST_PERIOD_S = 8, 1.0
FIRST_MESSAGES = 3
# The robot is stuck if for this time it moves by less than this share of the commanded distance, and was commanded at
# least so far (m, rad).
STUCK_S, STUCK_SHARE, STUCK_M, STUCK_RAD = 3.0, 0.1, 0.06, 0.12
# The period of computing the allowed speed if the sensors have sent nothing new: as that of the commands.
LOOKS_AGAIN_S = 0.05
# The largest step between two odometry messages, besides the distance of the fastest command, that counts as motion.
JUMP_M, JUMP_RAD = 0.3, math.radians(40)


class Beat:
    """How often a topic comes, and whether it is late; `problem` says why its last message could not be used."""

    def __init__(self, topic: str) -> None:
        self.topic = topic
        self.count = 0
        self.problem = ""
        self._at = -math.inf
        self._periods: deque[float] = deque(maxlen=PERIODS)
        self._due_s = LONGEST_PERIOD_S + LATE_S

    def heard(self, now: float) -> None:
        """A message has come that can be used."""
        self.problem = ""
        self.count += 1
        if self.count > 1:
            self._periods.append(min(now - self._at, LONGEST_PERIOD_S))
            mean_s, longest_s = sum(self._periods) / len(self._periods), self.period_s
            soonest_s = max(mean_s + LATE_AFTER_MEAN_S, longest_s + LATE_AFTER_LONGEST_S)
            self._due_s = min(longest_s + LATE_S, soonest_s)
        self._at = now

    @property
    def period_s(self) -> float:
        """The longest of the last intervals, in s."""
        return max(self._periods, default=LONGEST_PERIOD_S)

    @property
    def awaited(self) -> str:
        """What is still missing from the topic, in words: no message came, too few, or none that can be used."""
        if self.problem:
            return f"messages came from {self.topic}, but {'too few' if self.count else 'none'}{self.unusable}"
        few = f"{self.count} of the {FIRST_MESSAGES} messages that tell its rate"
        return f"{few if self.count else 'no message'} came from {self.topic}"

    @property
    def unusable(self) -> str:
        """A phrase to follow "nothing" or "none": that what came cannot be used, and why; "" if there was no such
        problem.
        """
        return f" that can be used ({self.problem})" if self.problem else ""

    def late_s(self, now: float) -> float:
        """Return for how many seconds the topic has been late; negative if it is not late."""
        return now - self._at - self._due_s

    def age_s(self, now: float) -> float:
        """Return the age of the last message in s."""
        return now - self._at


def late_in_s(beats: Iterable[Beat], now: float) -> float:
    """Return in how many seconds the next topic becomes late, among topics that are not late yet; infinite if all are
    late.
    """
    return min((-late_s for beat in beats if (late_s := beat.late_s(now)) <= 0), default=math.inf)


class Standing:
    """Whether a robot that was commanded to stop is at rest, by its latest poses; their mean is where it is."""

    def __init__(self, now: float) -> None:
        self._since = now
        self._seen: deque[tuple[float, Pose]] = deque()

    def hear(self, pose: Pose, now: float) -> None:
        """Record a pose and its time of reception."""
        self._seen.append((now, pose))
        while self._seen and self._seen[0][0] < now - STILL_S:
            self._seen.popleft()

    def place(self, now: float) -> Pose | None:
        """Return the pose at rest; None while the robot moves, or while that is not known yet."""
        if now - self._since < STILL_S or not self._seen:
            return None
        half = [pose for at, pose in self._seen if at < now - STILL_S / 2]
        rest = [pose for at, pose in self._seen if at >= now - STILL_S / 2]
        whole = _mean([*half, *rest])
        if now - self._since > STANDS_WITHIN_S:
            return whole
        if not half or not rest:
            return whole if now - self._since > 2 * STILL_S else None  # odometry is slow
        before, after = _mean(half), _mean(rest)
        is_still = math.hypot(after.x - before.x, after.y - before.y) < STILL_M
        return whole if is_still and abs(after.yaw - before.yaw) < STILL_RAD else None


class Drive:
    """A controller (`controller.py`) that drives along a course.

    `outcome` is `reached`, `guard`, `silent`, `stuck`, `jumped`, `missed` or `timeout`.

    It is made from the server's JSON: `distance_m` (m), or `angle` (rad) with or without `radius_m`; `speed` (m/s, for
    a turn in place rad/s); `time_limit_s`, and optionally `pauses_s`, by which pauses may prolong it; `odometry` with
    `topic` and `type`; and optionally `sensors`, each with these and what `Clearance.of` takes.
    """

    def __init__(self, asked: Mapping[str, Any]) -> None:
        self.outcome = ""
        self.why = ""
        sensors = {f"sensor {number}": sensor for number, sensor in enumerate(asked.get("sensors") or ())}
        heard = {"odometry": asked["odometry"], **sensors}
        self.feeds: Sequence[Feed] = [Feed(role, each["topic"], each["type"]) for role, each in heard.items()]
        self._distance_m: float | None = asked.get("distance_m")
        self._angle: float | None = asked.get("angle")
        self._radius_m = float(asked.get("radius_m") or 0.0)
        self._fastest = float(asked["speed"])
        self._time_limit_s = float(asked["time_limit_s"])
        self._pauses_s = float(asked.get("pauses_s") or 0.0)
        if self._fastest <= 0 or (self._distance_m is None) == (self._angle is None):
            raise ValueError("a speed above 0, and a distance or an angle, are needed")
        self._beats = {feed.role: Beat(feed.topic) for feed in self.feeds}
        self._guard = Guard({role: Clearance.of(asked, one) for role, one in sensors.items()}) if sensors else None
        self._pose: Pose | None = None
        self._course: Line | Circle | Turn | None = None
        self._squaring: Turn | None = None
        self._standing: Standing | None = None
        self._ending = ""
        self._began_at = self._stepped_at = 0.0
        self._speed = 0.0
        self._push = {True: 0.0, False: 0.0}
        self._rolls_s = {True: ANSWERS_S / 2, False: ANSWERS_S / 2}
        self._stopped_with = (0.0, 0.0)
        self._nudges = {True: Nudges(STILL_RAD), False: Nudges(STILL_M)}
        self._nudge: Nudge | None = None
        self._nudged_at = self._nudged_along = self._nudged_s = 0.0
        self._recent: deque[tuple[float, float, float]] = deque()
        self._corrections = 0
        self._paused_s = 0.0
        self._allowed: Allowed | None = None
        self._allowed_at = -math.inf
        self._nearest_m = NOTHING_NEAR

    # ── input ──────────────────────────────────────────────────────────────────────────────────────────────────

    @property
    def is_settling(self) -> bool:
        """Whether the robot has stopped so that its final position can be measured."""
        return self._standing is not None

    def awaits(self) -> str:
        """The topics that have sent too few messages to know their rate, in words; "" if there are none."""
        return " and ".join(beat.awaited for beat in self._beats.values() if beat.count < FIRST_MESSAGES)

    def late_in_s(self, now: float) -> float:
        """See `controller.Controller`."""
        return late_in_s(self._beats.values(), now)

    def hear(self, role: str, message: Any, now: float, from_before_s: float | None = None) -> None:  # noqa: ARG002
        """Odometry (whatever has a pose), or a message of a sensor."""
        try:
            if role == "odometry":
                self._hear_pose(_pose_of(message), now)
            elif self._guard:
                self._guard.hear(role, message, now, self._along())
                self._allowed_at = -math.inf
        except ValueError as error:
            self._beats[role].problem = str(error)
            raise
        self._beats[role].heard(now)

    def _hear_pose(self, pose: Pose, now: float) -> None:
        if self._pose is not None:
            before = self._pose
            pose = Pose(pose.x, pose.y, before.yaw + wrapped(pose.yaw - before.yaw))
            passed_s = self._beats["odometry"].age_s(now)
            step_m = math.hypot(pose.x - before.x, pose.y - before.y)
            if self._course and (
                step_m > JUMP_M + 2 * self._fastest * passed_s
                or abs(pose.yaw - before.yaw) > JUMP_RAD + 2 * max(self._fastest, STEER_MOST) * passed_s
            ):
                self._end_at_once("jumped", f"{self._beats['odometry'].topic} jumped by {step_m:.2f} m: was it reset?")
        self._pose = pose
        if self._standing:
            self._standing.hear(pose, now)

    # ── output ─────────────────────────────────────────────────────────────────────────────────────────────────

    def step(self, now: float) -> Velocity | None:
        """Return the velocity to command now; None when the drive has ended."""
        assert self._pose
        if self._course is None:
            self._course, self._began_at, self._stepped_at = self._begun(self._pose), now, now
        seconds, self._stepped_at = min(0.1, now - self._stepped_at), now
        if self.outcome:
            return None
        if self._is_late(now, seconds):
            return None if self.outcome else self._stop()
        if self._standing:
            return self._look_where(self._standing, now)
        if now - self._began_at - min(self._paused_s, self._pauses_s) > self._time_limit_s:
            return self._stand("timeout", f"The time limit of {self._time_limit_s:.0f} s was reached.", now)
        if self._is_stuck(now):
            topic = self._beats["odometry"].topic
            return self._stand("stuck", _stuck(topic), now)
        return self._drive(now, seconds)

    def report(self) -> Mapping[str, object]:
        """Return what odometry has measured so far, in m, or in degrees for a turn in place;
        {} before the drive begins.
        """
        if self._course is None:
            return {}
        place, is_turn = self._here(), self._course.is_turn
        scale = math.degrees(1.0) if is_turn else 1.0
        assert self._pose
        return {
            "unit": "deg" if is_turn else "m",
            "done": round(place.along * scale, 4),
            "whole": round(self._course.whole * scale, 4),
            "error": round((self._course.whole - place.along) * scale, 4),
            "aside_m": round(place.aside_m, 4),
            "heading_deg": round(math.degrees(place.heading), 2),
            "corrections": self._corrections,
            "paused_s": round(self._paused_s, 2),
            "elapsed_s": round(self._stepped_at - self._began_at, 2),
            "period_s": {role: round(beat.period_s, 3) for role, beat in self._beats.items()},
            "nearest_m": None if self._nearest_m == NOTHING_NEAR else round(self._nearest_m, 3),
        }

    def _begun(self, start: Pose) -> Line | Circle | Turn:
        if self._distance_m is not None:
            return Line(start, float(self._distance_m))
        assert self._angle is not None
        return Circle(start, self._angle, self._radius_m) if self._radius_m > 0 else Turn(start, float(self._angle))

    def _here(self) -> Place:
        assert self._course and self._pose
        return self._course.place(self._pose)

    def _along(self) -> float:
        """Return how far the robot has come on a line or a circle, in m; 0 before it
        begins, and for a turn in place.
        """
        return 0.0 if self._course is None or self._course.is_turn else self._here().along

    def _drive(self, now: float, seconds: float) -> Velocity | None:
        assert self._course and self._pose
        course = self._squaring or self._course
        place = course.place(self._pose)
        left = course.whole - place.along
        direction = 1 if left > 0 else -1
        if self._nudge:
            return self._nudged(self._nudge, course, place, now)
        speed_up, slow_down, creep, push, reached = (
            (SPEED_UP_RADPS2, SLOW_DOWN_RADPS2, CREEP_RADPS, PUSH_RADPS2, REACHED_RAD)
            if course.is_turn
            else (SPEED_UP_MPS2, SLOW_DOWN_MPS2, CREEP_MPS, PUSH_MPS2, REACHED_M)
        )
        if abs(left) <= reached + abs(self._speed) * self._rolls_s[course.is_turn] or self._speed * direction < 0:
            self._stopped_with = self._speed, place.along
            return self._stand("", "", now)
        pushed = self._pushed(course.is_turn, creep, push, seconds)
        is_correction = self._corrections or self._squaring
        most = STEER_MOST if self._squaring else self._fastest  # no faster than the policy was asked to allow
        fastest = min(most, pushed + 3 * creep) if is_correction else most
        dead = slow_down * ANSWERS_S
        wanted = min(fastest, max(creep, math.sqrt(dead * dead + 2 * slow_down * abs(left)) - dead))
        wanted = min(fastest, max(wanted, pushed))
        speed = min(wanted, abs(self._speed) + speed_up * seconds)
        if self._guard:
            allowed = self._guarded(self._guard, course, direction, speed, now)
            if allowed is None:
                return self._stop()
            speed = min(speed, allowed)
        self._speed = direction * speed
        self._recent.append((now, self._speed, place.along))
        if course.is_turn:
            return {"angular.z": self._speed}
        return {"linear.x": self._speed, "angular.z": self._steered(course.curvature, place)}

    def _nudged(self, nudge: Nudge, course: Line | Circle | Turn, place: Place, now: float) -> Velocity | None:
        if not self._nudged_s:
            self._nudged_at, self._nudged_along = now, place.along
        self._nudged_s = max(now - self._nudged_at, 1e-6)
        if self._nudged_s >= nudge.length_s:
            return self._stand("", "", now)
        speed = abs(nudge.speed)
        if self._guard:
            allowed = self._guarded(self._guard, course, 1 if nudge.speed > 0 else -1, speed, now)
            if allowed is None:
                return self._stop()
            speed = min(speed, allowed)
        self._speed = math.copysign(speed, nudge.speed)
        if course.is_turn:
            return {"angular.z": self._speed}
        return {"linear.x": self._speed, "angular.z": self._speed * course.curvature}

    def _steered(self, curvature: float, place: Place) -> float:
        """Return the turning rate that follows the course, and leads back to it, in rad/s.

        The correction is limited, so that it is no faster than robots respond.
        """
        speed = abs(self._speed)
        per_m = min(4.0, 0.56 / (speed * speed)) if speed else 0.0
        back = -STEER_PER_S * place.heading - per_m * self._speed * place.aside_m
        return self._speed * curvature + max(-STEER_MOST, min(STEER_MOST, back))

    def _pushed(self, is_turn: bool, creep: float, push: float, seconds: float) -> float:
        """Return the slowest command that moves this robot: it grows while almost nothing
        moves, and falls back slowly.
        """
        asked, moved, since_s = self._asked_and_moved(PUSH_AFTER_S)
        is_held = since_s > PUSH_AFTER_S * 0.9 and moved < PUSH_SHARE * asked
        grown = self._push[is_turn] + (push if is_held else -push / 4) * seconds
        self._push[is_turn] = min(max(0.0, grown), MOST_PUSHED * push)
        return creep + self._push[is_turn]

    def _asked_and_moved(self, window_s: float) -> tuple[float, float, float]:
        """Return how far it was commanded and how far it came in the last seconds, and the part of that
        time for which this is known.
        """
        recent = [each for each in self._recent if each[0] >= self._stepped_at - window_s]
        if len(recent) < 2:
            return 0.0, 0.0, 0.0
        asked = sum(abs(speed) * (later[0] - at) for (at, speed, _), later in itertools.pairwise(recent))
        return asked, abs(recent[-1][2] - recent[0][2]), recent[-1][0] - recent[0][0]

    def _guarded(
        self, guard: Guard, course: Line | Circle | Turn, direction: int, speed: float, now: float
    ) -> float | None:
        """Return the speed that the sensors allow; None if they allow no motion, so that the drive ends."""
        is_blind = not course.is_turn and not guard.sees(0.0 if direction > 0 else math.pi)
        if is_blind and not self._corrections:  # a correction is only some centimetres
            way = "ahead" if direction > 0 else "back"
            topics = [beat.topic for role, beat in self._beats.items() if role != "odometry"]
            shows = f"{' and '.join(topics)} {'does' if len(topics) == 1 else 'do'} not show"
            self._end_at_once("guard", f"{shows} the way {way}: it may not be free.")
            return None
        if now - self._allowed_at >= LOOKS_AGAIN_S:
            fastest = max(self._fastest, speed)
            self._allowed = (
                guard.allowed_turn(fastest, now)
                if course.is_turn
                else guard.allowed(fastest, course.curvature, direction, self._along(), now)
            )
            self._allowed_at = now
        assert self._allowed
        self._nearest_m = self._allowed.gap
        if self._allowed.speed < (LEAST_RADPS if course.is_turn else LEAST_MPS):
            gap_m, bearing = max(0.0, self._allowed.gap), math.degrees(self._allowed.bearing)
            self._standing, self._ending = Standing(now), "guard"
            where = f"{gap_m:.2f} m from the robot's outline, at {bearing:.0f}° (left is positive)"
            self.why = f"The nearest obstacle is {where}."
            return None
        return self._allowed.speed

    # ── how it ends ────────────────────────────────────────────────────────────────────────────────────────────

    def _stop(self) -> Velocity:
        self._speed = 0.0
        self._recent.clear()
        return {"linear.x": 0.0, "angular.z": 0.0}

    def _end_at_once(self, outcome: str, why: str) -> None:
        self.outcome, self.why = outcome, why

    def _stand(self, ending: str, why: str, now: float) -> Velocity:
        """Stop, and measure where the robot stopped. Then the drive ends with `ending`, or corrects the difference."""
        self._standing, self._ending, self.why = Standing(now), ending, why
        return self._stop()

    def _look_where(self, standing: Standing, now: float) -> Velocity | None:
        pose = standing.place(now)
        if pose is None:
            return self._stop()
        self._pose, self._standing = pose, None
        assert self._course
        if self._ending:
            self.outcome = self._ending
            if self._ending == "timeout" and self._is_there(self._course.place(pose), BAR_M, BAR_RAD):
                self.outcome, self.why = "reached", ""
            return None
        course = self._squaring or self._course
        self._learn(course, pose)
        place = self._course.place(pose)
        is_turn, is_last = self._course.is_turn, self._corrections == CORRECTIONS
        error = self._course.whole - place.along
        heading = 0.0 if is_turn else wrapped(place.heading)
        most_m, most_rad = (BAR_M, BAR_RAD) if is_last else (WRONG_M, WRONG_RAD)
        most = most_rad if is_turn else most_m
        if self._is_there(place, most_m, most_rad):
            self.outcome, self.why = "reached", ""
            return None
        if is_last:
            self.outcome, self.why = "missed", f"The robot stopped beside its target {CORRECTIONS} times."
            return None
        self._corrections += 1
        self._squaring = Turn(pose, -heading) if abs(error) <= most else None
        if self._corrections >= NUDGED_FROM:
            self._nudge = self._next_nudge(self._squaring or self._course, -heading if self._squaring else error)
        return self._stop()

    def _is_there(self, place: Place, most_m: float, most_rad: float) -> bool:
        """Return whether that place is the end of the course, within these tolerances."""
        assert self._course
        error = abs(self._course.whole - place.along)
        if self._course.is_turn:
            return error <= most_rad
        return error <= most_m and abs(wrapped(place.heading)) <= most_rad

    def _next_nudge(self, course: Line | Circle | Turn, left: float) -> Nudge:
        creep, fastest = CREEP_MPS, self._fastest
        if course.is_turn:
            creep, fastest = CREEP_RADPS, STEER_MOST if self._squaring else self._fastest
        self._nudged_s = 0.0
        return self._nudges[course.is_turn].next(left, min(fastest, creep + self._push[course.is_turn]), fastest)

    def _learn(self, course: Line | Circle | Turn, pose: Pose) -> None:
        """Record how far the last nudge carried the robot, or how long it rolled on after a stop."""
        if self._nudge:
            moved = (course.place(pose).along - self._nudged_along) * math.copysign(1.0, self._nudge.speed)
            self._nudges[course.is_turn].learn(self._nudged_s, moved)
            self._nudge = None
            return
        speed, along = self._stopped_with
        if speed:
            seen_s = min(max(0.0, (course.place(pose).along - along) / speed), MOST_ROLLED_S)
            self._rolls_s[course.is_turn] = (self._rolls_s[course.is_turn] + seen_s) / 2
        self._stopped_with = (0.0, 0.0)

    def _is_late(self, now: float, seconds: float) -> bool:
        """Return whether a topic is late, so that the robot has to stop. If a topic is silent, end the drive."""
        for role, beat in self._beats.items():
            late_s = beat.late_s(now)
            if late_s > SILENT_S:
                said = f"{beat.topic} has sent nothing{beat.unusable} for {beat.age_s(now):.2f} s."
                self._end_at_once("silent", said)
            if late_s > 0 and (role == "odometry" or not self._standing):
                self._paused_s += seconds
                return True
        return False

    def _is_stuck(self, now: float) -> bool:
        while self._recent and self._recent[0][0] < now - STUCK_S - 0.1:
            self._recent.popleft()
        asked, moved, since_s = self._asked_and_moved(STUCK_S)
        is_turn = (self._squaring or self._course or Turn).is_turn
        least, most_push = (STUCK_RAD, MOST_PUSHED * PUSH_RADPS2) if is_turn else (STUCK_M, MOST_PUSHED * PUSH_MPS2)
        fastest = STEER_MOST if self._squaring else self._fastest
        if abs(self._speed) < fastest and self._push[is_turn] < most_push:  # a faster command may move it yet
            return False
        return since_s > STUCK_S * 0.9 and asked > least and moved < STUCK_SHARE * asked


def _stuck(topic: str) -> str:
    doubts = "Is the robot free, are its motors on, is the speed high enough?"
    return f"The robot was commanded to move for {STUCK_S:g} s, but {topic} shows no motion. {doubts}"


def _pose_of(message: Any) -> Pose:
    """Return the pose in a nav_msgs/msg/Odometry or another message with a pose. Raises `ValueError` with the reason if
    the pose is not finite or has no heading.
    """
    within = "pose.pose" if hasattr(message.pose, "pose") else "pose"
    pose = getattr(message.pose, "pose", message.pose)
    at, q = pose.position, pose.orientation
    if why := not_finite(pose, "position", "orientation", within=within):
        raise ValueError(why)
    if not (q.x or q.y or q.z or q.w):
        raise ValueError(f"{within}.orientation is not set: 0, 0, 0, 0")
    return Pose(at.x, at.y, yaw_rad(q.x, q.y, q.z, q.w))


def _mean(poses: Sequence[Pose]) -> Pose:
    return Pose(*(sum(each) / len(poses) for each in zip(*poses, strict=True)))
