"""The limiter: applies the policy at the bridge's only two exits (messages and service requests),
to values decoded by rclpy.

The server applies the policy first, and gives the detailed errors. The limiter holds even if the server is wrong: every
message and every request passes it. A bridge under a policy sends only zeros until it has received its rules. See
docs/decisions/0028-limits-in-the-bridge.md.
"""

from __future__ import annotations

import json
import math
import re
import sys
import time
from collections.abc import Callable, Generator, Mapping, Sequence
from contextlib import contextmanager
from functools import partial
from typing import Any, Literal, cast
from weakref import WeakKeyDictionary

from ros2_mcp_bridge.request import OperationError, Request, Steps
from ros2_mcp_common.policy.checks import Checks
from ros2_mcp_common.policy.feedback import Watchdog, rules_of
from ros2_mcp_common.policy.fields import QuickCheck, floats_of, put
from ros2_mcp_common.policy.flight import brakes
from ros2_mcp_common.policy.keep_out import STANDING_GOALS, STRAIGHT_GOALS
from ros2_mcp_common.policy.ramp import Bucket, PerMinute, Ramp
from ros2_mcp_common.policy.rules import Limit, Rules, Ruling, judged_part
from ros2_mcp_common.policy.trajectory_limits import LookAtJoints, nobody_measures
from ros2_mcp_common.policy.velocity import VELOCITY_TYPES, planar
from ros2_mcp_common.policy.verbs import CANCEL_GOAL, Verb, matches, meaning
from ros2_mcp_common.wire.limits import MAX_JUDGED_BYTES
from ros2_mcp_common.wire.protocol import Spent

# A fully qualified ROS name. ROS expands other spellings (`cmd_vel`, `~/x`, `{node}`); rules judge only the full name.
_NAME = re.compile(r"(/[A-Za-z_][A-Za-z0-9_]*)+", re.ASCII)
# A repeat or relay counts its own duration from the acknowledgement of its first message, which comes at most this long
# after that message was sent.
BEGINS_S = 1.0
# A topic without a publisher is forgotten after this time without a message. The slowest rate is one message in 100 s.
FORGOTTEN_S = 120.0
# A rate below this one is a budget that the next bridge takes over. A bridge takes at least 1 s to restart, so a faster
# rate needs no memory.
SLOW_HZ = 1.0
_WAYS: Mapping[str, Sequence[Verb]] = {
    "publish": ("publish",),
    "repeat": ("publish",),
    "move": ("publish",),
    "relay": ("relay", "play"),
    "failsafe_publish": ("publish", "relay", "play"),
}
"""The verbs that a request that publishes may stand for. Only the server knows whether a relay plays a bag."""


_NO_WATCHDOG = "the robot's pose is not known yet, and there are keep-out zones"


def refused(problem: str) -> OperationError:
    """Return the error for a message or request that the policy does not allow, of which nothing was sent."""
    return OperationError("refused", problem, "ros2_policy shows what is allowed.")


def check_size(data: bytes) -> None:
    """Raise `OperationError` of kind `refused` for a body so large that judging it would delay other traffic."""
    if len(data) > MAX_JUDGED_BYTES:
        most = f"more than the {MAX_JUDGED_BYTES} that are judged where values have limits"
        raise refused(f"The policy of this robot: {len(data)} bytes are {most}.")


def is_zero(message: Any) -> bool:
    """Return whether all numbers of a velocity command are zero.

    Such a command stops the robot and is never held back.
    """
    return not any(floats_of(message.__class__)[1](message))


