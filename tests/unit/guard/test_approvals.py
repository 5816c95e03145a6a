"""Approvals: exactly what a person has read is carried out, once."""

from __future__ import annotations

import math
import random
import re
import string
from collections import Counter
from dataclasses import replace
from typing import Any

import pytest

from ros2_mcp.guard.approvals import MOST_PENDING, Approvals
from ros2_mcp.guard.exact import ExactCommand
from ros2_mcp.model.commands import (
    LOCAL,
    Command,
    Move,
    Play,
    Principal,
    Publish,
    Record,
    Relay,
    Repeat,
    SendGoal,
    ServiceCall,
    SetParameters,
)
from ros2_mcp.model.errors import ApprovalNeeded, BadInput, NotFound, Refused
from ros2_mcp.model.qos import Choice, QoS
from support.rounds import FULL

QOS = QoS("reliable", "volatile", depth=1)
CHOICE = Choice(QOS, "")
TWIST = "geometry_msgs/msg/Twist"


BOUND = ("value", "principal", "transport", "verb", "name", "type", "rate", "for", "policy", "epoch", "login")


class Clock:
    """Time that passes when a test says so."""

    def __init__(self) -> None:
        self.now = 0.0

    def __call__(self) -> float:
        return self.now


def twist(x: float = 0.2, turn: float = 0.0) -> dict[str, Any]:
    zero = {"x": 0.0, "y": 0.0, "z": 0.0}
    return {"linear": {**zero, "x": x}, "angular": {**zero, "z": turn}}


def publishing(**changes: Any) -> Publish:
    given: dict[str, Any] = {"principal": LOCAL, "name": "/cmd_vel", "type": TWIST, "value": twist(), **changes}
    return Publish(choice=CHOICE, wait_match_s=1.0, **given)


def drive(x: float = 0.2, **changes: Any) -> ExactCommand:
    return replace(ExactCommand.of(publishing(value=twist(x)), policy="p1", epoch="3"), **changes)


def approved(approvals: Approvals, act: ExactCommand) -> str:
    with pytest.raises(ApprovalNeeded) as needed:
        approvals.require(act)
    request = approvals.find(needed.value.request_id)
    return approvals.approve(request.id, request.nonce, by="operator ann").id


def is_carried_out(approvals: Approvals, act: ExactCommand) -> bool:
    try:
        approvals.require(act)
    except Refused:
        return False
    return True


def test_the_same_call_is_carried_out_once_after_it_was_approved() -> None:
    approvals = Approvals(epoch=lambda: "3")
    used = approved(approvals, drive())
    assert approvals.require(drive()) == used
    assert not is_carried_out(approvals, drive())


def test_the_same_call_asked_again_is_the_same_request() -> None:
    approvals = Approvals(epoch=lambda: "3")
    ids = set[str]()
    for _ in range(100):
        with pytest.raises(ApprovalNeeded) as needed:
            approvals.require(drive())
        ids.add(needed.value.request_id)
    assert len(ids) == 1 == len(approvals.waiting())


def alter(act: ExactCommand, chance: random.Random) -> ExactCommand:
    """The act with one thing changed."""
    other = Principal(name=chance.choice(("session 2", "loca", "local ", "LOCAL")), transport="stdio")
    changed = chance.choice(BOUND)
    base: Command[Any] = publishing()
    if changed == "value":
        x = act.value["linear"]["x"]
        return drive(math.nextafter(x, chance.choice((-9.0, 9.0))))
    if changed == "verb":
        base = Relay(principal=LOCAL, name="/cmd_vel", type=TWIST, relay_id="r", qos=QOS, source="/x", wait_match_s=1)
        return ExactCommand.of(base, twist(), policy="p1", epoch="3")
    return {
        "principal": replace(act, principal=other),
        "transport": replace(act, principal=replace(act.principal, transport="http")),
        "login": replace(act, principal=replace(act.principal, login="another")),
        "name": replace(act, name=chance.choice(("/cmd_vel2", "/cmd_ve1", "/robot/cmd_vel"))),
        "type": ExactCommand.of(publishing(type="geometry_msgs/msg/TwistStamped"), policy="p1", epoch="3"),
        "rate": replace(act, rate_hz=chance.choice((1.0, 10.0))),
        "for": replace(act, duration_s=chance.choice((0.0, 5.0))),
        "policy": replace(act, policy="p2"),
        "epoch": replace(act, epoch=chance.choice(("2", "4"))),
    }[changed]


