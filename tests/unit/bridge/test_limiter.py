"""Under a policy nothing over its limits leaves the bridge, whatever the server or another node gives it.

The bytes are what rclpy serialized, and are judged by hand; time is the test's own, so that nothing waits.
"""

from __future__ import annotations

import gc
import itertools
import math
import random
import struct
from collections import Counter
from collections.abc import Callable, Iterator
from types import SimpleNamespace
from typing import Any

import pytest

pytest.importorskip("rclpy", reason="needs the ROS 2 wheels")

from ros2_mcp_bridge.epoch import StopEpoch
from ros2_mcp_bridge.exit.limiter import Limiter
from ros2_mcp_bridge.exit.velocities import Velocities
from ros2_mcp_bridge.request import Cancelled, OperationError, Request, Steps
from ros2_mcp_bridge.ros import interfaces, rcl
from ros2_mcp_bridge.topics import publishers
from ros2_mcp_bridge.topics.publishers import Publisher
from ros2_mcp_common.policy.checks import Checks
from ros2_mcp_common.policy.fields import QuickCheck
from ros2_mcp_common.policy.flight import SET_MODE
from ros2_mcp_common.policy.ramp import Ramp
from ros2_mcp_common.policy.rules import Allowance, Limit, Rules, RuleSet
from ros2_mcp_common.policy.rules import Ramp as LimitRamp
from support.agent import FULL
from support.aliases import aliases
from support.limits import (
    ANGULAR,
    DOWN,
    HOLD_S,
    LINEAR,
    RATE_HZ,
    SET_BOOL,
    STEP_S,
    TRIGGER,
    TURN,
    UP,
    Middleware,
    body,
    over,
    rules,
    steepness,
    vectors,
    without_limiter,
)
from support.velocities import TWIST, TWIST_STAMPED, cdr, hostile_bytes

HOSTILE = 1_000_000 if FULL else 2_000
SEQUENCES = 10_000 if FULL else 60
ALIASES = 5_000
KINDS = (TWIST, TWIST_STAMPED)
WAYS = ("publish", "repeat", "move", "relay")
"""What a feed or a playback hands over passes as its relay's."""
FLOAT64 = "std_msgs/msg/Float64"
ARRAY = "std_msgs/msg/Float64MultiArray"
TOPIC = "/robot/cmd_vel"


