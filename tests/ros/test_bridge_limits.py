"""A bridge under a policy, spoken to by a server that is wrong or taken over: what arrives is within the limits.

The stream is spoken raw, so that nothing of the server decides; an observer in another process judges what arrived.
"""

from __future__ import annotations

import itertools
import struct
from typing import Any

import pytest

from ros2_mcp_common.policy.rules import Allowance, Limit, Rules, RuleSet
from support.agent import FULL, until
from support.bridge_client import PATIENCE_S, RELIABLE, Client
from support.limits import HOLD_S, LINEAR, RATE_HZ, SET_BOOL, STEP_S, UP, body, over, rules
from support.observer import Observer
from support.velocities import TWIST, TWIST_STAMPED, cdr, hostile_bytes

MANY = 4_000 if FULL else 100
"""Messages of each type by each of the ways; five ways and two types make 40,000 in full."""
TRUE, FALSE = b"\0\1\0\0\1", b"\0\1\0\0\0"
REST_S = 2.0 if FULL else PATIENCE_S
JITTER_S = 0.05
"""By how much messages may come closer together than they were sent; chosen for a busy machine."""
KINDS = (TWIST, TWIST_STAMPED)
_numbers = itertools.count(1)

pytestmark = pytest.mark.timeout(1500 if FULL else 120)


class Limited(Client):
    """A client of a bridge that is under a policy."""

    def policy(self, given: bytes | None = None) -> int:
        return self.send("policy", body(rules()) if given is None else given)

    def drive(self, topic: str, kind: str = TWIST, **arguments: Any) -> int:
        return self.send("failsafe_publish", topic=topic, type=kind, qos=RELIABLE, **arguments)

    def begin(self, op: str, topic: str, kind: str = TWIST, data: bytes = b"", **arguments: Any) -> int:
        return self.send(op, data, topic=topic, type=kind, qos=RELIABLE, epoch=0, **arguments)


@pytest.fixture
def bridge(start):
    """Start a bridge under a policy."""
    return lambda program="ros2_mcp_bridge": Limited(start(program, "--under-policy"))


@pytest.fixture
def topic() -> str:
    return f"/robot_{next(_numbers)}/cmd_vel"


def matched(bridge: Client, topic: str, count: int = 1) -> None:
    bridge.ok("wait_endpoints", topic=topic, publishers=0, subscribers=count, timeout_s=PATIENCE_S)


def arrived(observer: Observer, topic: str) -> list[tuple[int, list[float], list[float]]]:
    """When every message was sent, as DDS stamped it, and the numbers of its linear and angular velocity."""
    found = observer.messages(topic=topic)
    assert all(not one["fault"] for one in found)
    return [(one["sent"], one["values"][:3], one["values"][3:]) for one in found]


def excesses(observer: Observer, topic: str) -> list[str]:
    return [problem for _, linear, angular in arrived(observer, topic) if (problem := over(linear, angular))]


