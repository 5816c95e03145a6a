"""What the bridge promises of motion: stop means stop, zeros are whole, silence ends what moves. Judged by an observer
in another process, with several subscribers on a topic.
"""

from __future__ import annotations

import itertools
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from typing import Any

import pytest

from ros2_mcp_bridge.__main__ import LATE_S
from ros2_mcp_common.wire.limits import MAX_FAILSAFES
from support.agent import FULL, until
from support.bridge_client import PATIENCE_S, RELIABLE, Client
from support.observer import Observer, observing
from support.standstill import undisturbed
from support.velocities import (
    ACKERMANN_STAMPED,
    STAMPED,
    TWIST,
    TWIST_STAMPED,
    VELOCITY_TYPES,
    cdr,
    hostile_bytes,
    with_ackermann,
)

ROUNDS = 200 if FULL else 2
HOSTILE = 1000 if FULL else 60
LEASE_S = 0.5
ON_TIME_S = 0.1
"""A zero is on the wire so long after a lease."""
NOW_S = ON_TIME_S if FULL else 3.0
"""No stamp is further from the time at which its message was written: the figure in full, else that it is that clock's,
on a machine that may stand still between the two.
"""
REST_S = 1.0 if FULL else PATIENCE_S
CLOCK = "rosgraph_msgs/msg/Clock"
SET_BOOL = "std_srvs/srv/SetBool"
TRUE = b"\0\1\0\0\1"
CANCEL_GOAL = "action_msgs/srv/CancelGoal"
ANY_GOAL = b"\0\1\0\0" + bytes(24)
"""Its request that cancels all goals."""
WAITS = {"wait_match_s": PATIENCE_S, "wait_ack_s": PATIENCE_S}
_numbers = itertools.count(1)


@pytest.fixture(scope="module")
def environment(ros_environment: dict[str, str]) -> dict[str, str]:
    return with_ackermann(ros_environment)


@pytest.fixture(scope="module")
def shared_observer(environment: dict[str, str]) -> Iterator[Observer]:
    with observing(environment) as observer:
        yield observer


@pytest.fixture
def observer(shared_observer: Observer) -> Observer:
    shared_observer.forget()
    return shared_observer


@pytest.fixture
def apart(environment: dict[str, str], domain_id: int) -> dict[str, str]:
    """A domain where no clock has been heard."""
    return {**environment, "ROS_DOMAIN_ID": str(domain_id + 1)}


@pytest.fixture
def own_observer(apart: dict[str, str]) -> Iterator[Observer]:
    with observing(apart) as observer:
        yield observer


@pytest.fixture(scope="module")
def shared_bridge(environment: dict[str, str]) -> Iterator[Client]:
    command = [sys.executable, "-m", "ros2_mcp_bridge"]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, env=environment) as process:
        client = Client(process)
        yield client
        client.close()


@pytest.fixture
def bridge(shared_bridge: Client) -> Client:
    """The bridge of the tests that neither stop nor end it."""
    shared_bridge.samples.clear()
    return shared_bridge


@pytest.fixture
def topic() -> str:
    """Each test has its own: what was discovered of another's is none of its business."""
    return f"/driven_{next(_numbers)}"


@pytest.fixture
def begin(start, environment):
    """Start a bridge that can speak with an observer."""
    return lambda env=environment: Client(start("ros2_mcp_bridge", env=env))


def drive(bridge: Client, topic: str, kind: str = TWIST, **arguments: Any) -> int:
    return bridge.send("failsafe_publish", topic=topic, type=kind, qos=RELIABLE, **arguments)


def command(topic: str, kind: str = TWIST, epoch: int = 0, **arguments: Any) -> dict[str, Any]:
    return {"topic": topic, "type": kind, "qos": RELIABLE, "epoch": epoch, **arguments}