class Limiter:
    """The policy of this bridge: none (`is_under_policy` is false), not received yet (`rules` is
    None), or in force for good.

    `start` runs steps on the ROS thread's loop; `now` returns monotonic seconds. `send_event` reports to the server
    what was used of a budget, which the server keeps for the next bridge. `look_at_joints` returns the positions of
    joints, from which trajectories are judged. `watchdog` judges velocities, and where goals start, by keep-out zones;
    it is there as soon as the rules are watched.
    """

    def __init__(
        self,
        is_under_policy: bool,
        start: Callable[[Steps[None]], object] = lambda _: None,
        now: Callable[[], float] = time.monotonic,
        send_event: Callable[[Spent], None] = lambda _: None,
    ) -> None:
        self.is_under_policy = is_under_policy
        self.rules: Rules | None = None
        self.watch: Mapping[str, Any] | None = None
        self.look_at_joints: LookAtJoints = nobody_measures
        self.watchdog: Watchdog | None = None
        self.start = start
        self.now = now
        self.send_event = send_event
        self._keeps_out = False
        self._per_minute: dict[tuple[str, str], PerMinute] = {}
        self._left_at: dict[tuple[str, str], float] = {}
        self._topics: dict[tuple[str, str], TopicLimits] = {}

    def take(self, body: bytes) -> str:
        """Put the compiled rules, given as JSON, in force and return their digest.

        Raises:
            OperationError: of kind `bad_request`, if the rules cannot be read.
        """
        try:
            given = cast("Mapping[str, Any]", json.loads(body))
            rules = Rules.from_json(given)
            watch = cast("Mapping[str, Any]", given.get("watch", {}))
            rules_of(watch)  # raises if the bridge could not watch what the policy asks for
            self._resume(given.get("spent", ()))
        except (ValueError, TypeError, KeyError, AttributeError) as error:
            raise OperationError("bad_request", f"These rules cannot be read: {error!r}") from error
        pose: Any = watch.get("pose") or {}
        self._keeps_out = bool(pose.get("keep_out"))
        self.rules, self.is_under_policy, self.watch = rules, True, watch
        return rules.digest

    def resume(self, body: bytes) -> None:
        """Take over what earlier bridges used of the budgets, given as JSON.

        Raises:
            OperationError: of kind `bad_request`, if the body cannot be read.
        """
        try:
            self._resume(json.loads(body))
        except (ValueError, TypeError) as error:
            raise OperationError("bad_request", f"These uses cannot be read: {error!r}") from error

    def _resume(self, used: Any) -> None:
        for name, type_name, bound, ages in cast("Sequence[tuple[str, str, str, Sequence[float]]]", used):
            key, left_at = (name, type_name), [self.now() - float(age_s) for age_s in ages]
            if bound == "per_minute":
                self._per_minute[key] = PerMinute(left_at)
            else:
                self._left_at[key] = max(left_at)

    def bucket(self, key: tuple[str, str], rate_hz: float) -> Bucket:
        """Return the rate limiter of a topic, continuing from the last message of an earlier bridge."""
        return Bucket(rate_hz, self._left_at.get(key, -math.inf))

    def spend(self, key: tuple[str, str], bound: Literal["per_minute", "rate_hz"]) -> None:
        """Report to the server that one more message or request of this name and type has passed."""
        self.send_event({"event": "spent", "name": key[0], "type": key[1], "bound": bound})

    def topic(self, request: Request) -> TopicLimits:
        """Return the limits of the topic that a request names.

        Before the rules have been received, only a `failsafe_publish` is accepted: it prepares the topic for its zero.

        Raises:
            OperationError: of kind `refused`, if no rule allows the topic or the source of the relay.
        """
        key = request.text("topic"), request.text("type")
        if self.is_under_policy and not (self.rules is None and request.op == "failsafe_publish"):
            ruling = self.publishing(*key, _ways(request))
            if request.has("source") and not ruling.allows_source(request.text("source")):
                raise refused(
                    f"The policy of this robot: {request.text('source')} is not an allowed source for {key[0]}."
                )
        found = self._topics.get(key)
        if found is None:
            kept = {name: each for name, each in self._topics.items() if not each.is_as_new()}
            self._topics = {**kept, key: TopicLimits(self, *key)}
        return self._topics[key]

    def end_held(self) -> None:
        """Send the zero on every topic where a command is being held for its hold time. Thread-safe."""
        for topic in list(self._topics.values()):
            topic.end()

    def publishing(self, name: str, type_name: str, ways: Sequence[Verb]) -> Ruling:
        """Return the ruling for publishing on a topic with these verbs.

        Raises:
            OperationError: of kind `refused`, if no rule allows it.
        """
        ruling = self._rules_for(name).topic(name, type_name, ways)
        if ruling.problem:
            raise refused(f"The policy of this robot: {ruling.problem} ({ruling.rule}).")
        return ruling

    def check_call(self, request: Request, message: Any, *, leaves: bool) -> None:
        """Raise `OperationError` of kind `refused` unless this service request may leave.

        It may leave if it only reads, or if the rules allow what it means with these values. Two kinds of request are
        never refused, because they stop the robot: cancelling goals, and stopping a vehicle, unless a client called
        the service itself (then the request has an `acceptance`). With `leaves`, the request leaves now and counts
        against the limit per minute.
        """
        if not request.acceptance and brakes(request.text("service"), request.text("type"), message):
            return
        ruling, key = self.calling(request), (request.text("service"), request.text("type"))
        if ruling is None:
            return
        if ruling.needs_value:
            check_size(request.body)
            try:
                self.judge(ruling, judged_part(meaning(*key).verb, message))
            except ValueError as error:
                raise refused(f"The policy of this robot: {error}.") from error
        meant = meaning(*key)
        if meant.verb == "goal" and not matches(STANDING_GOALS, meant.type):
            self.check_start(meant.type, message)
        if leaves and (most := ruling.most("per_minute")) is not None:
            self.check_minute(key, most)

    def calling(self, request: Request) -> Ruling | None:
        """Return the ruling for the service that a request names, or None without a policy and for cancelling goals.

        Raises:
            OperationError: of kind `refused`, if no rule allows the call.
        """
        if not self.is_under_policy:
            return None
        service, type_name = request.text("service"), request.text("type")
        rules = self._rules_for(service)
        if meaning(service, type_name).verb == "cancel":
            return None
        ruling = rules.service(service, type_name)
        if ruling.problem:
            raise refused(f"The policy of this robot: {ruling.problem} ({ruling.rule}).")
        return ruling

    @property
    def speed_of_goals(self) -> float:
        """The speed in m/s above which the watchdog ends goals; 0 if there is no such limit."""
        feedback: Any = (self.watch or {}).get("feedback") or {}
        return float(feedback.get("goals", {}).get("linear", 0.0))

    def may_cancel(self, action: str) -> bool:
        """Return whether the policy allows cancelling the goals of others of this action."""
        return self.rules is not None and not self.rules.ruling("cancel", action, CANCEL_GOAL).problem

    def watched_by(self, watchdog: Watchdog) -> None:
        """Take the watchdog, because it knows where the robot is."""
        self.watchdog = watchdog

    def check_start(self, type_name: str = "", request: Any = None) -> None:
        """Raise `OperationError` of kind `refused` if a goal may not drive the robot from where it is now, or one of
        `STRAIGHT_GOALS` may not drive as far as this request asks for.
        """
        if self._keeps_out:
            problem = self.watchdog.problem_of_start(self.now()) if self.watchdog else _NO_WATCHDOG
            if self.watchdog and not problem and (sign := STRAIGHT_GOALS.get(type_name)):
                length_m = abs(float(request.goal.target.x))
                problem = self.watchdog.problem_of_straight(sign * length_m, self.now())
            if problem:
                raise refused(f"The policy of this robot: {problem} (keep_out).")

    def check_velocity(self, message: Any) -> None:
        """Raise `OperationError` of kind `refused` if the robot could not stop before a keep-out zone."""
        if self._keeps_out and not is_zero(message):
            velocity = planar(message)
            problem = self.watchdog.problem_of_velocity(velocity, self.now()) if self.watchdog else _NO_WATCHDOG
            if problem:
                raise refused(f"The policy of this robot: {problem} (keep_out).")

    def check_minute(self, key: tuple[str, str], most: float) -> None:
        """Raise `OperationError` if one more use within this minute exceeds `most`; `key` is a name and a type."""
        if not self._per_minute.setdefault(key, PerMinute()).take(self.now(), most):
            raise refused(
                f"The policy of this robot: {key[0]} may be used {most:g} times a minute, and this limit is reached."
            )
        self.spend(key, "per_minute")

    def judge(self, ruling: Ruling, value: Any) -> None:
        """Raise `OperationError` of kind `refused` if the value exceeds a limit."""
        judged = ruling.judge(value, self.look_at_joints)
        if judged.problem:
            raise refused(f"The policy of this robot: {judged.problem} ({judged.rule}).")

    def _rules_for(self, name: str) -> Rules:
        """Return the rules.

        Raise `OperationError` of kind `refused` if they have not been received, or if `name` is no full name.
        """
        if self.rules is None:
            raise refused("This bridge has not received its policy yet: it sends only zeros.")
        if not _NAME.fullmatch(name):
            raise refused(f"{name!r} is not a full ROS name: a policy can judge only full names.")
        return self.rules


