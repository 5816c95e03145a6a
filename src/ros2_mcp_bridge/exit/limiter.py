"""What a policy lets leave this bridge, asked at its only two exits, of values that rclpy itself has decoded.

The server decides first, and gives the good errors. This holds also when the server is wrong: whatever is published or
called comes by here, and a bridge that is under a policy lets nothing but zeros out until it has its rules. See
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
from ros2_mcp_common.policy.feedback import rules_of
from ros2_mcp_common.policy.fields import QuickCheck, floats_of, put
from ros2_mcp_common.policy.flight import brakes
from ros2_mcp_common.policy.ramp import Bucket, PerMinute, Ramp
from ros2_mcp_common.policy.rules import Limit, Rules, Ruling, judged_part
from ros2_mcp_common.policy.trajectory_limits import LookAtJoints, nobody_measures
from ros2_mcp_common.policy.velocity import VELOCITY_TYPES
from ros2_mcp_common.policy.verbs import Verb, meaning
from ros2_mcp_common.wire.limits import MAX_JUDGED_BYTES
from ros2_mcp_common.wire.protocol import Spent

# ROS resolves other spellings to these (`cmd_vel`, `~/x`, `{node}`): rules judge the name that is meant, and no other.
_NAME = re.compile(r"(/[A-Za-z_][A-Za-z0-9_]*)+", re.ASCII)
# A repeat's or relay's own time begins when its first message was acknowledged, at most so long after it was sent.
BEGINS_S = 1.0
# After this time without a message a topic that has no publisher is forgotten: the slowest rate is one in 100 s.
FORGOTTEN_S = 120.0
# A rate below this one is a budget: after a bridge that has died, the next one is not there sooner than a message of
# a faster rate may leave. Chosen.
SLOW_HZ = 1.0
_WAYS: Mapping[str, Sequence[Verb]] = {
    "publish": ("publish",),
    "repeat": ("publish",),
    "move": ("publish",),
    "relay": ("relay", "play"),
    "failsafe_publish": ("publish", "relay", "play"),
}
"""What a request that publishes may be; only the server knows whether a relay that is fed plays a bag."""


def refused(problem: str) -> OperationError:
    """The error for what a policy does not let out; nothing of it was sent."""
    return OperationError("refused", problem, "ros2_policy shows what is allowed.")


def check_size(data: bytes) -> None:
    """Raise `OperationError` of kind `refused` for more than can be judged without holding up what else leaves."""
    if len(data) > MAX_JUDGED_BYTES:
        most = f"more than the {MAX_JUDGED_BYTES} that are judged where values have limits"
        raise refused(f"The policy of this robot: {len(data)} bytes are {most}.")


def is_zero(message: Any) -> bool:
    """Whether all numbers of a velocity command are zeros: it stops, and is never held back."""
    return not any(floats_of(message.__class__)[1](message))


class Limiter:
    """The rules of this bridge: none (`is_under_policy` is false), still to come, or taken; once taken they stay.

    `start` runs steps on the ROS thread's loop; `now` tells monotonic seconds. `send_event` tells the server what was
    used of a budget, which it keeps for the next bridge. `look_at_joints` tells where the joints of a trajectory are.
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
        self.start = start
        self.now = now
        self.send_event = send_event
        self._per_minute: dict[tuple[str, str], PerMinute] = {}
        self._left_at: dict[tuple[str, str], float] = {}
        self._topics: dict[tuple[str, str], TopicLimits] = {}

    def take(self, body: bytes) -> str:
        """Take the compiled rules, as JSON, and return their digest; raises `OperationError` of kind `bad_request`."""
        try:
            given = cast("Mapping[str, Any]", json.loads(body))
            rules = Rules.from_json(given)
            watch = cast("Mapping[str, Any]", given.get("watch", {}))
            rules_of(watch)  # what cannot be watched is no policy that is in force
            self._resume(given.get("spent", ()))
        except (ValueError, TypeError, KeyError, AttributeError) as error:
            raise OperationError("bad_request", f"These rules cannot be read: {error!r}") from error
        self.rules, self.is_under_policy, self.watch = rules, True, watch
        return rules.digest

    def resume(self, body: bytes) -> None:
        """Take over what other bridges have used of the budgets, as JSON; raises `OperationError` (`bad_request`)."""
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
        """The rate of a topic, which goes on where a bridge before this one had left it."""
        return Bucket(rate_hz, self._left_at.get(key, -math.inf))

    def spend(self, key: tuple[str, str], bound: Literal["per_minute", "rate_hz"]) -> None:
        """Tell that one more of that name and type was let out."""
        self.send_event({"event": "spent", "name": key[0], "type": key[1], "bound": bound})

    def topic(self, request: Request) -> TopicLimits:
        """What holds for the topic that a request names.

        Raises `OperationError` of kind `refused` for one that nothing allows. Until there are rules, a topic may be
        held ready for its zero.
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
        """Every command that holds for a time ends now, with its zero. From any thread."""
        for topic in list(self._topics.values()):
            topic.end()

    def publishing(self, name: str, type_name: str, ways: Sequence[Verb]) -> Ruling:
        """What holds for publishing on a topic; raises `OperationError` of kind `refused` where nothing allows it."""
        ruling = self._rules_for(name).topic(name, type_name, ways)
        if ruling.problem:
            raise refused(f"The policy of this robot: {ruling.problem} ({ruling.rule}).")
        return ruling

    def check_call(self, request: Request, message: Any, *, leaves: bool) -> None:
        """Raise `OperationError` of kind `refused` unless this request to a service may leave: it only reads, or the
        rules allow what it means, with these values. Cancelling goals stops, and so does making a vehicle stand where
        no call of a client asks for it (`acceptance`): they are never refused. One that `leaves` now counts for what
        may leave in a minute.
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
        if leaves and (most := ruling.most("per_minute")) is not None:
            self.check_minute(key, most)

    def calling(self, request: Request) -> Ruling | None:
        """What holds for the service that a request names, None where nothing does; raises `OperationError` of kind
        `refused` where no rule allows it.
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

    def check_minute(self, key: tuple[str, str], most: float) -> None:
        """Raise `OperationError` where one more would be too many; `key` is a name and a type."""
        if not self._per_minute.setdefault(key, PerMinute()).take(self.now(), most):
            raise refused(
                f"The policy of this robot: {key[0]} may be used {most:g} times a minute, and this limit is reached."
            )
        self.spend(key, "per_minute")

    def judge(self, ruling: Ruling, value: Any) -> None:
        """Raise `OperationError` of kind `refused` for a value that breaks a limit."""
        judged = ruling.judge(value, self.look_at_joints)
        if judged.problem:
            raise refused(f"The policy of this robot: {judged.problem} ({judged.rule}).")

    def _rules_for(self, name: str) -> Rules:
        """The rules; raises `OperationError` of kind `refused` while they have not come, or for an odd name."""
        if self.rules is None:
            raise refused("This bridge has not received its policy yet: it sends only zeros.")
        if not _NAME.fullmatch(name):
            raise refused(f"{name!r} is no full name of ROS: under a policy nothing else is judged.")
        return self.rules


def _ways(request: Request) -> Sequence[Verb]:
    return ("relay",) if request.has("source") else _WAYS[request.op]


class _Way:
    """What holds for one way of publishing on a topic."""

    def __init__(self, ruling: Ruling, bucket: Callable[[float], Bucket]) -> None:
        self.ruling = ruling
        rate_hz = ruling.most("rate_hz")
        self.bucket = None if rate_hz is None else bucket(rate_hz)
        self.is_slow = rate_hz is not None and rate_hz < SLOW_HZ
        self.for_s = ruling.most("for_s")
        self.has_curve = bool(ruling.curves)
        self._checks = _all_checks(ruling)
        self._quick: QuickCheck | None = None

    def is_within(self, message: Any) -> bool:
        """Whether a message is surely within all limits, found out quickly; if not, they have to judge it."""
        if self._checks:
            self._quick, self._checks = QuickCheck.of(self._checks, message), ()
        return self._quick is not None and self._quick.is_within(message)


def _all_checks(ruling: Ruling) -> Sequence[Checks]:
    """The checks that a value must pass, all of them; none where it is enough to pass one of several."""
    checks = [limit.checks for limit in ruling.limits]
    for policy in ruling.policies:
        allowed = [entry.checks for entry in policy.allow]
        if not any(each.is_empty for each in allowed):
            checks += allowed  # one would be enough: what passes all of them surely passes
    return checks


class TopicLimits:
    """What holds for one topic with one type, and what was sent there: rhythm, ramp, and how long the last one holds.

    `zeros` has for each publisher, or for all of a velocity topic, what sends the zero; that is called `hold_s` after
    the last command (0: never). Limits on values do not depend on the way of publishing, so that all ways share the
    ramp and the hold; nor do rates and ramps begin anew with another publisher.
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
        """Whether the message has to be decoded; raises `OperationError` of kind `refused`."""
        way = self._way(request)
        return way is not None and (way.ruling.needs_value or self._ramp is not None)

    def fit(self, message: Any, request: Request) -> bool:
        """Judge a message before anything is waited for: returns whether it was made smaller, as a stream's may be.

        Raises `OperationError` of kind `refused`.
        """
        way = self._way(request)
        if way is None or way.is_within(message):
            return False
        as_what = "stream" if request.op == "relay" else "tool"
        settled = way.ruling.settle(message, as_what, self._limiter.look_at_joints)
        if settled.problem:
            raise refused(f"The policy of this robot: {settled.problem} ({settled.rule}).")
        return settled.clamped

    @contextmanager
    def passing(self, message: Any, request: Request) -> Generator[bool, None, None]:
        """A context in which one message leaves, which `fit` has judged; None where nothing has to be known of it.
        Inside it holds what the ramp lets out now, and the context's value says whether that is less than was wanted.

        Raises `OperationError` of kind `refused`; then nothing may be sent.
        """
        way = self._way(request)
        if way is None:
            yield False
            return
        now = self._limiter.now()
        stops = self._type in VELOCITY_TYPES and message is not None and is_zero(message)
        if not (stops and self._moving_request):  # a zero that ends nothing would only talk over others
            self._check_time(way, request, now)
        is_ramped = self._ramp is not None and message is not None and not stops
        wanted: Mapping[str, float] = self._ramp.hold_back(message, now) if self._ramp and is_ramped else {}
        try:
            if (wanted and not way.is_within(message)) or way.has_curve:
                # It lies between two that may be; where only certain values may, not all between them may be. And the
                # joints may have moved since a trajectory was judged.
                self._limiter.judge(way.ruling, message)
            yield bool(wanted)
            self._has_left(message, request, now, stops=stops)
        finally:
            put(message, wanted)

    @property
    def is_held(self) -> bool:
        """Whether a command holds here that is still to be ended with a zero."""
        return bool(self._moving_until)

    def is_as_new(self) -> bool:
        """Whether nothing that was sent here matters any more. A joint stays where a ramp has led it."""
        has_place = self._ramp is not None and self._type not in VELOCITY_TYPES
        return not self.zeros and not has_place and self._limiter.now() - self._left_at > FORGOTTEN_S

    def end(self) -> None:
        """End what holds here with its zero. From any thread."""
        if self.is_held:
            self._send_zero()

    def rest(self) -> None:
        """A zero was sent here. From any thread."""
        self._moving_until, self._moving_request, self._rested_at = 0.0, None, self._limiter.now()
        if self._ramp:
            self._ramp.rest(self._rested_at)

    def _way(self, request: Request) -> _Way | None:
        """What holds for this request; None without a policy. Raises `OperationError` of kind `refused`."""
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
        """Raise `OperationError` where this request has published for longer, or the topic is commanded more often,
        than a rule allows.
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
            except Exception as error:  # noqa: BLE001 - the other publishers may reach who listens
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
        """Steps that wait until the last command has been held for its time, and then send the zero."""
        try:
            while (left_s := self._moving_until - self._limiter.now()) > 0.0:
                yield left_s
            self.end()
        finally:
            self._is_watched = False


def _rates_of(limits: Sequence[Limit]) -> Mapping[str, tuple[float, float]]:
    """The ramps of all these limits; where two name a path, the slower rates hold."""
    rates: dict[str, tuple[float, float]] = {}
    for limit in limits:
        for path, ramp in limit.ramp.items():
            up, down = (math.inf if rate is None else rate for rate in (ramp.up, ramp.down))
            before = rates.get(path, (up, down))
            rates[path] = min(up, before[0]), min(down, before[1])
    return rates