def repeat(bridge: Client, topic: str, kind: str = TWIST, **arguments: Any) -> int:
    lasts = {"rate_hz": 100, "duration_s": 60, "wait_match_s": PATIENCE_S, **arguments}
    return bridge.send("repeat", cdr(kind, 0.5), **command(topic, kind, **lasts))


def matched(bridge: Client, topic: str, count: int = 4) -> None:
    bridge.ok("wait_endpoints", topic=topic, publishers=0, subscribers=count, timeout_s=PATIENCE_S)


@pytest.mark.promise("README", "What was accepted before it and has not been sent is not sent after it")
def test_nothing_that_was_accepted_before_a_stop_leaves_after_its_answer(begin, observer: Observer, topic: str) -> None:
    bridge = begin()
    observer.watch(topic)
    matched(bridge, topic)
    drive(bridge, topic)
    for epoch in range(ROUNDS):
        acts = {"type": TWIST, "qos": RELIABLE, "epoch": epoch}
        later = f"{topic}_later_{epoch}"
        repeating = repeat(bridge, topic, rate_hz=1000, epoch=epoch)
        feeding = bridge.send("relay", name=f"fed {epoch}", topic=topic, **acts)
        while not bridge.ok("relays")["relays"].get(f"fed {epoch}", {}).get("running"):
            time.sleep(0.005)
        drive(bridge, later)
        waiting = [
            bridge.send("publish", cdr(TWIST, 1.0), topic=later, wait_match_s=3600, **acts),
            bridge.send("call", TRUE, service=later, type=SET_BOOL, wait_s=3600, timeout_s=1, epoch=epoch),
        ]
        bridge.ok("stats")
        go = cdr(TWIST, 2.0)
        flying = [bridge.send("publish", go, topic=topic, wait_match_s=0, wait_ack_s=1, **acts) for _ in range(50)] + [
            bridge.send("relay_feed", go * 20, name=f"fed {epoch}", sizes=[len(go)] * 20, epoch=epoch)
        ]
        told = bridge.ok("stop", epoch=epoch + 1, wait_match_s=0.2, wait_ack_s=1.0)
        answered = time.monotonic_ns()
        observer.serve(service=later, kind=SET_BOOL)
        observer.join(by=later, topic=later, kind=TWIST)
        until(lambda later=later: observer.matched(by=later) >= 1)
        assert (told["repeats"], told["relays"]) == (1, 1)
        assert [["publish", later], ["call", later]] == [row for row in told["dropped"] if row[1] == later]
        assert next(row for row in told["topics"] if row["topic"] == topic)["acked"] is None  # two are best effort
        assert [bridge.answer(one)[0]["error"]["kind"] for one in waiting] == ["stopped"] * 2
        assert bridge.answer(repeating)[0]["ok"]["ended_by"] == "stop"
        assert bridge.answer(feeding)[0]["ok"]["ended_by"] == "stop"
        for one in flying:
            answer = bridge.answer(one)[0]
            assert "ok" in answer or answer["error"]["kind"] == "stopped"
        assert bridge.error("publish", go, topic=topic, **acts)["kind"] == "stopped"
        assert bridge.ok("ping", epoch=0)  # an old epoch changes nothing
        assert bridge.error("publish", go, topic=topic, **acts)["kind"] == "stopped"
        assert observer.comes_to_rest(topic, within_s=REST_S) == []
        assert observer.moved(sent_after=answered) == []
        assert observer.asked(service=later) == []
        bridge.send("cancel", request=waiting[0] - 1)  # the fail-safe of the other topic
        observer.forget()
        observer.leave(by=later)


