"""What the bridge promises of the latch: whoever sets it, what moves ends; until it is reset nothing moves, nor what
was there before. Judged by an observer in another process.
"""

from __future__ import annotations

import itertools
import json
import signal
import time
from contextlib import suppress
from pathlib import Path

import pytest

from ros2_mcp_common.latch import FILE, Latch
from ros2_mcp_common.policy.rules import Rules, RuleSet
from support.agent import FULL, until
from support.bridge_client import PATIENCE_S, RELIABLE, Client
from support.observer import Observer
from support.velocities import TWIST, TWIST_STAMPED, cdr

ROUNDS = 200 if FULL else 2
SET_BOOL, TRUE = "std_srvs/srv/SetBool", b"\0\1\0\0\1"
NOTICED_S = 0.1
"""The bridge looks every 0.05 s, and sends at once."""
_numbers = itertools.count(1)


@pytest.fixture
def latch(tmp_path: Path) -> Latch:
    """As another process has it, such as the stopper."""
    return Latch(tmp_path / FILE)


@pytest.fixture
def begin(start, tmp_path: Path):
    """Start a bridge that has this latch."""
    return lambda: Client(start("ros2_mcp_bridge", "--state", str(tmp_path)))


def watched(bridge: Client, observer: Observer) -> str:
    """A driven topic with four subscribers."""
    topic = f"/latched_{next(_numbers)}"
    observer.watch(topic)
    bridge.ok("wait_endpoints", topic=topic, publishers=0, subscribers=4, timeout_s=PATIENCE_S)
    bridge.send("failsafe_publish", topic=topic, type=TWIST, qos=RELIABLE)
    return topic


def begun_and_watched(begin, observer: Observer) -> tuple[Client, str]:
    """A bridge and its topic. After a kill, processes may replace the shared memory that a new bridge receives through:
    then it leaves, and the server, which this test stands for, begins another.
    """
    for _ in range(2):
        bridge = begin()
        with suppress(BrokenPipeError, EOFError):
            return bridge, watched(bridge, observer)
        assert bridge.process.wait(PATIENCE_S) in (0, -signal.SIGALRM), "it did not leave, it died"
    raise AssertionError("two bridges left")


def drive(bridge: Client, topic: str, value: float = 0.5) -> int:
    given = {"topic": topic, "type": TWIST, "qos": RELIABLE, "epoch": 0, "wait_match_s": PATIENCE_S}
    return bridge.send("repeat", cdr(TWIST, value), rate_hz=50, duration_s=60, **given)


def once(bridge: Client, topic: str, value: float = 0.5) -> int:
    given = {"topic": topic, "type": TWIST, "qos": RELIABLE, "epoch": 0, "wait_match_s": PATIENCE_S, "wait_ack_s": 1}
    return bridge.send("publish", cdr(TWIST, value), **given)


@pytest.mark.timeout(1200 if FULL else 120)
def test_whoever_sets_it_what_moves_ends_with_a_zero_and_a_reset_starts_nothing(
    begin, observer: Observer, latch: Latch
) -> None:
    latched_and_reset_s(begin(), observer, latch)


@pytest.mark.full
@pytest.mark.timeout(1200)
def test_what_moves_rests_half_a_second_after_the_latch_was_set(begin, observer: Observer, latch: Latch) -> None:
    # the observer is asked every 20 ms, and the machine is busy
    assert max(latched_and_reset_s(begin(), observer, latch, looks_s=3 * NOTICED_S)) < NOTICED_S + 0.4