class Bench:
    """The bridge's real publishers with their limits, a middleware that keeps what comes, and a clock that is set."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch, given: bytes | None) -> None:
        self.now = 1000.0
        self.steps: list[Steps[None]] = []
        self.limiter = Limiter(True, self.steps.append, lambda: self.now)
        if given is not None:
            self.limiter.take(given)
        self.middleware = Middleware(lambda: self.now)
        clock = SimpleNamespace(forget=lambda _: None, follow=lambda: None, now_ns=lambda *_: int(self.now * 1e9))
        self.velocities = Velocities(clock, lambda _: None)  # type: ignore[arg-type]
        monkeypatch.setattr(rcl, "publisher", lambda *_: self.middleware)
        assert publishers.rcl is rcl

    def request(self, op: str, topic: str = TOPIC, kind: str = TWIST, **more: Any) -> Request:
        request = Request({"id": 1, "op": op, "topic": topic, "type": kind, "qos": {}, **more}, b"")
        request.interface = interfaces.load(kind)
        return request

    def publisher(self, op: str = "publish", topic: str = TOPIC, kind: str = TWIST) -> Publisher:
        """A publisher, whose topic is driven where it moves something."""
        request = self.request(op, topic, kind)
        made = Publisher(
            node=object(),  # type: ignore[arg-type]
            graph=object(),  # type: ignore[arg-type]
            velocities=self.velocities,
            limiter=self.limiter,
            joint_states=object(),  # type: ignore[arg-type]
            request=request,
        )
        if made.velocity is not None:
            made.velocity.holders[request] = None
        return made

    def send(self, publisher: Publisher, data: bytes, request: Request) -> bool:
        """Whether it has left; nothing but a refusal keeps it."""
        try:
            publisher.publish(publisher.outgoing(data, request), request)
        except OperationError as refusal:
            assert refusal.kind in ("refused", "bad_request")
            return False
        return True

    def sent(self, kind: str = TWIST) -> list[tuple[float, list[float], list[float]]]:
        """When what came, as linear and angular velocity."""
        return [(at, *vectors(kind, data)) for at, data in self.middleware.came]


@pytest.fixture
def bench(monkeypatch: pytest.MonkeyPatch) -> Callable[..., Bench]:
    usual = body(rules())
    return lambda given=usual: Bench(monkeypatch, given)


# ── what is over a limit ───────────────────────────────────────────────────────────────────────────────────────────


def near_limits(kind: str, dice: random.Random) -> Iterator[bytes]:
    """What a test of limits needs beside odd bytes: numbers just below, at and above them, on one axis or on all."""
    around = (LINEAR, math.nextafter(LINEAR, 1), LINEAR * (1 + 1e-9), ANGULAR, math.nextafter(ANGULAR, 1), -LINEAR, 5.0)
    while True:
        value, rest = dice.choice(around), dice.choice((0.0, 0.0, -0.0, 5e-324, 1e-9, LINEAR))
        yield cdr(kind, value, rest=rest, order=dice.choice("<>"))


def over_limit(bench: Bench, kind: str, count: int) -> tuple[int, int, list[str]]:
    """Hostile messages by all ways: how many left, how many were made smaller, and what left over a limit."""
    dice, found, left = random.Random(kind), list[str](), 0
    publisher = bench.publisher(kind=kind)
    requests = [bench.request(op, kind=kind) for op in WAYS]
    sources = hostile_bytes(kind, 7), near_limits(kind, dice)
    for number in range(count):
        bench.now += dice.choice((0.0, 0.001, 0.02, 0.3))
        bench.send(publisher, next(sources[number % 2]), dice.choice(requests))
        if number % 100 == 0 and publisher.velocity is not None:
            publisher.velocity.send_zero()  # the will, and the final zero
        for _, data in bench.middleware.came:
            left += 1
            try:
                if problem := over(*vectors(kind, data)):
                    found.append(problem)
            except AssertionError as error:
                found.append(str(error))
        bench.middleware.came.clear()
    return left, count - left, found


@pytest.mark.timeout(1800 if FULL else 60)
@pytest.mark.parametrize("kind", KINDS)
def test_nothing_over_a_limit_leaves_whatever_comes_in(bench, kind: str) -> None:
    left, held_back, found = over_limit(bench(body(rules(rate_hz=None))), kind, HOSTILE // len(KINDS))
    assert found == []
    assert left > HOSTILE / 20 and held_back > HOSTILE / 20


@pytest.mark.parametrize("kind", KINDS)
def test_without_the_limiter_that_would_be_noticed(bench, kind: str) -> None:
    with without_limiter():
        assert over_limit(bench(), kind, 1000)[2]


def test_a_call_over_the_limit_is_refused_and_says_what_is_allowed(bench) -> None:
    it = bench()
    publisher, request = it.publisher(), it.request("publish")
    with pytest.raises(OperationError) as refused:
        publisher.outgoing(cdr(TWIST, 0.41), request)
    assert refused.value.kind == "refused"
    assert "linear is 0.41, at most 0.4 is allowed (limits.base)" in refused.value.message


def test_a_stream_over_the_limit_is_scaled_as_a_whole_and_keeps_its_curvature(bench) -> None:
    it = bench(body(rules(ramp=False)))
    publisher, request = it.publisher("relay"), it.request("relay")
    message = interfaces.load(TWIST)()
    message.linear.x, message.angular.z = 2.0, 1.0
    assert it.send(publisher, rcl.serialize(message), request)
    [(_, linear, angular)] = it.sent()
    assert linear[0] == pytest.approx(LINEAR, rel=2e-6)
    assert linear[0] / angular[2] == pytest.approx(2.0)


def test_a_relay_says_of_how_many_messages_less_was_sent(bench) -> None:
    it = bench(body(rules(ramp=False)))
    publisher, request = it.publisher("relay"), it.request("relay")
    told = [publisher.publish(publisher.outgoing(cdr(TWIST, x), request), request) for x in (0.3, 0.5, 0.4)]
    assert told == [False, True, False]


# ── ramps, and the time ────────────────────────────────────────────────────────────────────────────────────────────


def steepest(bench: Bench, dice: random.Random) -> tuple[float, int]:
    """Random commands of two clients, zeros, stops, a clock that steps: the steepest step, and zeros held back."""
    publisher = bench.publisher()
    requests, held = [bench.request(op) for op in ("repeat", "relay")], 0
    for _ in range(dice.randrange(5, 40)):
        bench.now += dice.choice((0.0, 1e-6, 0.01, 0.02, 0.1, 0.5, 30.0)) * dice.random()
        way = dice.randrange(12)
        if way == 0 and publisher.velocity is not None:
            publisher.velocity.send_zero()
        elif way == 1:
            moved = any(map(any, bench.sent()[-1][1:])) if bench.middleware.came else False
            held += moved and not bench.send(publisher, cdr(TWIST, 0.0), dice.choice(requests))
        else:
            message = interfaces.load(TWIST)()
            message.linear.x, message.angular.z = dice.uniform(-LINEAR, LINEAR), dice.uniform(-ANGULAR, ANGULAR)
            bench.send(publisher, rcl.serialize(message), dice.choice(requests))
    worst, before = 0.0, (-math.inf, [0.0] * 3, [0.0] * 3)
    for now in bench.sent():
        seconds = now[0] - before[0]
        worst = max(worst, steepness(before[1], now[1], seconds, UP, DOWN))
        worst = max(worst, steepness(before[2], now[2], seconds, TURN, TURN))
        before = now
    return worst, held


@pytest.mark.timeout(1800 if FULL else 60)
def test_no_sequence_of_commands_is_steeper_than_its_ramp_and_no_zero_is_held_back(bench) -> None:
    dice = random.Random(12)
    found = [steepest(bench(), dice) for _ in range(SEQUENCES)]
    assert max(worst for worst, _ in found) <= 1.01
    assert max(worst for worst, _ in found) > 0.99  # and no slower than it may be
    assert sum(held for _, held in found) == 0


def test_without_the_limiter_ramps_would_be_noticed(bench) -> None:
    with without_limiter():
        assert steepest(bench(), random.Random(12))[0] > 1.01


def test_a_command_from_rest_begins_with_what_a_tenth_of_a_second_allows(bench) -> None:
    it = bench()
    publisher, request = it.publisher(), it.request("repeat")
    message = publisher.outgoing(cdr(TWIST, LINEAR), request)
    for _ in range(10):
        publisher.publish(message, request)
        it.now += STEP_S
    speeds = [linear[0] for _, linear, _ in it.sent()]
    assert speeds == pytest.approx([min(LINEAR, UP * STEP_S * (number + 1)) for number in range(10)])


def test_what_stands_still_on_its_ramps_is_not_held_back_only_because_something_else_is_left() -> None:
    """As a car that keeps its steering while it stops; but of a position zero is no stop."""
    for zero_stops in (True, False):
        ramp, message = Ramp({"linear": (UP, DOWN)}, zero_stops=zero_stops), interfaces.load(TWIST)()
        message.linear.x, message.angular.z = 0.3, 0.2
        ramp.has_left(message, 0.0) if ramp.hold_back(message, 0.0) else None
        before, message.linear.x = message.linear.x, 0.0
        ramp.hold_back(message, 0.001)
        assert message.linear.x == (0.0 if zero_stops else pytest.approx(before - DOWN * 0.001))


def test_more_often_than_the_rate_nothing_leaves(bench) -> None:
    it = bench(body(rules(ramp=False)))
    publisher, request = it.publisher(), it.request("repeat")
    for _ in range(10_000):
        it.send(publisher, cdr(TWIST, 0.1), request)
        it.now += 0.001
    assert len(it.sent()) == pytest.approx(10 * RATE_HZ, abs=RATE_HZ * 0.1 + 2)


def test_zeros_that_end_nothing_have_a_rate_too(bench) -> None:
    """A thousand a second would take the robot from whoever else steers it."""
    it = bench()
    publisher, request = it.publisher(), it.request("repeat")
    for _ in range(10_000):
        it.send(publisher, cdr(TWIST, 0.0), request)
        it.now += 0.001
    assert len(it.sent()) == pytest.approx(10 * RATE_HZ, abs=RATE_HZ * 0.1 + 2)


def test_the_publisher_of_a_command_that_holds_is_kept_until_its_zero(bench) -> None:
    it = bench(body(rules(ramp=False)))
    publisher = it.publisher()
    assert publisher.velocity is not None
    publisher.velocity.holders.clear()
    assert not publisher.is_needed()
    publisher.velocity.holders[it.request("failsafe_publish")] = None
    it.send(publisher, cdr(TWIST, 0.3), it.request("publish"))
    publisher.velocity.holders.clear()
    assert publisher.is_needed()
    [hold] = it.steps
    next(hold)
    it.now += HOLD_S
    assert list(hold) == []
    assert not publisher.is_needed()


def test_a_command_that_is_not_renewed_ends_with_a_zero_after_its_hold_time(bench) -> None:
    it = bench(body(rules(ramp=False)))
    publisher, request = it.publisher(), it.request("publish")
    it.send(publisher, cdr(TWIST, 0.3), request)
    [hold] = it.steps
    it.now += 0.3
    assert next(hold) == pytest.approx(HOLD_S - 0.3)
    it.send(publisher, cdr(TWIST, 0.3), request)
    it.now += HOLD_S - 0.1
    assert next(hold) == pytest.approx(0.1)
    assert all(any(linear) for _, linear, _ in it.sent())
    it.now += 0.1
    assert list(hold) == []
    assert [any(linear) for _, linear, _ in it.sent()] == [True, True, False, False]
    it.send(publisher, cdr(TWIST, 0.3), request)
    assert len(it.steps) == 2  # the next one is watched, too


def test_a_request_that_commands_for_longer_than_it_may_is_ended_with_a_zero(bench) -> None:
    it = bench(body(rules(ramp=False, hold_s=None, for_s=10.0)))
    publisher, first, second = it.publisher(), it.request("relay"), it.request("relay")
    sent = []
    for _ in range(13):
        sent.append(it.send(publisher, cdr(TWIST, 0.3), first))
        it.now += 1.0
    assert sent == [True] * 12 + [False]
    assert [any(linear) for _, linear, _ in it.sent()] == [True] * 12 + [False, False]
    assert it.send(publisher, cdr(TWIST, 0.3), second)


def test_in_a_minute_no_more_calls_and_commands_leave_than_allowed(bench) -> None:
    it, ask = bench(body(rules(ramp=False, rate_hz=None, per_minute=3))), interfaces.load(SET_BOOL).Request(data=True)
    publisher, outcomes = it.publisher(), []
    for _ in range(14):
        request = it.request("publish")
        outcomes.append((call(it, "/lamp", SET_BOOL, ask) == "", it.send(publisher, cdr(TWIST, 0.1), request)))
        assert it.send(publisher, cdr(TWIST, 0.1), request) == outcomes[-1][1]  # one repeat counts once
        it.now += 10.0
    assert outcomes == [*[(True, True)] * 3, *[(False, False)] * 3] * 2 + [(True, True)] * 2


def test_a_zero_needs_no_hold_and_no_second_zero(bench) -> None:
    it = bench()
    it.send(it.publisher(), cdr(TWIST, 0.0), it.request("publish"))
    assert it.steps == []


# ── what is not allowed ────────────────────────────────────────────────────────────────────────────────────────────


def bypasses(bench: Bench) -> tuple[list[tuple[str, str, str]], int]:
    """Which of 5,000 spellings are judged otherwise than they should be, by any way; and how many may publish."""
    found: list[tuple[str, str, str]] = []
    allowed = 0
    for name, kind, is_right in itertools.islice(aliases(random.Random(3)), ALIASES):
        for op in (*WAYS, "failsafe_publish"):
            request = Request({"id": 1, "op": op, "topic": name, "type": kind, "qos": {}}, b"")
            try:
                bench.limiter.topic(request)
            except OperationError as refused:
                assert refused.kind == "refused"
                found += [(op, name, kind)] if is_right else []
            else:
                allowed += 1
                found += [] if is_right else [(op, name, kind)]
    return found, allowed


def test_no_spelling_of_a_name_or_type_goes_round_the_rules(bench) -> None:
    found, allowed = bypasses(bench())
    assert found == []
    assert allowed > ALIASES / 10


def test_without_the_limiter_spellings_would_be_noticed(bench) -> None:
    with without_limiter():
        assert bypasses(bench())[0]


def test_a_command_that_a_stop_has_overtaken_leaves_nothing_moving(bench) -> None:
    it = bench()
    publisher, request, stops = it.publisher(), it.request("publish"), StopEpoch()
    request.acceptance = stops.accept(0)
    stops.raise_to(1)
    with pytest.raises(Cancelled):
        publisher.publish(publisher.outgoing(cdr(TWIST, 0.1), request), request)
    assert publisher.velocity is not None and not publisher.velocity.moves


@pytest.mark.parametrize("path", ["data", "data[]"])
def test_a_first_message_with_an_empty_list_does_not_let_the_next_ones_pass(bench, path: str) -> None:
    bounded = Allowance("allow[0]", "publish", ("/arm",), (ARRAY,), Checks(range={path: (-1.0, 1.0)}))
    it = bench(body(Rules("", (RuleSet("arm", (bounded,)),))))
    publisher, request = it.publisher(topic="/arm", kind=ARRAY), it.request("publish", "/arm", ARRAY)
    message = interfaces.load(ARRAY)()
    assert it.send(publisher, rcl.serialize(message), request)
    message.data = [0.5, 9.0]
    assert not it.send(publisher, rcl.serialize(message), request)


def test_the_quick_check_says_nothing_else_than_the_judge() -> None:
    dice, message = random.Random(1), interfaces.load(TWIST_STAMPED)()
    ruling = rules().topic(TOPIC, TWIST_STAMPED)
    quick, agreed = QuickCheck.of([limit.checks for limit in ruling.limits], message), Counter[bool]()
    assert quick
    for data in itertools.islice(near_limits(TWIST_STAMPED, dice), 2000):
        message = rcl.deserialize(data, interfaces.load(TWIST_STAMPED))
        is_within = quick.is_within(message)
        assert is_within == (ruling.judge(message).problem == "")
        agreed[is_within] += 1
    assert min(agreed.values()) > 100


def call(bench: Bench, service: str, kind: str, message: Any = None) -> str:
    """Why a request may not leave; empty if it may."""
    request = Request({"id": 1, "op": "call", "service": service, "type": kind}, b"")
    try:
        bench.limiter.check_call(request, message, leaves=True)
    except OperationError as refused:
        assert refused.kind == "refused"
        return refused.message
    return ""


def test_what_makes_a_vehicle_stand_leaves_without_a_rule_unless_a_client_calls_it(bench) -> None:
    brake, fly = (SimpleNamespace(base_mode=0, custom_mode=mode) for mode in ("BRAKE", "AUTO"))
    it = bench()
    assert call(it, "/mavros/set_mode", SET_MODE, brake) == ""
    assert "not allowed" in call(it, "/mavros/set_mode", SET_MODE, fly)
    request = Request({"id": 1, "op": "call", "service": "/mavros/set_mode", "type": SET_MODE}, b"")
    request.acceptance = StopEpoch().accept(0.0)
    with pytest.raises(OperationError, match="not allowed"):
        it.limiter.check_call(request, brake, leaves=True)


def test_a_service_is_called_only_by_rule_and_within_its_limits(bench) -> None:
    it, ask = bench(), interfaces.load(SET_BOOL).Request
    assert call(it, "/lamp", SET_BOOL, ask(data=True)) == ""
    assert "data is False, only True is allowed" in call(it, "/lamp", SET_BOOL, ask(data=False))
    assert "not allowed" in call(it, "/siren", SET_BOOL, ask(data=True))
    assert "not allowed" in call(it, "/lamp", TRIGGER, None)
    assert "not a full ROS name" in call(it, "lamp", SET_BOOL, ask(data=True))


@pytest.mark.parametrize(
    ("service", "kind"),
    [
        ("/load", "composition_interfaces/srv/LoadNode"),
        ("/driver/set_parameters", "rcl_interfaces/srv/SetParameters"),
        ("/driver/set_parameters_atomically", "rcl_interfaces/srv/SetParametersAtomically"),
        ("/driver/change_state", "lifecycle_msgs/srv/ChangeState"),
        ("/nav/_action/send_goal", "nav2_msgs/action/NavigateToPose_SendGoal"),
        ("/lamp", "action_msgs/srv/CancelGoal"),
    ],
)
def test_what_means_more_than_a_call_needs_its_own_rule(bench, service: str, kind: str) -> None:
    assert "not allowed" in call(bench(), service, kind)


def test_what_reads_and_what_cancels_needs_no_rule(bench) -> None:
    it = bench()
    assert call(it, "/driver/get_parameters", "rcl_interfaces/srv/GetParameters") == ""
    assert call(it, "/nav/_action/cancel_goal", "action_msgs/srv/CancelGoal") == ""
    assert call(it, "/nav/_action/get_result", "nav2_msgs/action/NavigateToPose_GetResult") == ""


# ── before the rules, and without a policy ─────────────────────────────────────────────────────────────────────────


def test_until_the_rules_have_come_nothing_leaves_but_zeros(bench) -> None:
    it = bench(None)
    for op in WAYS:
        with pytest.raises(OperationError) as refused:
            it.publisher(op)
        assert "has not received its policy yet" in refused.value.message
    assert "has not received its policy yet" in call(it, "/lamp", SET_BOOL)
    assert "has not received its policy yet" in call(it, "/driver/get_parameters", "rcl_interfaces/srv/GetParameters")
    publisher = it.publisher("failsafe_publish")
    assert publisher.velocity is not None
    publisher.velocity.send_zero()
    assert not it.send(publisher, cdr(TWIST, 0.1), it.request("publish"))
    assert [any(linear) for _, linear, _ in it.sent()] == [False, False]
    it.limiter.take(body(rules()))
    assert it.send(publisher, cdr(TWIST, 0.1), it.request("publish"))


@pytest.mark.parametrize("given", [b"", b"[]", b"{}", b"null", b'{"digest": 1}', body(rules())[:-1]])
def test_rules_that_cannot_be_read_open_nothing(bench, given: bytes) -> None:
    it = bench(None)
    with pytest.raises(OperationError):
        it.limiter.take(given)
    with pytest.raises(OperationError):
        it.publisher()


def test_without_a_policy_nothing_is_held_back(bench) -> None:
    it = bench(None)
    it.limiter.is_under_policy = False
    publisher = it.publisher(topic="/anything", kind=FLOAT64)
    assert it.send(publisher, rcl.serialize(interfaces.load(FLOAT64)(data=1e9)), it.request("publish", kind=FLOAT64))
    assert it.send(it.publisher(), cdr(TWIST, 1e9), it.request("publish"))
    assert call(it, "anything", "any/srv/Type") == ""


# ── what is remembered ─────────────────────────────────────────────────────────────────────────────────────────────


def thrust(**limits: Any) -> bytes:
    """A policy for a type that is no velocity: published and relayed 10 times a second, and whatever a limit says."""
    allowed = [
        Allowance(verb, verb, ("/thrust",), (FLOAT64,), rate_hz=10.0, sources=("/**",)) for verb in ("publish", "relay")
    ]
    return body(Rules("", (RuleSet("thrust", tuple(allowed), (), (Limit("limit", (FLOAT64,), **limits),)),)))


def float64(value: float) -> bytes:
    return rcl.serialize(interfaces.load(FLOAT64)(data=value))


def test_a_new_publisher_begins_neither_rate_nor_ramp_anew(bench) -> None:
    it, left = bench(thrust(ramp={"data": LimitRamp(1.0, 1.0)})), 0
    request = it.request("relay", "/thrust", FLOAT64, source="/source")
    for _ in range(100):
        publisher = it.publisher("relay", "/thrust", FLOAT64)
        left += it.send(publisher, float64(3.0), request)
        publisher.destroy()
        del publisher
        gc.collect(0)
        it.now += 0.05
    came = [struct.unpack("<d", data[4:])[0] for _, data in it.middleware.came]
    assert left <= 5 * 10 + 2
    assert came[-1] == pytest.approx(3.0)
    assert all(abs(after - before) <= 0.1 + 1e-9 for before, after in itertools.pairwise([0.0, *came]))


def test_what_holds_for_a_time_ends_through_every_publisher(bench, monkeypatch: pytest.MonkeyPatch) -> None:
    it, made = bench(thrust(hold_s=HOLD_S)), list[Middleware]()
    monkeypatch.setattr(rcl, "publisher", lambda *_: made.append(Middleware(lambda: it.now)) or made[-1])
    first, _ = it.publisher(topic="/thrust", kind=FLOAT64), it.publisher(topic="/thrust", kind=FLOAT64)
    assert it.send(first, float64(3.0), it.request("publish", "/thrust", FLOAT64))
    it.now += HOLD_S
    assert list(it.steps[-1]) == []
    assert [[data[4:] for _, data in each.came][-1:] for each in made] == [[bytes(8)]] * 2


def test_how_many_may_leave_in_a_minute_is_said_by_the_rule_of_that_way_alone(bench) -> None:
    few, many = (
        Allowance(verb, verb, ("/horn",), (FLOAT64,), per_minute=most, sources=("/**",))
        for verb, most in (("publish", 2), ("relay", 60))
    )
    it = bench(body(Rules("", (RuleSet("horn", (few, many)),))))
    publisher = it.publisher(topic="/horn", kind=FLOAT64)
    assert it.send(publisher, float64(0.0), it.request("relay", "/horn", FLOAT64, source="/source"))
    assert sum(it.send(publisher, float64(0.0), it.request("publish", "/horn", FLOAT64)) for _ in range(9)) == 1


def test_what_is_too_large_to_be_judged_in_time_is_refused(bench) -> None:
    bounded = Allowance("allow[0]", "publish", ("/arm",), (ARRAY,), Checks(range={"data[]": (-1.0, 1.0)}))
    it = bench(body(Rules("", (RuleSet("arm", (bounded,)),))))
    publisher, request = it.publisher(topic="/arm", kind=ARRAY), it.request("publish", "/arm", ARRAY)
    for many, why in ((20_001, "20001 elements"), (200_000, "bytes")):
        with pytest.raises(OperationError, match=why):
            publisher.outgoing(rcl.serialize(interfaces.load(ARRAY)(data=[0.5] * many)), request)
    assert it.send(publisher, rcl.serialize(interfaces.load(ARRAY)(data=[0.5] * 20_000)), request)