def test_what_waits_behind_an_import_when_a_stop_comes_is_named_once(begin, topic: str) -> None:
    """Sent in one piece: the publish has not come to the ROS thread when the stop is read."""
    bridge = begin()
    drive(bridge, topic)
    publishing = [
        bridge.send("publish", cdr(TWIST, 0.5), **command(f"{topic}_{n}", wait_match_s=3600)) for n in range(20)
    ]
    told = bridge.ok("stop", epoch=1)
    assert [bridge.answer(one)[0]["error"]["kind"] for one in publishing] == ["stopped"] * 20
    assert sorted(told["dropped"]) == sorted(["publish", f"{topic}_{n}"] for n in range(20))
    assert bridge.ok("stop", epoch=2)["dropped"] == []


def test_a_call_that_was_sent_stays_open_for_its_answer(begin, observer: Observer, topic: str) -> None:
    bridge = begin()
    observer.serve(service=topic, kind=SET_BOOL, delay_s=0.5)
    request = bridge.send("call", TRUE, service=topic, type=SET_BOOL, wait_s=PATIENCE_S, timeout_s=PATIENCE_S, epoch=0)
    until(lambda: observer.asked(service=topic))
    assert bridge.ok("stop", epoch=1)["dropped"] == []
    assert "ok" in bridge.answer(request)[0]


def test_calls_that_wait_for_their_turn_are_not_sent_after_a_stop(begin, observer: Observer, topic: str) -> None:
    bridge = begin()
    observer.serve(service=topic, kind=SET_BOOL, delay_s=0.3)
    asks = {"service": topic, "type": SET_BOOL, "wait_s": PATIENCE_S, "timeout_s": PATIENCE_S, "epoch": 0}
    requests = [bridge.send("call", TRUE, **asks) for _ in range(30)]
    until(lambda: observer.asked(service=topic))
    told = bridge.ok("stop", epoch=1)
    answers = [bridge.answer(request)[0] for request in requests]
    stopped = [answer for answer in answers if "error" in answer]
    assert {answer["error"]["kind"] for answer in stopped} == {"stopped"}
    assert len(told["dropped"]) == len(stopped) > 0
    assert len(observer.asked(service=topic)) == len(requests) - len(stopped)


@pytest.mark.promise("README", "it stamps commands and zeros with the robot's own time")
@pytest.mark.promise(
    "stopping",
    "Its zero is the default value of the type, with the frame of the last command and the robot's time as its stamp",
)
@pytest.mark.parametrize("kind", STAMPED)
def test_a_command_is_stamped_now_and_its_zero_keeps_its_frame(
    bridge: Client, observer: Observer, topic: str, kind: str
) -> None:
    observer.watch(topic, kind)
    matched(bridge, topic)
    drive(bridge, topic, kind, frame="odd")
    assert bridge.ok("zero", topics=[topic], **WAITS)["topics"][0]["acked"] is None  # two are best effort
    assert {one["frame"] for one in observer.messages(topic=topic)} == {"odd"}
    future = cdr(kind, 0.5, stamp=(2_000_000_000, 0), frame="base_link")
    bridge.ok("publish", future, **command(topic, kind), **WAITS)
    lasting = bridge.send("repeat", future, **command(topic, kind, name="named", rate_hz=50, duration_s=0.5))
    assert bridge.answer(lasting)[0]["ok"]["final_sent"]
    assert observer.comes_to_rest(topic, within_s=REST_S) == []
    assert observer.misstamped(most_s=NOW_S) == []
    heard = observer.messages(topic=topic)
    first = min(one["sent"] for one in heard if one["frame"] == "base_link")  # until then the zero is sent again
    assert {one["frame"] for one in heard if one["sent"] >= first} == {"base_link"}
    assert [header["frame_id"] for header, _ in bridge.samples if header["event"] == "frame"] == ["base_link"]
    assert [header["name"] for header, _ in bridge.samples if header["event"] == "begun"] == ["named"]