def latched_and_reset_s(bridge: Client, observer: Observer, latch: Latch, looks_s: float = 0.0) -> list[float]:
    """How long after each setting of the latch what moved was at rest.

    `looks_s`: how long the bridge is left with each state of the latch, so that it has seen it.
    """
    topic, took_s = watched(bridge, observer), list[float]()

    def told() -> list[tuple[str, str]]:
        bridge.ok("stats")
        causes = [(event["by"], event["reason"]) for event, _ in bridge.samples if event["event"] == "latched"]
        # A bridge that has not looked between two of what follows says that somebody has set and reset the latch.
        return [cause for cause in causes if looks_s or cause[0] != "somebody"]

    for number in range(1, ROUNDS + 1):
        before = max(observer.driven(topic=topic).values(), default=0)
        repeating = drive(bridge, topic)
        observer.until_driven(topic, number=before + 3, of=4)
        latch.set(by="stopper", reason="the bridge was silent")
        set_at = time.monotonic()
        assert observer.comes_to_rest(topic, PATIENCE_S) == []
        took_s.append(time.monotonic() - set_at)
        assert bridge.answer(repeating)[0]["ok"]["ended_by"] == "latch"
        until(lambda number=number: told() == [("stopper", "the bridge was silent")] * number)
        refused_at = time.monotonic_ns()
        latch.set(by="ros2_stop", reason="an agent stopped it")  # once more: its first cause stays, and was told
        for request in (once(bridge, topic), drive(bridge, topic)):
            assert bridge.answer(request)[0]["error"]["kind"] == "latched"
        time.sleep(looks_s)
        assert len(told()) == number
        latch.reset(by="operator", seen=latch.look().count)
        time.sleep(looks_s)
        assert len(told()) == number
        assert "ok" in bridge.answer(once(bridge, topic, 0.25 + number))[0]
        moved = until(lambda since=refused_at: observer.moved(sent_after=since, topic=topic))
        assert {one["values"][0] for one in moved} == {0.25 + number}  # what comes after the reset, and nothing before
    return took_s


def test_what_begins_after_a_reset_goes_on_though_the_latch_was_set_a_moment_before(
    begin, observer: Observer, latch: Latch
) -> None:
    """Set and reset between two looks of the bridge, which ends what was accepted before, and that alone."""
    bridge = begin()
    before, after = watched(bridge, observer), watched(bridge, observer)
    for _ in range(ROUNDS if FULL else 5):
        moved = {topic: max(observer.driven(topic=topic).values(), default=0) for topic in (before, after)}
        earlier = drive(bridge, before)
        observer.until_driven(before, number=moved[before] + 1)
        latch.set(by="ros2_stop", reason="an agent stopped it")
        latch.reset(by="operator", seen=latch.look().count)
        later = drive(bridge, after)
        assert bridge.answer(earlier)[0]["ok"]["ended_by"] == "latch"
        observer.until_driven(after, number=moved[after] + 10, of=4)  # for 0.2 s: the bridge has looked by then
        bridge.ok("cancel", request=later)
        assert bridge.answer(later)[0]["ok"]["ended_by"] == "cancel"


def test_it_holds_for_the_next_bridge(begin, observer: Observer, latch: Latch) -> None:
    latch.set(by="watchdog", reason="too fast")
    for _ in range(2):
        bridge, topic = begun_and_watched(begin, observer)
        for request in (once(bridge, topic), drive(bridge, topic)):
            assert bridge.answer(request)[0]["error"]["kind"] == "latched"
        assert observer.moved(sent_after=0, topic=topic) == []
        bridge.process.send_signal(signal.SIGKILL)
        bridge.process.wait(PATIENCE_S)


def test_it_holds_for_calls_of_a_server_that_is_wrong(begin, observer: Observer, latch: Latch) -> None:
    """One that leaves out when it accepted a call, or leaves a call for the end that cancels no goal."""
    bridge, service = begin(), f"/lamp_{next(_numbers)}"
    observer.serve(service=service, kind=SET_BOOL)
    lamp = {"service": service, "type": SET_BOOL, "timeout_s": PATIENCE_S}
    bridge.ok("call", TRUE, wait_s=PATIENCE_S, **lamp)
    assert bridge.error("failsafe_call", TRUE, **lamp)["kind"] == "bad_request"
    assert bridge.error("call", TRUE, brakes=True, **lamp)["kind"] == "bad_request"
    latch.set(by="operator", reason="enough")
    until(lambda: bridge.error("call", TRUE, **lamp)["kind"] == "latched")
    assert len(observer.asked(service=service)) == 1


