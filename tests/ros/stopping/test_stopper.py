"""Whatever dies or hangs, every subscriber has a zero, and nothing that moves it after that: the second process that
stops. How soon, half a second, is measured in full.
"""

from __future__ import annotations

import os
import random
import signal
import subprocess
import time
from collections.abc import Callable
from contextlib import suppress
from functools import partial
from pathlib import Path
from statistics import median

import pytest

from support.agent import FULL, until
from support.driver import MOVING, WAYS, Driver, calm, fresh, repeat
from support.observer import STOPS_S, Observer
from support.processes import peer_command
from support.raw_server import children, lives
from support.standstill import Judged, undisturbed, undisturbed_where_judged
from support.velocities import TWIST, TWIST_STAMPED, speed

BAR_S = 0.5
MEDIAN_BAR_S = 0.15
SPEED = 0.3
SOON_S = 0.1
"""Half of the deaths come so long after the first command."""
LATER_S = (0.3, 1.5)
NO_SUCCESSOR_S = 5.0
"""After a death without a successor the stopper waits for late subscribers for 4 s, and leaves."""
STAMPED_S, ROUNDED_NS = 0.1, 10
"""DDS has the time at which something was written in steps of 2**-32 s."""
THEIR_PROFILE = {"FASTRTPS_DEFAULT_PROFILES_FILE": str(Path(__file__).parents[1] / "quiet_fast_dds.xml")}
"""A user has chosen how participants reach each other: the stopper, too, has shared memory then."""

pytestmark = pytest.mark.timeout(2400 if FULL else 300)


def kill(*victims: Callable[[Driver], int]) -> Callable[[Driver], None]:
    def do(server: Driver) -> None:
        for pid in [victim(server) for victim in victims]:
            os.kill(pid, signal.SIGKILL)

    return do


def of_server(server: Driver) -> int:
    return server.process.pid


def of_bridge(server: Driver) -> int:
    return children(server.process.pid)[0]


def of_stopper(server: Driver) -> int:
    return children(of_bridge(server))[0]


def end_client(server: Driver) -> None:
    """What the server notices of a client that dies: the end of its stream."""
    assert server.process.stdin
    server.process.stdin.close()


FATES: dict[str, tuple[Callable[[Driver], None], int]] = {
    "the bridge is killed": (kill(of_bridge), 200),
    "server and bridge are killed": (kill(of_server, of_bridge), 200),
    "the client ends": (end_client, 50),
    "the server is killed": (kill(of_server), 50),
    "the stopper is killed": (kill(of_stopper), 50),
    "the bridge is stopped": (lambda server: os.kill(of_bridge(server), signal.SIGSTOP), 50),
}
"""What happens, and how often in full."""
ENDS_THE_SERVER = ("server and bridge are killed", "the client ends", "the server is killed")


def begin(server: Driver, observer: Observer, kind: str = TWIST, **header: str) -> tuple[str, int]:
    """A topic with four subscribers that is driven for the first time, by a repeat: its name, and the request."""
    topic = fresh("guarded")
    observer.watch(topic, kind)
    server.knows(topic, 4)
    data = speed(kind, SPEED, {"frame_id": "base_link"} if kind == TWIST_STAMPED else None)
    request = server.tool(
        "ros2_topic_publish", topic_name=topic, message_type=kind, data=data, frequency=20, duration=60
    )
    observer.until_driven(topic, 1, of=4)
    return topic, request


def sockets(pid: int) -> set[str]:
    opened = set[str]()
    for each in Path(f"/proc/{pid}/fd").iterdir():
        with suppress(FileNotFoundError):  # closed since
            opened.add(str(each.readlink()))
    return {each for each in opened if each.startswith("socket:")}


def leave(observer: Observer, topic: str) -> None:
    for by in observer.counts(topic=topic):
        if by.startswith(f"{topic} "):
            observer.leave(by=by)
    observer.forget()


def first_zeros_s(observer: Observer, topic: str, since_ns: int) -> list[float]:
    """For each subscriber, when its first zero came; there is one more number that is too large if one has none."""
    zeros: dict[str, float] = {}
    for one in observer.messages(topic=topic, after=since_ns):
        if not any(one["values"]):
            zeros.setdefault(one["by"], (one["at"] - since_ns) / 1e9)
    return [*zeros.values(), *([1e9] if observer.moving(topic=topic) or len(zeros) < 4 else [])]