@pytest.mark.promise(
    "stopping", "the last /clock where a subscriber of the topic uses simulated time, else the wall clock"
)
@pytest.mark.parametrize("factor", [0.1, 5.0])
def test_now_is_simulated_time_where_the_subscriber_uses_it(
    begin, observer: Observer, topic: str, factor: float
) -> None:
    bridge = begin()
    observer.clock(factor=factor)
    for by, best_effort in (("near", False), ("apart", True)):
        observer.join(
            by=by, topic=topic, kind=TWIST_STAMPED, sim_time=True, apart=by == "apart", best_effort=best_effort
        )
    matched(bridge, topic, 2)
    drive(bridge, topic, TWIST_STAMPED)
    body = cdr(TWIST_STAMPED, 0.5, stamp=(5, 0), frame="base_link")

    def is_on_time() -> bool:
        observer.forget()
        bridge.ok("publish", body, **command(topic, TWIST_STAMPED), **WAITS)
        observer.until_driven(topic, 1, 1)  # the lossy one may miss a single message
        heard = {one["by"] for one in observer.messages(topic=topic)}
        return heard == {"near", "apart"} and observer.misstamped(most_s=NOW_S * max(1.0, factor)) == []

    until(is_on_time)  # until now nobody needed the clock: the bridge has to discover it first, and so do both nodes
    observer.forget()
    lasting = bridge.send("repeat", body, **command(topic, TWIST_STAMPED, rate_hz=50, duration_s=1.0))
    bridge.answer(lasting)
    assert observer.comes_to_rest(topic, within_s=REST_S) == []
    assert observer.counts(topic=topic)["near"] > 40
    assert observer.misstamped(most_s=NOW_S * max(1.0, factor)) == []
    assert all(1000 <= one["stamp"] / 1e9 < 2000 for one in observer.messages(topic=topic))
    stamps = [one["stamp"] for one in observer.messages(by="near")]
    assert stamps == sorted(stamps) and len(set(stamps)) > 20  # that of now each time, and not that of the beginning
    observer.clock(factor=0.0)


def test_a_simulated_clock_that_was_never_heard_is_0_and_a_real_one_beside_it_is_left_alone(
    begin, apart: dict[str, str], own_observer: Observer, topic: str
) -> None:
    bridge, observer = begin(apart), own_observer
    observer.join(by="simulated", topic=topic, kind=TWIST_STAMPED, sim_time=True)
    observer.join(by="real", topic=f"{topic}_real", kind=TWIST_STAMPED)
    for name in (topic, f"{topic}_real"):
        matched(bridge, name, 1)
        drive(bridge, name, TWIST_STAMPED)
        bridge.ok("publish", cdr(TWIST_STAMPED, 0.5), **command(name, TWIST_STAMPED), **WAITS)
    until(lambda: len(observer.messages()) == 2)
    assert [one["stamp"] for one in observer.messages(topic=topic)] == [0]
    assert observer.misstamped(most_s=NOW_S) == []


@pytest.mark.promise("README", "A velocity that is not a finite number is never sent")
@pytest.mark.promise("stopping", "a relay or playback holds the message back, counts it and tells")
@pytest.mark.parametrize("kind", VELOCITY_TYPES)
def test_what_is_not_finite_leaves_on_no_way(bridge: Client, observer: Observer, topic: str, kind: str) -> None:
    source = f"{topic}_source"
    observer.watch(topic, kind)
    observer.offer(topic=source, kind=kind)
    matched(bridge, topic)
    drive(bridge, topic, kind)
    bad = [cdr(kind, number) for number in (float("nan"), float("inf"), float("-inf"))]
    bad += [cdr(kind, 0.5)[:-1], b"", b"\0\1\0\0"]
    for body in bad:
        refused = bridge.error("publish", body, **command(topic, kind))
        assert refused["kind"] == "bad_request"
        refused = bridge.error("repeat", body, **command(topic, kind, rate_hz=10, duration_s=1))
        assert refused["kind"] == "bad_request"
    relaying = bridge.send("relay", name="relayed", source=source, **command(topic, kind))
    feeding = bridge.send("relay", name="fed", **command(topic, kind))
    until(lambda: observer.listeners(topic=source) == 1)
    until(lambda: sum(row["running"] for row in bridge.ok("relays")["relays"].values()) == 2)
    good, whole = cdr(kind, 0.5), [*bad[:4], cdr(kind, 0.5)]  # DDS fills the shorter one up again
    observer.say(topic=source, kind=kind, bodies=[body.hex() for body in whole], gap_s=0.02)
    fed = [*bad, good + b"\xff" * 8]
    bridge.ok("relay_feed", b"".join(fed), name="fed", sizes=list(map(len, fed)), epoch=0)
    until(lambda: bridge.ok("relays")["relays"]["relayed"]["passed"] == 2)
    for request, name, counts in ((relaying, "relayed", (2, 3)), (feeding, "fed", (1, 6))):
        bridge.ok("relay_stop", name=name)
        told = bridge.answer(request)[0]["ok"]
        assert (told["passed"], told["refused"]) == counts and told["final_sent"]
    assert observer.comes_to_rest(topic, within_s=REST_S) == []
    assert observer.unsound(topic=topic) == []
    sizes = {one["size"] for one in observer.messages(topic=topic)}
    assert max(sizes) <= len(good)