def test_nothing_replayed_altered_or_late_is_carried_out() -> None:
    """Bar 10: 10,000 attempts, each with an approval of something very near lying ready."""
    chance, clock = random.Random(10), Clock()
    carried_out = 0
    for _ in range(10_000):
        approvals, act = Approvals(clock=clock, epoch=lambda: "3"), drive(chance.choice((0.2, 1e-9, 0.1 + 0.2)))
        approved(approvals, act)
        match chance.choice(("replay", "altered", "expired", "stopped", "fifty", "denied")):
            case "replay":
                assert is_carried_out(approvals, act)
                carried_out += is_carried_out(approvals, act)
            case "altered":
                carried_out += is_carried_out(approvals, alter(act, chance))
            case "expired":
                clock.now += chance.choice((60.0, 61.0, 1e6))
                carried_out += is_carried_out(approvals, act)
            case "stopped":
                approvals.epoch = lambda: "4"
                carried_out += is_carried_out(approvals, act) + is_carried_out(approvals, replace(act, epoch="4"))
            case "fifty":
                carried_out += sum(is_carried_out(approvals, act) for _ in range(50)) - 1
            case _:
                assert is_carried_out(approvals, act)
                with pytest.raises(ApprovalNeeded) as needed:
                    approvals.require(act)
                approvals.deny(needed.value.request_id, by="operator ann")
                carried_out += is_carried_out(approvals, act)
    assert carried_out == 0


def test_the_digest_is_that_of_the_bytes() -> None:
    one, other = (ExactCommand.of(publishing(), body=body) for body in (b"\0\1\0\0abc", b"\0\1\0\0abd"))
    assert one.key != other.key


def test_every_field_of_a_command_that_says_what_happens_is_bound() -> None:
    common: dict[str, Any] = {"principal": LOCAL, "wait_match_s": 1.0}
    pairs: list[tuple[Command[Any], dict[str, Any]]] = [
        (Relay(name="/b", source="/a", qos=QOS, relay_id="relay_1", **common), {"source": "/c"}),
        (Play(name="/b", bag="one", topic="/a", qos=QOS, relay_id="play_1", **common), {"bag": "two"}),
        (Play(name="/b", bag="one", topic="/a", qos=QOS, relay_id="play_1", **common), {"topic": "/c"}),
        (Play(name="/b", bag="one", topic="/a", qos=QOS, relay_id="play_1", **common), {"part": "7 s to 9 s"}),
        (Repeat(name="/b", choice=CHOICE, rate_hz=10, duration_s=1, **common), {"rate_hz": 11}),
        (Repeat(name="/b", choice=CHOICE, rate_hz=10, duration_s=1, **common), {"duration_s": 2}),
        (Record(principal=LOCAL, name="r", topics=["/a"]), {"topics": ["/a", "/b"]}),
        (Record(principal=LOCAL, name="r", topics=["/a"]), {"patterns": ["*"]}),
        (
            SetParameters(principal=LOCAL, name="/n", through="/n/s", timeout_s=1, parameters={"a": 1}),
            {"parameters": {"a": 2}},
        ),
    ]
    for command, change in pairs:
        assert ExactCommand.of(command).key != ExactCommand.of(replace(command, **change)).key, change


def test_names_that_are_made_anew_for_each_call_are_not() -> None:
    goal = SendGoal(principal=LOCAL, name="/go", type="a/action/B", value={"x": 1}, goal_id="0" * 31 + "1", timeout_s=5)
    assert ExactCommand.of(goal).key == ExactCommand.of(replace(goal, goal_id="0" * 31 + "2", timeout_s=6)).key


def test_an_answer_names_what_was_read() -> None:
    clock = Clock()
    approvals = Approvals(clock=clock, epoch=lambda: "3")
    with pytest.raises(ApprovalNeeded) as needed:
        approvals.require(drive())
    with pytest.raises(NotFound):
        approvals.approve(needed.value.request_id, "0" * 32, by="operator ann")
    clock.now += 601
    with pytest.raises(NotFound):
        approvals.approve(needed.value.request_id, by="operator ann")