def by_all_ways(bridge: Limited, observer: Observer, topic: str, kind: str) -> None:
    """Hostile messages published, repeated, relayed, fed as a playback does, and left behind with a fail-safe."""
    observer.join(by=topic, topic=topic, kind=kind)
    source = f"{topic}_source"
    observer.offer(topic=source, kind=kind)
    matched(bridge, topic)
    bridge.drive(topic, kind)
    messages = hostile_bytes(kind, 21)
    few = list(itertools.islice(messages, MANY // 10))
    for data in itertools.islice(messages, MANY):
        bridge.begin("publish", topic, kind, data)
    for data in few:
        bridge.answer(bridge.begin("repeat", topic, kind, data, rate_hz=RATE_HZ, duration_s=0.02))
    relay = bridge.begin("relay", topic, kind, name=source, source=source, duration_s=0.0)
    fed = bridge.begin("relay", topic, kind, name="fed", duration_s=0.0)
    until(lambda: observer.listeners(topic=source))
    bodies = [data.hex() for data in itertools.islice(messages, MANY)]
    observer.say(topic=source, kind=kind, bodies=bodies, gap_s=0.001)
    until(lambda: bridge.ok("relays")["relays"]["fed"]["running"])
    for _ in range(10):
        batch = list(itertools.islice(messages, MANY // 10))
        bridge.ok("relay_feed", b"".join(batch), name="fed", sizes=[len(data) for data in batch], epoch=0)
    for name, request in ((source, relay), ("fed", fed)):
        assert bridge.ok("relay_stop", name=name)["relays"] == 1
        assert bridge.answer(request)[0]["ok"]["final_sent"]
    bridge.begin("publish", topic, kind, cdr(kind, 0.02), wait_ack_s=1.0)
    bridge.close()
    assert observer.comes_to_rest(topic, REST_S) == []


@pytest.mark.parametrize("kind", KINDS)
def test_nothing_over_a_limit_arrives_whatever_the_server_or_another_node_gives(bridge, observer, topic, kind) -> None:
    it = bridge()
    it.policy(body(rules(rate_hz=None)))
    by_all_ways(it, observer, topic, kind)
    assert excesses(observer, topic) == []
    assert observer.counts(topic=topic)[topic] > MANY / 20
    print(f"{kind}: {observer.counts(topic=topic)[topic]} arrived", flush=True)


def test_without_the_limiter_the_observer_would_notice(bridge, observer, topic) -> None:
    it = bridge("unlimited_bridge.py")
    it.policy()
    by_all_ways(it, observer, topic, TWIST)
    assert excesses(observer, topic)


def test_until_its_rules_come_a_bridge_sends_nothing_but_zeros(bridge, observer, topic) -> None:
    it = bridge()
    observer.join(by=topic, topic=topic, kind=TWIST)
    observer.serve(service="/lamp", kind=SET_BOOL)
    matched(it, topic)
    it.drive(topic, now=True)
    until(lambda: observer.counts(topic=topic)[topic])
    refused = [
        it.error("publish", cdr(TWIST, 0.1), topic=topic, type=TWIST, qos=RELIABLE, epoch=0),
        it.error("call", TRUE, service="/lamp", type=SET_BOOL, epoch=0, timeout_s=1.0),
    ]
    assert [error["kind"] for error in refused] == ["refused", "refused"]
    it.answer(it.policy())
    assert it.ok("publish", cdr(TWIST, 0.05), topic=topic, type=TWIST, qos=RELIABLE, epoch=0, wait_match_s=1.0)[
        "matched"
    ]
    assert it.ok("call", TRUE, service="/lamp", type=SET_BOOL, epoch=0, wait_s=PATIENCE_S, timeout_s=PATIENCE_S)
    until(lambda: observer.driven(topic=topic)[topic])
    assert len(observer.asked(service="/lamp")) == 1


def test_a_second_policy_ends_the_bridge_and_the_robot_is_stopped(bridge, observer, topic) -> None:
    it = bridge()
    it.policy()
    observer.join(by=topic, topic=topic, kind=TWIST)
    matched(it, topic)
    it.drive(topic)
    it.begin("repeat", topic, data=cdr(TWIST, 0.3), rate_hz=20, duration_s=60, wait_match_s=PATIENCE_S)
    observer.until_driven(topic)
    it.policy(body(rules(ramp=False)))
    assert observer.comes_to_rest(topic, REST_S) == []
    with pytest.raises((EOFError, BrokenPipeError)):
        while True:
            it.next_packet()
    it.process.wait(PATIENCE_S)


def test_a_command_that_is_not_renewed_is_ended_by_the_bridge_when_its_time_is_over(bridge, observer, topic) -> None:
    assert held_for_s(bridge(), observer, topic) > HOLD_S - JITTER_S


@pytest.mark.full
def test_a_command_that_is_not_renewed_is_ended_in_time(bridge, observer, topic) -> None:
    assert held_for_s(bridge(), observer, topic) < HOLD_S + 0.5


def held_for_s(it: Limited, observer: Observer, topic: str) -> float:
    """How long after the only command the zero was sent that the bridge puts behind it."""
    it.policy(body(rules(ramp=False)))
    observer.join(by=topic, topic=topic, kind=TWIST)
    matched(it, topic)
    it.drive(topic)
    sent = it.ok("publish", cdr(TWIST, 0.3), topic=topic, type=TWIST, qos=RELIABLE, epoch=0, wait_match_s=PATIENCE_S)
    assert sent["hold_s"] == HOLD_S
    observer.until_driven(topic)  # it was sent, which is not yet that it has arrived
    assert observer.comes_to_rest(topic, HOLD_S + 1.0 if FULL else PATIENCE_S) == []
    moved, *_, rested = arrived(observer, topic)
    return (rested[0] - moved[0]) / 1e9


def test_a_robot_is_not_accelerated_faster_than_the_ramp(bridge, observer, topic) -> None:
    it = bridge()
    it.policy()
    observer.join(by=topic, topic=topic, kind=TWIST)
    matched(it, topic)
    it.drive(topic)
    request = it.begin("repeat", topic, data=cdr(TWIST, LINEAR), rate_hz=50, duration_s=1.2, wait_match_s=PATIENCE_S)
    assert it.answer(request)[0]["ok"]["limited"] > 20
    came = [(at / 1e9, linear[0]) for at, linear, _ in arrived(observer, topic)]
    assert max(speed for _, speed in came) == LINEAR
    began = came[0][0]
    assert all(speed <= UP * (at - began + STEP_S + JITTER_S) for at, speed in came)


def test_what_no_rule_allows_is_not_even_created(bridge, observer, topic) -> None:
    it = bridge()
    it.answer(it.policy())
    observer.serve(service="/siren", kind=SET_BOOL)
    before = it.ok("stats")
    for name, kind in (("/joy", TWIST), ("cmd_vel", TWIST), ("/base/cmd_vel", TWIST), (topic, "std_msgs/msg/String")):
        for op in ("publish", "failsafe_publish"):
            assert it.error(op, b"", topic=name, type=kind, qos=RELIABLE, epoch=0)["kind"] == "refused", (op, name)
    for service in ("/siren", "siren"):
        assert it.error("call", TRUE, service=service, type=SET_BOOL, epoch=0, timeout_s=1.0)["kind"] == "refused"
        assert it.error("failsafe_call", TRUE, service=service, type=SET_BOOL, epoch=0)["kind"] == "refused"
    assert it.error("call", FALSE, service="/lamp", type=SET_BOOL, epoch=0, timeout_s=1.0)["kind"] == "refused"
    after = it.ok("stats")
    assert (after["publishers"], after["clients"]) == (before["publishers"], before["clients"])
    assert observer.asked(service="/siren") == []


@pytest.mark.parametrize("how", ["relay ends", "server dies"])
def test_what_holds_for_a_time_and_is_no_velocity_ends_with_who_sent_it(bridge, observer, topic, how) -> None:
    it, kind = bridge(), "std_msgs/msg/Float64"
    allowed = Allowance("allow[0]", "publish", (topic,), (kind,)), Allowance("allow[1]", "play", (topic,), (kind,))
    given = Rules("", (RuleSet("thrust", allowed, (), (Limit("hold", (kind,), hold_s=60.0),)),))
    it.answer(it.policy(body(given)))
    observer.join(by=topic, topic=topic, kind=kind)
    matched(it, topic)
    data = b"\0\1\0\0" + struct.pack("<d", 3.0)
    if how == "relay ends":
        relay = it.begin("relay", topic, kind, name="fed", wait_match_s=PATIENCE_S)
        until(lambda: it.ok("relays")["relays"].get("fed", {}).get("running"))
        it.ok("relay_feed", data, name="fed", sizes=[len(data)], epoch=0)
        it.ok("relay_stop", name="fed")
        it.answer(relay)
    else:
        it.answer(it.begin("publish", topic, kind, data, wait_match_s=PATIENCE_S, wait_ack_s=PATIENCE_S))
        it.close()
    until(lambda: [one["values"] for one in observer.messages(topic=topic)] == [[3.0], [0.0]])