@pytest.mark.promise("stopping", "the *stopper*, a second process beside the bridge, sends the zeros")
@pytest.mark.promise("README", "Where the bridge dies or hangs, the *stopper*, one more process, sends the zero")
@pytest.mark.promise("stopping", "the stopper is killed while something moves")
@pytest.mark.promise("stopping", "the bridge is stopped (`SIGSTOP`) or hangs")
@pytest.mark.parametrize("fate", FATES)
def test_every_subscriber_has_a_zero_and_nothing_that_moves_it_after_that(
    start_server, server: Driver, observer: Observer, fate: str
) -> None:
    """By the order in which the messages were written, once every process that could send another one has ended."""
    happen, _ = FATES[fate]
    mine = start_server() if fate in ENDS_THE_SERVER else server
    topic, request = begin(mine, observer)
    observer.until_guarded(topic)
    bridge, stopper = of_bridge(mine), of_stopper(mine)
    stoppers, since_ns = children(bridge), time.time_ns()
    happen(mine)
    observer.until_stopped(topic, since_ns)
    if fate in ENDS_THE_SERVER:
        mine.end()
    else:
        mine.outcome(request)
    has_ended = (stopper,) if fate == "the stopper is killed" else (bridge, *stoppers)
    until(lambda: not any(map(lives, has_ended)))
    assert observer.unstopped(topic=topic, since=since_ns) == []
    leave(observer, topic)


@pytest.mark.full
@pytest.mark.promise("README", "the *stopper*, one more process, sends the zero within 0.5 s")
@pytest.mark.promise("stopping", "the *stopper*, a second process beside the bridge, sends the zeros")
@pytest.mark.promise("stopping", "the stopper is killed while something moves")
@pytest.mark.promise("stopping", "the bridge is stopped (`SIGSTOP`) or hangs")
@pytest.mark.parametrize("fate", FATES)
def test_every_subscriber_has_a_zero_within_half_a_second(start_server, observer: Observer, fate: str) -> None:
    happen, rounds = FATES[fate]
    chance, processes = random.Random(30), list[int]()

    def seconds(after_s: float, judged: Judged) -> float:
        server = start_server()
        topic, _ = begin(server, observer)
        time.sleep(after_s)
        begun = children(server.process.pid)
        processes.extend(begun)
        since_ns = time.monotonic_ns()
        with judged():
            happen(server)
            until(lambda: max(first_zeros_s(observer, topic, since_ns)) < NO_SUCCESSOR_S, NO_SUCCESSOR_S)
        took_s = max(first_zeros_s(observer, topic, since_ns))
        if fate == "the bridge is stopped" and lives(begun[0]):
            os.kill(begun[0], signal.SIGCONT)
        server.end()
        leave(observer, topic)
        print(f"{fate}: {took_s:.3f}", flush=True)
        return took_s

    took_s = [
        undisturbed_where_judged(partial(seconds, chance.uniform(*LATER_S) if number % 2 else SOON_S))
        for number in range(rounds)
    ]
    print(f"{fate}, judged: {sorted(round(each, 3) for each in took_s)}", flush=True)
    assert max(took_s) <= BAR_S
    assert median(took_s) <= MEDIAN_BAR_S
    until(lambda: not any(map(lives, processes)))


def test_the_zero_of_the_stopper_is_stamped_in_the_robots_frame_and_reaches_who_came_late(
    start_server, observer: Observer
) -> None:
    server = start_server()
    topic, _ = begin(server, observer, TWIST_STAMPED)
    for number in range(2):
        observer.join(
            by=f"{topic} late {number}", topic=topic, kind=TWIST_STAMPED, best_effort=bool(number), apart=True
        )
    until(lambda: sum(count > 0 for count in observer.driven(topic=topic).values()) >= 6)
    observer.until_guarded(topic)
    since_ns = time.time_ns()
    kill(of_server, of_bridge)(server)
    observer.until_stopped(topic, since_ns, full_s=NO_SUCCESSOR_S)
    zeros = [one for one in observer.messages(topic=topic) if one["written"] > since_ns and not any(one["values"])]
    assert len({one["by"] for one in zeros}) == 6
    assert {one["frame"] for one in zeros} == {"base_link"}
    assert all(since_ns < one["stamp"] <= one["written"] + ROUNDED_NS for one in zeros), zeros
    if FULL:
        assert observer.misstamped(topic=topic, most_s=STAMPED_S) == []
    leave(observer, topic)


def publishing(server: Driver, topic: str) -> set[str]:
    """The nodes that publish on a topic, as a server tells them: never a stopper."""
    nodes = {one["node"] for one in server.do("ros2_topic_info", topic_name=topic)["publishers"]}
    assert "stopper" not in str(nodes)
    return nodes


def counted(server: Driver, topic: str) -> tuple[int, int]:
    """How many publishers and subscribers of a topic that two servers drive a server lists: never a stopper."""
    listed = next(row for row in server.do("ros2_topic_list")["topics"] if topic in row.values())
    assert listed["publishers"] <= 2
    return listed["publishers"], listed["subscribers"]