@pytest.mark.parametrize("kind", VELOCITY_TYPES)
def test_hostile_commands_arrive_sound_or_not_at_all(bridge: Client, observer: Observer, topic: str, kind: str) -> None:
    observer.join(by="reliable", topic=topic, kind=kind)
    matched(bridge, topic, 1)
    drive(bridge, topic, kind)
    bodies = list(itertools.islice(hostile_bytes(kind, 10), HOSTILE))
    answers = [bridge.answer(bridge.send("publish", body, **command(topic, kind), **WAITS))[0] for body in bodies]
    refused = [answer["error"]["kind"] for answer in answers if "error" in answer]
    assert set(refused) == {"bad_request"} and len(refused) < len(bodies)
    relaying = bridge.send("relay", name="fed", **command(topic, kind))
    until(lambda: bridge.ok("relays")["relays"].get("fed", {}).get("running"))
    bridge.ok("relay_feed", b"".join(bodies), name="fed", sizes=list(map(len, bodies)), epoch=0)
    bridge.ok("relay_stop", name="fed")
    told = bridge.answer(relaying)[0]["ok"]
    assert (told["passed"], told["refused"]) == (len(bodies) - len(refused), len(refused))
    assert observer.comes_to_rest(topic, within_s=REST_S) == []
    assert observer.counts(topic=topic)["reliable"] > len(bodies) - len(refused)
    assert observer.unsound(topic=topic) == []
    assert observer.misstamped(most_s=NOW_S, topic=topic) == []


@pytest.mark.promise("README", "0.8 s where its ROS thread alone hangs")
def test_the_stopper_stops_what_a_hanging_ros_thread_moves(
    start, environment: dict[str, str], observer: Observer, topic: str
) -> None:
    bridge = Client(start("hanging_bridge.py", env=environment))
    observer.watch(topic)
    matched(bridge, topic)
    drive(bridge, topic)
    repeat(bridge, topic)
    observer.until_driven(topic, 10, 4)
    bridge.send("stats")
    assert observer.comes_to_rest(topic, within_s=4.0 if FULL else PATIENCE_S) == []  # it hangs for longer
    bridge.process.kill()


@pytest.mark.promise("README", "everything that was driven when the server dies, is stopped or sleeps")
def test_a_silent_server_ends_what_moves_and_the_bridge_lives_on(begin, observer: Observer, topic: str) -> None:
    bridge = begin()
    cancel = left_to_cancel(bridge, observer, topic)
    for _ in range(2):
        ended_after_s(bridge, observer, topic, cancel)
    assert bridge.ok("ping", lease_s=0, epoch=0)