def _ways(request: Request) -> Sequence[Verb]:
    return ("relay",) if request.has("source") else _WAYS[request.op]


class _Way:
    """The limits of one way of publishing on a topic: directly, by a relay, or as a fail-safe."""

    def __init__(self, ruling: Ruling, bucket: Callable[[float], Bucket]) -> None:
        self.ruling = ruling
        rate_hz = ruling.most("rate_hz")
        self.bucket = None if rate_hz is None else bucket(rate_hz)
        self.is_slow = rate_hz is not None and rate_hz < SLOW_HZ
        self.for_s = ruling.most("for_s")
        self.has_curve = bool(ruling.curves)
        self.leads = any(limit.checks.keep_out for limit in ruling.limits)
        self._checks = _all_checks(ruling)
        self._quick: QuickCheck | None = None

    def is_within(self, message: Any) -> bool:
        """Return True if a quick check proves the message to be within all limits.

        False means that the full check has to decide.
        """
        if self._checks:
            self._quick, self._checks = QuickCheck.of(self._checks, message), ()
        return self._quick is not None and self._quick.is_within(message)


def _all_checks(ruling: Ruling) -> Sequence[Checks]:
    """Return the checks that prove a value to be allowed if it passes all of them."""
    checks = [limit.checks for limit in ruling.limits]
    for policy in ruling.policies:
        allowed = [entry.checks for entry in policy.allow]
        if not any(each.is_empty for each in allowed):
            checks += allowed  # a value needs to pass only one of them; passing all is a stricter test
    return checks


