"""Relays pass what they should, in order, count it, and leave nothing behind."""

from __future__ import annotations

import os
import signal
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from support.agent import FULL, Agent, Refusal, agent_for
from support.observer import TWIST, Observer
from support.raw_server import MODERN, RawServer

SECONDS = 60 if FULL else 5
PATIENCE_S = 40.0
SOURCE = "/driving_in"


@pytest.fixture(scope="module")
def driven(observer: Observer) -> Observer:
    """The observer, which lets something drive at 50 Hz."""
    observer.talk(topic=SOURCE, kind=TWIST, hz=50)
    return observer


def wait_for(condition: Callable[[], Any]) -> Any:
    deadline = time.monotonic() + PATIENCE_S
    while not (found := condition()):
        assert time.monotonic() < deadline, "it did not come true in time"
        time.sleep(0.05)
    return found


def begin(agent: Agent, source: str, destination: str, **options: Any) -> dict[str, Any]:
    options = {"duration_sec": 0, **options}
    relay = agent.call("ros2_relay_start", source_topic=source, destination_topic=destination, **options)
    assert relay["state"] == "running", relay
    return relay


def counted(agent: Agent, relay: dict[str, Any]) -> dict[str, Any]:
    relays = agent.call("ros2_relay_list")["relays"]
    return next(each for each in relays if each["relay_id"] == relay["relay_id"])


def end(agent: Agent, relay: dict[str, Any]) -> dict[str, Any]:
    return agent.call("ros2_relay_stop", relay_id=relay["relay_id"])


def publishes(agent: Agent, topic: str, node: str) -> bool:
    """Whether the server knows it."""
    try:
        return node in str(agent.call("ros2_topic_info", topic_name=topic)["publishers"])
    except Refusal:
        return False  # nobody is there yet


def talk(agent: Agent, source: str, talker: Any) -> Any:
    """Let it talk as soon as it and the relay know each other; returns how many messages it sent."""
    wait_for(lambda: publishes(agent, source, talker.node))
    talker.ready().tell()
    return talker.line()


@pytest.mark.promise("ros2_relay_start", "Republish the messages of one topic on another, in the background")
@pytest.mark.full
@pytest.mark.timeout(SECONDS + 60)
@pytest.mark.parametrize("kind", ["String", "Twist"])
def test_every_message_of_200_hz_is_relayed_in_order(agent, peer, kind) -> None:
    expected = 200 * SECONDS
    listener = peer("listen", "/all_out", kind, "RELIABLE")
    agent.knows("/all_out")
    package = {"String": "std_msgs", "Twist": "geometry_msgs"}[kind]
    relay = begin(agent, "/all_in", "/all_out", message_type=f"{package}/msg/{kind}")
    talker = peer("talk", "/all_in", kind, "RELIABLE", "200", str(expected))
    listener.ready()
    assert talk(agent, "/all_in", talker) == expected
    wait_for(lambda: counted(agent, relay)["published"] >= expected)
    numbers = listener.numbers(expected)
    ended = end(agent, relay)
    assert numbers == list(range(expected))
    assert (ended["state"], ended["published"], ended["filtered_out"], ended["lost"]) == ("stopped", expected, 0, 0)
    assert ended["stopped_with_zero"] == (kind == "Twist")


@pytest.mark.full
@pytest.mark.timeout(SECONDS + 60)
@pytest.mark.parametrize("rate_hz", [10, 30, 150])
def test_a_rate_limit_is_kept_within_two_percent(agent, peer, rate_hz) -> None:
    listener = peer("listen", "/slow_out", "String", "BEST_EFFORT")
    talker = peer("talk", "/slow_in", "String", "BEST_EFFORT", "200", str(200 * SECONDS))
    agent.knows("/slow_in", "/slow_out")
    relay = begin(agent, "/slow_in", "/slow_out", transform="rate_limit", target_rate_hz=rate_hz)
    listener.ready()
    assert talk(agent, "/slow_in", talker) == 200 * SECONDS
    ended = end(agent, relay)
    heard = listener.heard()
    rate = (len(heard) - 1) / (heard[-1][0] - heard[0][0])
    assert rate == pytest.approx(rate_hz, rel=0.02)
    assert ended["published"] + ended["filtered_out"] == 200 * SECONDS
    assert [number for _, number in heard] == sorted(number for _, number in heard)


