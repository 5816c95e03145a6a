"""The link to a robot elsewhere dies without anybody being told: the robot stops, and later all goes on."""

from __future__ import annotations

import os
import signal
import time
from collections.abc import Callable
from pathlib import Path

import pytest

from support.agent import until
from support.driver import COMES_UP_S, WAYS, Driver, calm, fresh, until_driven, write_bag
from support.driver import MOVING as DRIVES
from support.network_link import NetworkLink
from support.observer import Observer
from support.sshd import Sshd, ssh_of
from support.standstill import undisturbed
from support.velocities import TWIST, cdr

LEASE_S = 2.0
LIMIT_S = LEASE_S + 0.3
OUTAGE_S = 60.0
"""The first answer in it comes after 4 s of silence, the next one when ssh has given up."""
ROUNDS = 20
REST_S = 30.0
"""Only ends a hang: what drives would go on for 60 s and more."""
ORPHAN_S = 15.0

pytestmark = pytest.mark.timeout(300)


def drove_s(observer: Observer, topic: str, since: float) -> float:
    """How long after that time the last command was sent that moves the robot: until its zero had left."""
    if observer.moving(topic=topic):
        return float("inf")
    heard = observer.messages(topic=topic)
    last_move = max(one["sent"] for one in heard if any(one["values"]))
    zero = min(one["sent"] for one in heard if one["sent"] > last_move)
    return zero / 1e9 - since


@pytest.fixture
def cut(
    laptop: Callable[..., Driver], link: NetworkLink, observer: Observer, tmp_path: Path
) -> Callable[[], dict[str, float]]:
    """Cuts the link while the robot is driven in every way; gives how long each still drove it, in s, while it was cut.

    When it is mended, nothing moves again.
    """
    write_bag(tmp_path, [cdr(TWIST, DRIVES)] * 100)
    server = laptop()
    server.bridge()

    def cut_it() -> dict[str, float]:
        observer.forget()
        topics = {way: fresh(f"cut_{way}") for way in WAYS}
        for topic in topics.values():
            observer.join(by=topic, topic=topic, kind=TWIST)
        server.knows(topics["playback"], 1)
        requests = {way: WAYS[way](server, observer, topic) for way, topic in topics.items()}
        for way, topic in topics.items():
            requests[way] = until_driven(server, observer, way, topic, requests[way])
        since = link.cut()
        for topic in topics.values():
            assert observer.comes_to_rest(topic, REST_S) == []
        took = {way: drove_s(observer, topic, since) for way, topic in topics.items()}
        back_ns = time.monotonic_ns()
        link.mend()
        for request in requests.values():
            server.outcome(request)
        server.stop()
        for topic in topics.values():
            assert observer.moved(sent_after=back_ns, topic=topic) == [], "it moves again"
            calm(observer, topic)
            observer.leave(by=topic)
        return took

    return cut_it


def test_a_link_that_is_cut_leaves_nothing_moving_and_nothing_moves_when_it_is_mended(
    cut: Callable[[], dict[str, float]],
) -> None:
    cut()


@pytest.mark.full
@pytest.mark.timeout(1800)
def test_a_link_that_is_cut_leaves_nothing_moving_for_longer_than_the_lease(
    cut: Callable[[], dict[str, float]],
) -> None:
    worst = 0.0
    for number in range(ROUNDS):
        took = undisturbed(cut)
        worst = max(worst, *took.values())
        print(number + 1, "rounds, at most", round(worst, 3), "s", took, flush=True)
        assert max(took.values()) <= LIMIT_S, took


def test_a_link_that_comes_back_is_used_at_once_and_what_was_recorded_and_watched_goes_on(
    laptop: Callable[..., Driver], link: NetworkLink, observer: Observer
) -> None:
    server, topic = laptop(), fresh("kept")
    observer.talk(topic=topic, kind=TWIST, hz=20.0, value=1.0)
    server.bridge()
    until(lambda: topic in str(server.do("ros2_topic_list")))
    recording = server.do("ros2_record_start", topic_names=[topic])["recording_id"]

    def written() -> int:
        (state,) = server.do("ros2_record_status", recording_id=recording)["recordings"]
        return state["messages"]

    until(lambda: written() > 10)
    link.cut()
    lost = server.outcome(server.tool("ros2_topic_info", topic_name=topic))
    assert "stops what this server drove 2 s after the last message it received" in lost
    again = server.outcome(server.tool("ros2_topic_info", topic_name=topic), OUTAGE_S)
    assert "does not answer" in again
    stopped, _ = server.stop()
    assert not stopped["confirmed"] and "The stop continues in the background" in stopped["note"]
    before = written()
    since = link.mend()
    until(
        lambda: not server.answer(server.tool("ros2_topic_info", topic_name=topic))["result"].get("isError"), COMES_UP_S
    )
    print("answered again after", round(time.monotonic() - since, 2), "s", flush=True)
    until(lambda: written() > before + 10, COMES_UP_S)
    state = server.do("ros2_record_stop", recording_id=recording)
    assert any("The robot was out of reach for" in note for note in state["notes"]), state["notes"]
    status = server.do("ros2_status")
    assert "The robot was reached again" in status["bridge_restarts"][-1]
    observer.hush(topic=topic)


@pytest.mark.parametrize("victim", ["the server", "ssh"])
def test_who_is_killed_here_leaves_nothing_there(
    laptop: Callable[..., Driver], link: NetworkLink, far: Sshd, victim: str
) -> None:
    server = laptop()
    bridge = server.bridge()
    assert bridge in processes_of(far)
    if victim == "the server":
        server.process.kill()
    else:
        os.kill(ssh_of(server.process.pid), signal.SIGKILL)
    until(lambda: bridge not in processes_of(far))
    if victim == "ssh":
        until(lambda: server.bridge() != bridge)  # the server may notice it later
        return
    until(lambda: processes_of(far) == set(), REST_S + ORPHAN_S)


@pytest.mark.full
def test_a_bridge_that_hears_nothing_any_more_leaves(
    laptop: Callable[..., Driver], link: NetworkLink, far: Sshd
) -> None:
    server = laptop()
    bridge = server.bridge()
    since = link.cut()
    server.process.kill()
    until(lambda: bridge not in processes_of(far))
    until(lambda: "ros2_mcp_bridge" not in str(processes_of(far)))
    print("gone after", round(time.monotonic() - since, 1), "s", flush=True)
    assert ORPHAN_S - 1 < time.monotonic() - since < ORPHAN_S + 5


def processes_of(far: Sshd) -> set[int]:
    """What runs there of those who logged in."""
    mark = f"HOME={far.home}\0".encode()
    found: set[int] = set()
    for environ in Path("/proc").glob("[0-9]*/environ"):
        try:
            if mark in environ.read_bytes():
                found.add(int(environ.parent.name))
        except OSError:
            continue
    return found