class TopicLimits:
    """The limits of one topic with one type, and the state they need: time of the last message,
    ramp, end of the hold time.

    `zeros` has, for each publisher or once for a velocity topic, a function that sends the zero. It is called `hold_s`
    after the last command (0: never). Limits on values are the same for all ways of publishing, so they share the ramp
    and the hold time. Another publisher resets neither rates nor ramps.
    """

    def __init__(self, limiter: Limiter, name: str, type_name: str) -> None:
        self._limiter = limiter
        self._name, self._type = name, type_name
        self._ways: dict[Sequence[Verb], _Way] = {}
        self._began: WeakKeyDictionary[Request, float] = WeakKeyDictionary()
        self._ramp: Ramp | None = None
        self._moving_until = 0.0
        self._moving_request: Request | None = None
        self._rested_at = -math.inf
        self._left_at = self._rested_at
        self._is_watched = False
        self.hold_s = 0.0
        self.zeros: dict[object, Callable[[], None]] = {}

    def needs_value(self, request: Request) -> bool:
        """Return whether the message has to be decoded.

        Raise `OperationError` of kind `refused` if no rule allows the topic.
        """
        way = self._way(request)
        return way is not None and (way.ruling.needs_value or self._ramp is not None)

    def fit(self, message: Any, request: Request) -> bool:
        """Judge a message before waiting for anything else, and return whether it was clamped to the limits.

        Only the messages of a stream, such as a relay, are clamped.

        Raises:
            OperationError: of kind `refused`, if the message exceeds a limit and may not be clamped.
        """
        way = self._way(request)
        if way is None:
            return False
        if self._type in VELOCITY_TYPES:
            self._limiter.check_velocity(message)
        elif way.leads:
            self._limiter.check_start()
        if way.is_within(message):
            return False
        as_what = "stream" if request.op == "relay" else "tool"
        settled = way.ruling.settle(message, as_what, self._limiter.look_at_joints)
        if settled.problem:
            raise refused(f"The policy of this robot: {settled.problem} ({settled.rule}).")
        return settled.clamped

    @contextmanager
    def passing(self, message: Any, request: Request) -> Generator[bool, None, None]:
        """A context manager in which one message, already judged by `fit`, is sent.

        Inside the context, the message holds the values that the ramp allows now, and the context's value is
        True if they are less than requested; afterwards the message has its own values again. `message` is
        None if no rule needs its value.

        Raises:
            OperationError: of kind `refused`; then nothing may be sent.
        """
        way = self._way(request)
        if way is None:
            yield False
            return
        now = self._limiter.now()
        stops = self._type in VELOCITY_TYPES and message is not None and is_zero(message)
        if not (stops and self._moving_request):  # a zero that ends no motion has no priority
            self._check_time(way, request, now)
        is_ramped = self._ramp is not None and message is not None and not stops
        wanted: Mapping[str, float] = self._ramp.hold_back(message, now) if self._ramp and is_ramped else {}
        try:
            if (wanted and not way.is_within(message)) or way.has_curve:
                # The ramped value lies between two allowed values, but where only certain values are allowed, not all
                # between them are. And the joints may have moved since a trajectory was judged.
                self._limiter.judge(way.ruling, message)
            yield bool(wanted)
            self._has_left(message, request, now, stops=stops)
        finally:
            put(message, wanted)

    @property
    def is_held(self) -> bool:
        """Whether a command is in its hold time, at the end of which the zero is due."""
        return bool(self._moving_until)

    def is_as_new(self) -> bool:
        """Return whether everything that was sent on this topic is too old to matter.

        A ramp on joints always matters: joints keep their place.
        """
        has_place = self._ramp is not None and self._type not in VELOCITY_TYPES
        return not self.zeros and not has_place and self._limiter.now() - self._left_at > FORGOTTEN_S

    def end(self) -> None:
        """Send the zero if a command is in its hold time. Thread-safe."""
        if self.is_held:
            self._send_zero()

    def rest(self) -> None:
        """Record that a zero was sent here. Thread-safe."""
        self._moving_until, self._moving_request, self._rested_at = 0.0, None, self._limiter.now()
        if self._ramp:
            self._ramp.rest(self._rested_at)

    def _way(self, request: Request) -> _Way | None:
        """Return the limits for this request, or None without a policy. Raise `OperationError` of kind `refused`."""
        if not self._limiter.is_under_policy:
            return None
        ways = _ways(request)
        found = self._ways.get(ways)
        if found is None:
            ruling = self._limiter.publishing(self._name, self._type, ways)
            found = self._ways[ways] = _Way(ruling, partial(self._limiter.bucket, (self._name, self._type)))
            self.hold_s = ruling.hold_s or 0.0
            rates = _rates_of(ruling.limits)
            if rates and not self._ramp:
                self._ramp = Ramp(rates, self._rested_at, zero_stops=self._type in VELOCITY_TYPES)
        return found

    def _check_time(self, way: _Way, request: Request, now: float) -> None:
        """Raise `OperationError` of kind `refused` if this request has published for longer, or the topic gets messages
        more often, than a rule allows.
        """
        began = self._began.get(request)
        if began is None:
            if (most := way.ruling.most("per_minute")) is not None:
                self._limiter.check_minute((self._name, self._type), most)
            began = self._began[request] = now
        if way.for_s is not None and now - began > way.for_s + BEGINS_S:
            if self._moving_request is request:
                self._send_zero()
            raise refused(f"The policy of this robot: {self._name} has been commanded for {way.for_s:g} s.")
        if way.bucket is not None and not way.bucket.take(now):
            most_hz = way.ruling.most("rate_hz")
            raise refused(f"The policy of this robot: {self._name} is commanded more than {most_hz:g} times a second.")
        if way.is_slow:
            self._limiter.spend((self._name, self._type), "rate_hz")

    def _send_zero(self) -> None:
        for send in list(self.zeros.values()):
            try:
                send()
            except Exception as error:  # noqa: BLE001 - the other publishers may reach the subscribers
                sys.stderr.write(f"{self._name} did not get its zero: {error}\n")
        self.rest()

    def _has_left(self, message: Any, request: Request, now: float, *, stops: bool) -> None:
        self._left_at = now
        if stops:
            self.rest()
            return
        self._moving_request = request
        if self._ramp and message is not None:
            self._ramp.has_left(message, now)
        if self.hold_s:
            self._moving_until = now + self.hold_s
            if not self._is_watched:
                self._is_watched = True
                self._limiter.start(self._hold())

    def _hold(self) -> Steps[None]:
        """Steps that send the zero when the hold time of the last command is over."""
        try:
            while (left_s := self._moving_until - self._limiter.now()) > 0.0:
                yield left_s
            self.end()
        finally:
            self._is_watched = False


def _rates_of(limits: Sequence[Limit]) -> Mapping[str, tuple[float, float]]:
    """Return the ramps of all limits by path, as (up, down) per second.

    If two limits name a path, the slower rates hold.
    """
    rates: dict[str, tuple[float, float]] = {}
    for limit in limits:
        for path, ramp in limit.ramp.items():
            up, down = (math.inf if rate is None else rate for rate in (ramp.up, ramp.down))
            before = rates.get(path, (up, down))
            rates[path] = min(up, before[0]), min(down, before[1])
    return rates