@pytest.mark.promise("ros2_relay_start", "Republish the messages of one topic on another, in the background")
def test_on_change_passes_exactly_the_changes(agent, peer) -> None:
    listener = peer("listen", "/change_out", "JointState", "RELIABLE")
    talker = peer("talk", "/change_in", "JointState", "RELIABLE", "200", "200")
    agent.knows("/change_in", "/change_out")
    relay = begin(agent, "/change_in", "/change_out", transform="on_change", tolerances={"position": 0.5})
    listener.ready()
    assert talk(agent, "/change_in", talker) == 200
    wait_for(lambda: counted(agent, relay)["published"] + counted(agent, relay)["filtered_out"] >= 200)
    ended = end(agent, relay)
    assert listener.numbers(20) == list(range(0, 200, 10))
    assert (ended["published"], ended["filtered_out"], ended["lost"]) == (20, 180, 0)


def test_fields_are_mapped_to_another_type(agent, peer) -> None:
    listener = peer("listen", "/mapped_out", "Float64", "RELIABLE")
    talker = peer("talk", "/mapped_in", "Twist", "RELIABLE", "200", "100")
    agent.knows("/mapped_in", "/mapped_out")
    relay = begin(agent, "/mapped_in", "/mapped_out", mapping={"data": "linear.x"})
    listener.ready()
    assert talk(agent, "/mapped_in", talker) == 100
    wait_for(lambda: counted(agent, relay)["published"] == 100)
    assert listener.numbers(100) == list(range(100))
    end(agent, relay)


def test_a_relay_goes_on_when_its_source_dies_and_comes_back(agent, peer) -> None:
    listener = peer("listen", "/again_out", "String", "RELIABLE")
    first = peer("talk", "/again_in", "String", "RELIABLE", "100", "50")
    second = peer("talk_later", "/again_in", "String", "RELIABLE", "100", "70")
    agent.knows("/again_in", "/again_out")
    relay = begin(agent, "/again_in", "/again_out")
    listener.ready()
    assert talk(agent, "/again_in", first) == 50
    wait_for(lambda: counted(agent, relay)["published"] == 50)
    first.process.kill()
    second.tell()
    assert talk(agent, "/again_in", second) == 70
    wait_for(lambda: counted(agent, relay)["published"] == 120)
    assert listener.numbers(120) == [*range(50), *range(70)]
    assert end(agent, relay)["state"] == "stopped"


@pytest.mark.promise("ros2_relay_start", "The relay ends after its duration")
@pytest.mark.full
def test_a_relay_ends_with_its_duration(agent, peer) -> None:
    talker = peer("talk", "/timed_in", "Twist", "RELIABLE", "100", "1000")
    listener = peer("listen", "/timed_out", "Twist", "RELIABLE")
    agent.knows("/timed_in", "/timed_out")
    relay = begin(agent, "/timed_in", "/timed_out", duration_sec=1.0)
    listener.ready()
    talker.ready().tell()
    ended = wait_for(lambda: (found := counted(agent, relay))["state"] == "ended" and found)
    assert ended["elapsed_sec"] == pytest.approx(1.0, abs=0.1)
    assert ended["stopped_with_zero"]
    numbers = wait_for(listener.heard)
    assert numbers[-1][1] == 0.0
    assert len(numbers) == ended["published"] + 2


def test_relays_never_feed_themselves(agent) -> None:
    refused = agent.refusal("ros2_relay_start", source_topic="/ring_a", destination_topic="ring_a")
    assert "would feed itself" in refused
    one = begin(agent, "/ring_a", "/ring_b", message_type="std_msgs/msg/String")
    two = begin(agent, "/ring_b", "/ring_c", message_type="std_msgs/msg/String")
    refused = agent.refusal(
        "ros2_relay_start", source_topic="/ring_c", destination_topic="/ring_a", message_type="std_msgs/msg/String"
    )
    assert "relays already lead from /ring_a to /ring_b to /ring_c" in refused
    end(agent, one)
    three = begin(agent, "/ring_c", "/ring_a", message_type="std_msgs/msg/String")
    for relay in (two, three):
        assert end(agent, relay)["state"] == "stopped"


def test_a_stopped_relay_leaves_no_entity_behind(agent) -> None:
    agent.call("ros2_log_read")  # waits until the server listens to the log, which is a subscription too
    before = agent.call("ros2_status")
    for options in ({}, {"transform": "on_change"}):
        relay = begin(agent, "/tidy_in", "/tidy_out", message_type="std_msgs/msg/String", **options)
        end(agent, relay)
    wait_for(lambda: "/tidy_out" not in str(agent.call("ros2_topic_list", pattern="/tidy_")))
    after = agent.call("ros2_status")
    assert [after[name] - before[name] for name in ("subscriptions", "publishers")] == [0, 0]