def test_a_stopper_is_nowhere_taken_for_a_part_of_the_robot(start_server, server: Driver, observer: Observer) -> None:
    """Not by its own server, and not by another one, which drives the same topic."""
    other = start_server()
    topic, request = begin(server, observer)
    other.knows(topic, 4)
    other.do("ros2_topic_publish", topic_name=topic, message_type=TWIST, data=speed(TWIST, MOVING))
    for who, whom in ((server, other), (other, server)):
        bridges = {f"/ros2_mcp_{of_bridge(who)}", f"/ros2_mcp_{of_bridge(whom)}"}
        until(lambda who=who, both=bridges: publishing(who, topic) == both)  # the other may be discovered late
        assert not [node for node in who.do("ros2_node_list")["nodes"] if "stopper" in node]
        until(lambda who=who: counted(who, topic) == (2, 4))
        stopped, _ = who.stop()
        [row] = [one for one in stopped["topics"] if one["topic_name"] == topic]
        assert row["other_publishers"] == [f"/ros2_mcp_{of_bridge(whom)}"]
        assert (row["subscribers"], row["unreached_subscribers"]) == (4, 0)
        assert "stopper" not in str(who.do("ros2_health_check", rate_check_duration_sec=1.0))
    server.result(request)
    leave(observer, topic)


def test_a_bridge_that_goes_on_moves_the_robot_again_unless_it_was_given_up(server: Driver, observer: Observer) -> None:
    """The server gives it up after 0.5 s; whichever comes first, the answer says it, and a stop holds."""
    topic, request = begin(server, observer)
    bridge, since_ns = of_bridge(server), time.time_ns()
    os.kill(bridge, signal.SIGSTOP)
    try:
        observer.until_stopped(topic, since_ns)
    finally:
        with suppress(ProcessLookupError):
            os.kill(bridge, signal.SIGCONT)
    until(lambda: server.answered(request) or observer.moving(topic=topic))
    since_ns = time.time_ns()
    server.stop()
    told = server.outcome(request)
    assert "ended by ros2_stop" in told or "BridgeLost" in told, told
    if "BridgeLost" not in told:
        observer.until_stopped(topic, since_ns)
    assert observer.comes_to_rest(topic, STOPS_S) == []  # the zero of a stopper may still be under way
    leave(observer, topic)


@pytest.mark.full
def test_a_bridge_that_goes_on_in_time_moves_the_robot_again(start_server, observer: Observer) -> None:
    """If it does so before the server gives it up, which takes 0.5 s: no more than twice what the stopper takes."""

    def outcome() -> tuple[bool, str]:
        server = start_server()
        topic, request = begin(server, observer)
        bridge = of_bridge(server)
        os.kill(bridge, signal.SIGSTOP)
        try:
            assert observer.comes_to_rest(topic, BAR_S) == []
        finally:
            with suppress(ProcessLookupError):  # the server has given it up meanwhile, and says so below
                os.kill(bridge, signal.SIGCONT)
        end = time.monotonic() + NO_SUCCESSOR_S
        while not (moves := bool(observer.moving(topic=topic))) and time.monotonic() < end:
            time.sleep(0.01)
        server.stop()
        told = server.outcome(request)
        assert observer.comes_to_rest(topic, 1.0) == []
        server.end()
        leave(observer, topic)
        return moves, told

    for _ in range(5):
        moves, told = outcome()
        if "BridgeLost" not in told:
            break
    assert moves and "ended by ros2_stop" in told, told


def test_the_first_command_says_that_it_waited_and_a_zero_waits_for_nobody(start_server, observer: Observer) -> None:
    server, topic = start_server(), fresh("first")
    observer.watch(topic)
    server.knows(topic, 4)
    message = {"topic_name": topic, "message_type": TWIST}
    notes = [server.do("ros2_topic_publish", **message, data=speed(TWIST, value))["note"] for value in (0.0, 0.3, 0.3)]
    assert ["for the stopper" in note for note in notes] == [False, True, False]
    leave(observer, topic)


@pytest.mark.parametrize("way", ["relay", "feed", "playback"])
def test_a_relay_and_a_playback_say_that_they_waited(server: Driver, observer: Observer, way: str) -> None:
    """The stopper before is dead: one that runs knows a topic so soon that nobody waits."""
    former, request = begin(server, observer)
    os.kill(of_stopper(server), signal.SIGKILL)
    server.result(request)
    leave(observer, former)
    topic = fresh("waits")
    observer.watch(topic)
    server.knows(topic, 4)
    assert "for the stopper" in server.result(WAYS[way](server, observer, topic))["note"]
    calm(observer, topic)
    server.stop()
    leave(observer, topic)