def test_a_client_that_asks_for_more_than_a_person_reads_is_refused_and_pushes_nobody_out() -> None:
    approvals = Approvals(epoch=lambda: "3")
    other = drive(principal=Principal(name="other", transport="http"))
    assert not is_carried_out(approvals, other)
    for number in range(100):
        assert not is_carried_out(approvals, drive(number + 1.0))
    assert Counter(one.exact.principal.name for one in approvals.waiting()) == {"local": MOST_PENDING, "other": 1}


def test_the_names_that_a_client_of_one_login_gives_itself_do_not_make_it_several() -> None:
    approvals = Approvals(epoch=lambda: "3")
    for number in range(100):
        client = Principal(name=f"program {number}", transport="http", login="laptop")
        assert not is_carried_out(approvals, drive(principal=client))
    assert len(approvals.waiting()) == MOST_PENDING
    with pytest.raises(ApprovalNeeded):
        approvals.require(drive(principal=Principal(name="other", transport="http", login="tablet")))


def test_a_grant_covers_its_kind_for_its_time_and_no_more() -> None:
    clock = Clock()
    approvals = Approvals(clock=clock, epoch=lambda: "3")
    with pytest.raises(ApprovalNeeded) as needed:
        approvals.require(drive(0.1))
    with pytest.raises(BadInput, match="exceeds that bound"):
        approvals.grant(needed.value.request_id, 60, {"linear": 0.05}, by="operator ann")
    with pytest.raises(BadInput, match="no number at liner"):
        approvals.grant(needed.value.request_id, 60, {"liner": 0.05}, by="operator ann")
    for bad in (math.nan, math.inf, -1.0):
        with pytest.raises(BadInput):
            approvals.grant(needed.value.request_id, 60, {"linear": bad}, by="operator ann")
    for bad in (0.0, 601.0, math.nan, math.inf):
        with pytest.raises(BadInput):
            approvals.grant(needed.value.request_id, bad, by="operator ann")
    grant = approvals.grant(needed.value.request_id, 60, {"linear": 0.2, "angular": 0.0}, by="operator ann")
    assert [approvals.require(drive(x)) for x in (0.2, -0.2, 0.0, 0.1)] == [grant.id] * 4
    beyond = [
        drive(0.21),
        drive(math.nan),
        drive(math.inf),
        drive(-0.3),
        drive(0.1, epoch="4"),
        drive(0.1, policy="p2"),
    ]
    beyond += [replace(drive(0.1), value=value) for value in (twist(0.2, 0.1), twist(0.15, 0), {}, None)][::2]
    beyond += [drive(0.1, name="/other"), drive(0.1, principal=Principal(name="other", transport="http"))]
    assert not any(is_carried_out(approvals, act) for act in beyond)
    clock.now += 60
    assert not is_carried_out(approvals, drive(0.1))


def test_a_revoked_grant_and_a_stop_end_what_was_granted() -> None:
    approvals = Approvals(epoch=lambda: "3")
    for is_stop in (False, True):
        with pytest.raises(ApprovalNeeded) as needed:
            approvals.require(drive(0.1 + is_stop))
        made = approvals.grant(needed.value.request_id, 60, by="ann")
        assert is_carried_out(approvals, drive(0.9))
        if is_stop:
            approvals.epoch = lambda: "4"
        else:
            approvals.revoke(made.id, by="ann")
        assert not is_carried_out(approvals, drive(0.9))
        assert not approvals.grants()


WORD = r"(?:[\w/~.:+\[\]*-]{1,256}|«[ -~]{0,80}»)"
NUMBER = r"-?(?:inf|nan|\d[\d.e+-]*)"
VALUE = rf"{WORD} (?:{NUMBER}(?: m/s| rad/s)?|true|«[ -~]{{0,80}}»|\d+ numbers from {NUMBER} to {NUMBER})"
GRAMMAR = [
    rf"(?:Publish on|Call the service|Set parameters of|Send a goal to) {WORD}(?: \({WORD}\))?, "
    rf"(?:once|at {NUMBER} Hz (?:for {NUMBER} s|without end))\.",
    rf"(?:No parameter|Every value is 0 or empty|{VALUE}(?:, {VALUE})*"
    rf"(?:, and \d+ more|; every other (?:value is 0 or empty|parameter stays as it is)))\.",
    rf"For the client {WORD} \({WORD}\)\. Digest [0-9a-f]{{4}}(?: [0-9a-f]{{4}}){{3}}\.",
]
EVIL = [
    *("\n", "\r", "\0", "\x1b[2J", "\x7f", "\u202e", "\u200b", "\u2028", "»", "«", "é", "\U000e0041", "\ud800", "\x9b"),
    *('"', "\\", "'", "{name}", "%s", "\t", "Approved.", "Digest 0000 0000 0000 0000.", "; every other value is 0"),
]