@pytest.mark.promise("README", "repeats, relays and playbacks ended")
@pytest.mark.promise("ros2_relay_start", "with ros2_relay_stop or ros2_stop")
@pytest.mark.promise("ros2_relay_start", "velocity topics then get a zero command")
def test_stop_ends_relays_and_leaves_the_robot_at_zero(agent, driven: Observer) -> None:
    driven.join(by="out", topic="/driving_out", kind=TWIST)
    agent.knows(SOURCE, "/driving_out")
    relays = [
        begin(agent, SOURCE, "/driving_out"),
        begin(agent, SOURCE, "/driving_out_2", transform="on_change"),
    ]
    driven.until_driven("/driving_out", 10)
    assert agent.call("ros2_stop")["relays_stopped"] == 2
    for relay in relays:
        wait_for(lambda relay=relay: counted(agent, relay)["state"] == "stopped")
    assert driven.comes_to_rest("/driving_out", PATIENCE_S) == []
    zero = driven.last(topic="/driving_out")["out"]["at"]
    agent.call("ros2_topic_subscribe", topic_name=SOURCE, message_limit=10)  # its source goes on
    assert not any(any(one["values"]) for one in driven.messages(topic="/driving_out", after=zero))


@pytest.mark.promise("ros2_relay_start", "and with this server")
def test_a_server_that_ends_takes_its_relays_with_it(agent, ros_environment, driven: Observer) -> None:
    driven.join(by="out", topic="/leaving_out", kind=TWIST)
    agent.knows("/leaving_out")
    with agent_for(ros_environment, "--tools", "all") as other:
        other.knows(SOURCE, "/leaving_out")
        begin(other, SOURCE, "/leaving_out")
        driven.until_driven("/leaving_out", 10)
    wait_for(lambda: not agent.call("ros2_topic_info", topic_name="/leaving_out")["publishers"])
    assert driven.comes_to_rest("/leaving_out", PATIENCE_S) == []


def test_a_lost_bridge_ends_its_relays_and_says_so(start_agent) -> None:
    own = start_agent("--tools", "all")
    relays = [
        begin(own, "/lost_in", f"/lost_{transform}", message_type="std_msgs/msg/String", transform=transform)
        for transform in ("identity", "on_change")
    ]
    os.kill(own.call("ros2_status")["bridge_pid"], signal.SIGKILL)
    for relay in relays:
        failed = wait_for(lambda relay=relay: (found := counted(own, relay))["state"] == "failed" and found)
        assert "SIGKILL" in failed["note"]
    again = begin(own, "/lost_in", "/lost_identity", message_type="std_msgs/msg/String")
    assert end(own, again)["state"] == "stopped"


def test_a_source_that_comes_back_with_a_weaker_qos_is_matched_again(agent, peer) -> None:
    """By relays in the bridge and in the server."""
    transforms, source = ("identity", "on_change"), "/weaker_in"
    listeners = [peer("listen", f"/weaker_out_{transform}", "String", "RELIABLE") for transform in transforms]
    first = peer("talk", source, "String", "RELIABLE", "100", "50", "2")
    agent.knows(source, *(f"/weaker_out_{transform}" for transform in transforms))
    relays = [begin(agent, source, f"/weaker_out_{transform}", transform=transform) for transform in transforms]
    second = peer("talk_later", source, "String", "BEST_EFFORT", "100", "70", "2")

    def passed(expected: int) -> bool:
        return all(counted(agent, relay)["published"] == expected for relay in relays)

    for listener in listeners:
        listener.ready()
    assert talk(agent, source, first) == 50
    wait_for(lambda: passed(50))
    first.process.terminate()
    first.process.wait(PATIENCE_S)
    second.tell()
    assert talk(agent, source, second) == 70
    wait_for(lambda: passed(120))
    for listener, relay in zip(listeners, relays, strict=True):
        assert listener.numbers(120) == [*range(50), *range(70)]
        end(agent, relay)


@pytest.mark.promise("README", "everything that was driven when the server dies, is stopped or sleeps (within 1.1 s)")
@pytest.mark.promise("stopping", "the server is killed: the same: 1 s")
def test_a_server_that_is_killed_leaves_no_process_and_a_robot_at_zero(
    agent, ros_environment, driven: Observer
) -> None:
    driven.join(by="out", topic="/killed_out", kind=TWIST)
    agent.knows("/killed_out")
    server = RawServer(ros_environment, "--tools", "all")
    server.begin(MODERN)
    bridge_pid = server.call("ros2_status")["structuredContent"]["bridge_pid"]
    options = {"message_type": TWIST, "duration_sec": 0}
    server.call("ros2_relay_start", source_topic=SOURCE, destination_topic="/killed_out", **options)
    driven.until_driven("/killed_out")
    server.process.kill()
    server.end()
    wait_for(lambda: not Path(f"/proc/{bridge_pid}").exists())
    assert driven.comes_to_rest("/killed_out", PATIENCE_S) == []
    wait_for(lambda: not agent.call("ros2_topic_info", topic_name="/killed_out")["publishers"])