@pytest.mark.full
@pytest.mark.promise("README", "everything that was driven when the server dies, is stopped or sleeps (within 1.1 s)")
def test_a_silent_server_has_ended_what_moves_as_its_lease_ends(begin, observer: Observer, topic: str) -> None:
    bridge = begin()
    cancel = left_to_cancel(bridge, observer, topic)
    for _ in range(2):
        assert undisturbed(lambda: ended_after_s(bridge, observer, topic, cancel)) <= LEASE_S + ON_TIME_S
        assert [head["silent_s"] < 2 * LEASE_S for head, _ in bridge.samples if head["event"] == "lapsed"] == [True]
    assert bridge.ok("ping", lease_s=0, epoch=0)


def left_to_cancel(bridge: Client, observer: Observer, topic: str) -> str:
    """Two topics with fail-safes, and a call that is left to be made: its service."""
    observer.watch(topic, ACKERMANN_STAMPED)
    cancel = {"service": f"{topic}/_action/cancel_goal", "type": CANCEL_GOAL}
    observer.serve(service=cancel["service"], kind=CANCEL_GOAL)
    matched(bridge, topic)
    for name in (topic, f"{topic}_later"):
        drive(bridge, name, ACKERMANN_STAMPED)
    bridge.send("failsafe_call", ANY_GOAL, epoch=0, **cancel)
    bridge.answer(bridge.send("call", ANY_GOAL, wait_s=PATIENCE_S, timeout_s=PATIENCE_S, **cancel))
    return cancel["service"]


def ended_after_s(bridge: Client, observer: Observer, topic: str, cancel: str) -> float:
    """How long after the last packet of a server that drives it was over; then the call that was left has been made."""
    observer.forget()
    bridge.samples.clear()
    bridge.ok("ping", lease_s=0, epoch=0)
    repeating = repeat(bridge, topic, ACKERMANN_STAMPED)
    body = cdr(ACKERMANN_STAMPED, 0.5)
    waiting = bridge.send("publish", body, **command(f"{topic}_later", ACKERMANN_STAMPED, wait_match_s=3600))
    observer.until_driven(topic, 10, 4)
    since = time.monotonic_ns()
    bridge.ok("ping", lease_s=LEASE_S, epoch=0)
    assert bridge.answer(repeating)[0]["ok"]["ended_by"] == "lease"
    assert bridge.answer(waiting)[0]["error"]["kind"] == "lapsed"
    assert [header["silent_s"] >= LEASE_S for header, _ in bridge.samples if header["event"] == "lapsed"] == [True]
    assert observer.comes_to_rest(topic, within_s=REST_S) == []
    heard = observer.messages(topic=topic)
    last_motion = max(one["sent"] for one in heard if any(one["values"]))
    first_zero = min(one["sent"] for one in heard if not any(one["values"]))
    until(lambda: observer.asked(service=cancel))
    # Twice where the ROS thread was so late that another one had to do it, see `FailSafes.carry_out`.
    assert len(observer.asked(service=cancel)) in (1, 2)
    return (max(last_motion, first_zero) - since) / 1e9


def test_a_stopped_server_that_goes_on_finds_the_bridge_as_it_was(begin, observer: Observer, topic: str) -> None:
    bridge = begin()
    observer.watch(topic)
    matched(bridge, topic)
    drive(bridge, topic)
    bridge.ok("ping", lease_s=0.2, epoch=0)
    while bridge.next_packet()[0].get("event") != "lapsed":
        pass
    bridge.ok("ping", lease_s=0, epoch=0)
    assert bridge.ok("publish", cdr(TWIST, 0.5), **command(topic), **WAITS)["matched"] == 4
    observer.until_driven(topic)