def test_a_latch_that_cannot_be_read_any_more_ends_what_moves(begin, observer: Observer, latch: Latch) -> None:
    latch.reset(by="operator", seen=latch.look().count)
    bridge = begin()
    topic = watched(bridge, observer)
    assert "ok" in bridge.answer(once(bridge, topic))[0]
    observer.until_driven(topic, of=4)
    assert latch.path
    latch.path.write_bytes(b"")
    assert observer.comes_to_rest(topic, PATIENCE_S) == []


@pytest.mark.parametrize(
    "told",
    ["still moves 0.5 s after its zero", "faster than the policy", "nothing"],
    ids=["moves", "too fast", "silent"],
)
def test_the_watchdog_stops_and_latches_by_what_the_robot_tells(
    begin, observer: Observer, latch: Latch, told: str
) -> None:
    """Odometry that tells of motion after the zero, of too much of it, or of nothing while the robot is driven."""
    bridge, odometry = begin(), f"/odom_{next(_numbers)}"
    feedback = {
        "topic": odometry,
        "type": "geometry_msgs/msg/TwistStamped",
        "path": "twist",
        "still": {"linear": 0.03, "angular": 0.05},
        "most": {"linear": 2.0},
        "within_s": 0.5,
        "over": 1.2,
        "max_age_s": 2.0,  # longer than the robot's next odometry needs to be discovered
    }
    rules = Rules("digest", (RuleSet("test", allows_all=True),)).as_json()
    bridge.ok("policy", json.dumps({**rules, "watch": {"feedback": feedback}}).encode())
    observer.talk(topic=odometry, kind=TWIST_STAMPED, hz=50.0, value=0.3)
    topic = watched(bridge, observer)
    repeating = drive(bridge, topic)
    observer.until_driven(topic, number=50, of=4)
    assert not latch.look().is_set
    began_at = time.monotonic()
    if told.startswith("still"):
        bridge.send("cancel", request=repeating)
    else:
        observer.hush(topic=odometry)
    if told.startswith("faster"):
        observer.talk(topic=odometry, kind=TWIST_STAMPED, hz=50.0, value=5.0)
    state = until(lambda: latch.look().is_set and latch.look())
    print(told, round(time.monotonic() - began_at, 2))
    assert state.by == "watchdog" and told in state.reason
    assert observer.comes_to_rest(topic, PATIENCE_S) == []
    assert bridge.answer(repeating)[0]["ok"]["ended_by"] == ("cancel" if told.startswith("still") else "latch")


def test_a_place_in_another_frame_than_the_zone_stops_and_latches(begin, observer: Observer, latch: Latch) -> None:
    """The zone is the whole world; but where in it the robot is nobody knows."""
    bridge, place = begin(), f"/place_{next(_numbers)}"
    world = {"frame_id": "map", "polygon": [[-1e6, -1e6], [1e6, -1e6], [0, 1e6]], "margin_m": 0.0}
    pose = {"topic": place, "type": TWIST_STAMPED, "path": "twist", "frame_id": "map", "zone": world}
    rules = Rules("digest", (RuleSet("test", allows_all=True),)).as_json()
    watch = {"pose": {**pose, "brake_mps2": 1.0, "max_age_s": 1.0}}
    bridge.ok("policy", json.dumps({**rules, "watch": watch}).encode())
    observer.talk(topic=place, kind=TWIST_STAMPED, hz=50.0, value=0.3)
    topic = watched(bridge, observer)
    repeating = drive(bridge, topic)
    state = until(lambda: latch.look().is_set and latch.look())
    assert state.by == "watchdog" and "its frame is '', not 'map'" in state.reason
    assert observer.comes_to_rest(topic, PATIENCE_S) == []
    assert bridge.answer(repeating)[0]["ok"]["ended_by"] == "latch"