def hostile(chance: random.Random) -> str:
    parts = [*EVIL, *string.ascii_letters, *(chr(chance.randrange(0x110000)) for _ in range(5))]
    return "".join(chance.choice(parts) for _ in range(chance.choice((0, 1, 3, 20, 300))))


def test_a_summary_fits_its_grammar_whatever_the_texts_are() -> None:
    """Bar 10."""
    chance = random.Random(100)
    for _ in range(25_000 if FULL else 1000):  # four hostile strings and more in each
        text, name, client, kind = (hostile(chance) for _ in range(4))
        value = {
            text: text,
            "n": chance.choice((1, 0.5, -1e300, True, None, math.inf)),
            "l": [hostile(chance), [1] * 9],
        }
        principal = Principal(name=client, transport=chance.choice(("http", text)))
        given: dict[str, Any] = {"principal": principal, "name": name, "type": kind, "value": value}
        command: Command[Any] = chance.choice(
            (
                Publish(choice=CHOICE, wait_match_s=1.0, **given),
                Repeat(choice=CHOICE, wait_match_s=1.0, **given),
                ServiceCall(timeout_s=1.0, **given),
                SetParameters(timeout_s=1.0, through=text, parameters={name: text, text: 1}, **given),
            )
        )
        lines = ExactCommand.of(command).summary()
        assert len(lines) == len(GRAMMAR)
        for line, pattern in zip(lines, GRAMMAR, strict=True):
            assert re.fullmatch(pattern, line), line


def test_a_summary_reads_like_this() -> None:
    common: dict[str, Any] = {"choice": CHOICE, "rate_hz": 10.0, "duration_s": 5.0, "wait_match_s": 1.0}
    repeat = Repeat(principal=LOCAL, name="/cmd_vel", type=TWIST, value=twist(0.2, 0.1), **common)
    act = ExactCommand.of(repeat)
    assert act.summary() == [
        "Publish on /cmd_vel (geometry_msgs/msg/Twist), at 10.0 Hz for 5.0 s.",
        "linear.x 0.2 m/s, angular.z 0.1 rad/s; every other value is 0 or empty.",
        f"For the client «local» (stdio). Digest {' '.join(re.findall('....', act.digest)[:4])}.",
    ]


def test_a_motion_says_what_it_is_closed_by() -> None:
    controller = {"kind": "drive", "distance_m": 1.5, "angle": None, "odometry": {"topic": "/odom"}, "guard_m": 0.6}
    given: dict[str, Any] = {"choice": CHOICE, "wait_match_s": 1.0, "value": twist(0.2, 0.1)}
    act = ExactCommand.of(Move(principal=LOCAL, name="/cmd_vel", type=TWIST, controller=controller, **given))
    told = "kind «drive», distance_m 1.5, odometry.topic «/odom», guard_m 0.6"
    assert act.summary()[2] == f"By feedback, with at most these values: {told}."


def test_a_parameter_that_is_switched_off_or_emptied_is_named() -> None:
    off = {"PolygonStop.enabled": False, "max_speed": 0.0, "polygons": [], "robot": ""}
    given: dict[str, Any] = {
        "principal": LOCAL,
        "name": "/monitor",
        "through": "/monitor/set_parameters",
        "timeout_s": 1,
    }
    _, values, _ = ExactCommand.of(SetParameters(parameters=off, **given)).summary()
    assert values == (
        "PolygonStop.enabled false, max_speed 0.0, polygons empty, robot «»; every other parameter stays as it is."
    )
    assert ExactCommand.of(SetParameters(parameters={}, **given)).summary()[1] == "No parameter."


def test_what_a_client_has_asked_for_leaves_with_it() -> None:
    told: list[str] = []
    approvals = Approvals(clock=Clock(), changed=lambda kind, _: told.append(kind))
    gone = Principal(name="gone", transport="http")
    for principal in (LOCAL, gone):
        with pytest.raises(ApprovalNeeded):
            approvals.require(ExactCommand.of(publishing(principal=principal)))
    approvals.leave(gone)
    assert [request.exact.principal for request in approvals.waiting()] == [LOCAL]
    assert told == ["asked", "asked", "withdrawn"]