def test_what_was_under_way_for_longer_than_a_server_waits_does_not_act(begin, topic: str) -> None:
    """A network delivers after an outage what was sent before it, perhaps before a stop of which this bridge never
    hears: its server has given it up in the meantime.
    """
    bridge = begin()
    long_ago = bridge.ok("ping", heard_s=0)["steady_s"]
    until(lambda: bridge.ok("ping", heard_s=0)["steady_s"] > long_ago + LATE_S + 0.5)
    bridge.ok("ping", heard_s=long_ago)
    for op, body, arguments in (
        ("publish", cdr(TWIST, 0.5), command(topic)),
        ("repeat", cdr(TWIST, 0.5), command(topic, rate_hz=10, duration_s=60)),
        ("call", TRUE, {"service": "/arm", "type": SET_BOOL, "epoch": 0, "timeout_s": 1}),
    ):
        assert bridge.error(op, body, **arguments)["kind"] == "lapsed"
    assert bridge.ok("zero", topics=[topic]) == {"topics": []}  # what ends something is never late
    drive(bridge, topic)
    bridge.ok("ping", heard_s=bridge.ok("ping", heard_s=long_ago)["steady_s"])
    assert bridge.ok("publish", cdr(TWIST, 0.0), **command(topic))["matched"] == 0


@pytest.mark.promise("stopping", "its successor sends the zeros, to each subscriber as it discovers it")
def test_the_successor_of_a_killed_bridge_stops_whoever_it_discovers(begin, observer: Observer, topic: str) -> None:
    for _ in range(ROUNDS):
        bridge = begin()
        names = observer.watch(topic, TWIST_STAMPED)
        matched(bridge, topic)
        drive(bridge, topic, TWIST_STAMPED)
        body = cdr(TWIST_STAMPED, 0.5, frame="base_link")
        bridge.send("repeat", body, **command(topic, TWIST_STAMPED, rate_hz=100, duration_s=60, wait_match_s=20))
        observer.until_driven(topic, 5, len(names))
        bridge.process.send_signal(signal.SIGKILL)
        bridge.process.wait(PATIENCE_S)
        successor = begin()
        drive(successor, topic, TWIST_STAMPED, frame="base_link", now=True)
        assert observer.comes_to_rest(topic, within_s=10.0 if FULL else PATIENCE_S) == []
        assert {one["frame"] for one in observer.last(topic=topic).values()} == {"base_link"}
        for name in names:
            observer.leave(by=name)
        observer.forget()
        successor.close()


def test_a_zero_of_a_successor_does_not_stop_what_is_commanded_anew(begin, observer: Observer, topic: str) -> None:
    bridge = begin()
    drive(bridge, topic, now=True)
    bridge.ok("publish", cdr(TWIST, 0.5), **command(topic))
    observer.watch(topic)
    matched(bridge, topic)
    bridge.ok("publish", cdr(TWIST, 0.5), **command(topic), **WAITS)
    observer.until_driven(topic)
    observer.join(by="later", topic=topic, kind=TWIST)
    until(lambda: observer.matched(by="later") == 3)  # the publishers of the bridge and of its stoppers
    bridge.ok("publish", cdr(TWIST, 0.7), **command(topic), **WAITS)
    until(lambda: observer.driven(topic=topic)["later"] == 1)
    assert [one for one in observer.messages(topic=topic) if not any(one["values"])] == []


def test_publishers_of_every_quality_send_the_zero(begin, observer: Observer, topic: str) -> None:
    """A reliable subscriber gets nothing of the fail-safe's publisher, if that is best effort."""
    bridge = begin()
    observer.watch(topic)
    matched(bridge, topic)
    bridge.send("failsafe_publish", topic=topic, type=TWIST, qos={**RELIABLE, "reliability": "best_effort"})
    bridge.ok("publish", cdr(TWIST, 0.5), **command(topic), **WAITS)
    observer.until_driven(topic)
    told = bridge.ok("stop", epoch=1, **WAITS)["topics"][0]
    assert (told["matched"], told["acked"]) == (4, None)
    assert observer.comes_to_rest(topic, within_s=REST_S) == []