def test_a_command_after_the_death_of_a_stopper_has_another_one(server: Driver, observer: Observer) -> None:
    topic, request = begin(server, observer)
    former = of_stopper(server)
    os.kill(former, signal.SIGKILL)
    assert "stopper" in server.result(request)["note"]
    server.do("ros2_topic_publish", topic_name=topic, message_type=TWIST, data=speed(TWIST, SPEED))
    assert of_stopper(server) != former
    assert Path(f"/proc/{of_stopper(server)}").exists()
    assert not sockets(of_stopper(server)) & sockets(of_bridge(server))
    server.stop()
    leave(observer, topic)


@pytest.mark.full
def test_what_the_dead_left_locked_in_shared_memory_holds_up_no_zero(start_server, observer: Observer) -> None:
    """A process that is killed while it writes leaves the port of the robot locked, for which others wait 1 s."""

    def seconds() -> float:
        server = start_server()
        topic, _ = begin(server, observer)
        with subprocess.Popen(
            peer_command("locking_peer", str(observer.pid)), stdin=subprocess.PIPE, stdout=subprocess.PIPE
        ) as writer:
            assert writer.stdout and int(writer.stdout.readline()) > 0
            writer.kill()
        since_ns = time.monotonic_ns()
        kill(of_server, of_bridge)(server)
        until(lambda: max(first_zeros_s(observer, topic, since_ns)) < NO_SUCCESSOR_S, NO_SUCCESSOR_S)
        took_s = max(first_zeros_s(observer, topic, since_ns))
        leave(observer, topic)
        return took_s

    assert undisturbed(seconds) <= BAR_S


def lost_zeros_s(server: Driver, observer: Observer, way: str) -> float:
    """How long it takes from an end until who acknowledges nothing has a zero, the first of which were lost.

    Fast DDS gives a port of its shared memory up when a thread was not run for a second; all that is sent meanwhile is
    lost, the first zeros too. Who acknowledges has them again; nobody knows of the others.
    """
    topic = fresh("unsure")
    observer.join(by=topic, topic=topic, kind=TWIST, best_effort=True, apart=True)
    server.knows(topic, 1)
    repeat(server, observer, topic)
    observer.until_driven(topic, 2)
    with subprocess.Popen(
        peer_command("locking_peer", str(observer.pid), "give-up"), stdin=subprocess.PIPE, stdout=subprocess.PIPE
    ) as peer:
        assert peer.stdout and int(peer.stdout.readline()) > 0
        since_ns, since_unix_ns = time.monotonic_ns(), time.time_ns()
        if way == "ros2_stop":
            server.stop()
        else:
            end_client(server)
    try:
        observer.until_stopped(topic, since_unix_ns)
        zeros = [one["at"] for one in observer.messages(topic=topic) if not any(one["values"])]
        return (zeros[0] - since_ns) / 1e9
    finally:
        observer.leave(by=topic)


@pytest.mark.promise("stopping", "to a subscriber who does not acknowledge (best effort) it is sent again")
@pytest.mark.parametrize("way", ["the client ends", "ros2_stop"])
def test_a_zero_that_was_lost_for_who_acknowledges_nothing_is_sent_again(
    start_server, server: Driver, observer: Observer, way: str
) -> None:
    lost_zeros_s(server if way == "ros2_stop" else start_server(), observer, way)


@pytest.mark.full
@pytest.mark.parametrize("profile", ["", "theirs"])
@pytest.mark.parametrize("way", ["the client ends", "ros2_stop"])
def test_a_zero_that_was_lost_comes_within_half_a_second(
    start_server, observer: Observer, way: str, profile: str
) -> None:
    def seconds() -> float:
        server = start_server(**THEIR_PROFILE if profile else {})
        try:
            return lost_zeros_s(server, observer, way)
        finally:
            server.end()  # of too many participants at once, the later ones discover nobody

    took_s = [undisturbed(seconds) for _ in range(25)]
    print(f"{way} {profile}: {sorted(round(each, 3) for each in took_s)}", flush=True)
    assert max(took_s) <= BAR_S


@pytest.mark.parametrize("profile", ["", "theirs"], ids=["none", "theirs"])
def test_the_stopper_does_without_shared_memory_unless_somebody_chose_transports(
    start_server, server: Driver, observer: Observer, profile: str
) -> None:
    """In it, a process that is killed while it writes leaves a lock, for which others wait 1 s."""
    mine = start_server(**THEIR_PROFILE) if profile else server
    topic, _ = begin(mine, observer)
    mapped = Path(f"/proc/{of_stopper(mine)}/maps").read_text()
    assert ("/dev/shm/fastrtps_port" in mapped) == bool(profile)
    mine.stop()
    leave(observer, topic)