@pytest.mark.promise("stopping", "every zero was acknowledged by all subscribers of its topic (or there are none)")
def test_a_zero_is_acknowledged_if_every_subscriber_says_so(begin, observer: Observer, topic: str) -> None:
    """A recorder that acknowledges does not speak for a base that does not."""
    bridge = begin()
    for epoch, (best_effort, acked) in enumerate((((False, False), True), ((False, True), None), ((True,), None))):
        name = f"{topic}_{epoch}"
        for number, is_best_effort in enumerate(best_effort):
            observer.join(by=f"{name} {number}", topic=name, kind=TWIST, best_effort=is_best_effort)
        matched(bridge, name, len(best_effort))
        drive(bridge, name)
        assert bridge.ok("publish", cdr(TWIST, 0.5), **command(name, epoch=epoch), **WAITS)["acked"] is acked
        (told,) = [row for row in bridge.ok("stop", epoch=epoch + 1, **WAITS)["topics"] if row["topic"] == name]
        assert told["acked"] is acked


def test_a_broken_clock_keeps_no_topic_from_its_zero(
    begin, apart: dict[str, str], own_observer: Observer, topic: str
) -> None:
    """Messages on /clock that nobody can decode, or that hold no time."""
    bridge, observer = begin(apart), own_observer
    observer.join(by="simulated", topic=topic, kind=TWIST_STAMPED, sim_time=True)
    observer.watch(f"{topic}_other")
    matched(bridge, topic, 1)
    matched(bridge, f"{topic}_other")
    drive(bridge, topic, TWIST_STAMPED)
    drive(bridge, f"{topic}_other")
    observer.offer(topic="/clock", kind=CLOCK)
    bridge.ok("wait_endpoints", topic="/clock", publishers=1, subscribers=1, timeout_s=PATIENCE_S)
    bridge.ok("publish", cdr(TWIST_STAMPED, 0.5), **command(topic, TWIST_STAMPED), **WAITS)
    bridge.ok("publish", cdr(TWIST, 0.5), **command(f"{topic}_other"), **WAITS)
    bodies = [bytes.fromhex("00010000ffffff7fffffffff"), b"\0\1\0\0\1\0"]
    observer.say(topic="/clock", kind=CLOCK, bodies=[body.hex() for body in bodies], gap_s=0.1)
    assert len(bridge.ok("stop", epoch=1, **WAITS)["topics"]) == 2
    for name in (topic, f"{topic}_other"):
        assert observer.comes_to_rest(name, within_s=REST_S) == []


@pytest.mark.promise("stopping", "A 65th velocity topic, because only 64 have a fail-safe")
def test_one_topic_more_than_there_are_fail_safes_is_refused_and_takes_none_away(begin, topic: str) -> None:
    bridge = begin()
    open_requests = [drive(bridge, f"{topic}_{number}") for number in range(MAX_FAILSAFES)]
    refused = bridge.error("failsafe_publish", topic=f"{topic}_more", type=TWIST, qos=RELIABLE)
    assert refused["kind"] == "bad_request" and str(MAX_FAILSAFES) in refused["message"]
    assert bridge.error("publish", cdr(TWIST, 0.5), **command(f"{topic}_more"))["kind"] == "bad_request"
    assert len(bridge.ok("stop", epoch=1)["topics"]) == MAX_FAILSAFES
    bridge.ok("cancel", request=open_requests[0])
    drive(bridge, f"{topic}_more")
    assert bridge.ok("publish", cdr(TWIST, 0.5), **command(f"{topic}_more", epoch=1))


def test_a_type_of_which_nobody_knows_what_stops_it_has_no_fail_safe(bridge: Client, topic: str) -> None:
    refused = bridge.error("failsafe_publish", topic=topic, type="std_msgs/msg/String", qos=RELIABLE)
    assert refused["kind"] == "bad_request" and "std_msgs/msg/String" in refused["message"]
