"""A one-shot publish arrives, or says that nobody was there."""

from __future__ import annotations

import json
import re
import time
from collections.abc import Iterator
from functools import partial
from itertools import count, product
from typing import Any

import pytest

from ros2_mcp_common.wire.limits import MAX_FAILSAFES
from support.agent import FULL, agent_for, until
from support.raw_server import RawServer
from support.standstill import undisturbed

STRING = "std_msgs/msg/String"
TWIST = "geometry_msgs/msg/Twist"
TIMES = 950 if FULL else 30
FRESH = 50 if FULL else 1


@pytest.mark.promise("ros2_topic_publish", "The result says how many subscribers were reached")
def test_every_one_shot_publish_arrives(agent, peer) -> None:
    peer.listen(topic="/arrives", kind=STRING)
    agent.knows("/arrives")
    for number in range(TIMES):
        sent = agent.call("ros2_topic_publish", topic_name="/arrives", data={"data": str(number)})
        assert (sent["status"], sent["subscribers"], sent["acknowledged"]) == ("published", 1, True)
    assert peer.texts(topic="/arrives", expected=TIMES) == [str(number) for number in range(TIMES)]
    peer.forget(topic="/arrives")


def test_the_first_publish_of_a_new_server_arrives(peer, ros_environment) -> None:
    peer.listen(topic="/first", kind=STRING)
    for number in range(FRESH):
        with agent_for(ros_environment) as fresh:
            sent = fresh.call(
                "ros2_topic_publish", topic_name="/first", message_type=STRING, data={"data": str(number)}
            )
        assert (sent["status"], sent["subscribers"], sent["acknowledged"]) == ("published", 1, True), number
    assert peer.texts(topic="/first", expected=FRESH) == [str(number) for number in range(FRESH)]
    peer.forget(topic="/first")


@pytest.mark.promise(
    "ros2_publish_multiple_topics",
    "Publish repeatedly on several topics at the same time, each with its own frequency and duration",
)
def test_a_publish_reaches_each_of_several_topics(agent, peer) -> None:
    topics = [f"/several_{number}" for number in range(3)]
    for topic in topics:
        peer.listen(topic=topic, kind=STRING)
    agent.knows(*topics)
    wanted = [
        {"topic_name": topic, "message_type": STRING, "data": {"data": topic}, "frequency": 20.0, "duration": 0.5}
        for topic in topics
    ]
    sent = agent.call("ros2_publish_multiple_topics", topics=wanted)["topics"]
    assert [(each["status"], each["subscribers"]) for each in sent] == [("published", 1)] * 3
    assert [peer.count(topic=topic, expected=each["sent"]) for topic, each in zip(topics, sent, strict=True)] == [
        each["sent"] for each in sent
    ]
    assert all(9 - missed(each) <= each["sent"] <= 10 for each in sent)


def missed(published: dict[str, Any]) -> int:
    """The periods that are told to have been missed: a machine that stalls is no reason to send bursts."""
    told = re.search(r"Missed (\d+) period", published["note"])
    return int(told[1]) if told else 0


@pytest.mark.promise(
    "README", "A result says what was sent and how many subscribers were matched, never that the robot moved"
)
@pytest.mark.promise("ros2_topic_publish", "The result says how many subscribers were reached")
def test_a_publish_to_nobody_says_so(agent) -> None:
    seconds_of_a_publish_to_nobody(agent)


@pytest.mark.full
def test_a_publish_to_nobody_says_so_within_two_seconds(agent) -> None:
    assert undisturbed(lambda: seconds_of_a_publish_to_nobody(agent)) < 2.0


def seconds_of_a_publish_to_nobody(agent) -> float:
    started = time.monotonic()
    sent = agent.call("ros2_topic_publish", topic_name="/nobody_here", message_type=STRING, data={"data": "x"})
    assert (sent["status"], sent["subscribers"], sent["acknowledged"]) == ("no_subscriber", 0, None)
    assert "No subscriber received it." in sent["note"]
    return time.monotonic() - started


def test_a_publish_tells_this_servers_own_subscribers_apart(agent, peer) -> None:
    peer.listen(topic="/reached", kind=STRING)
    agent.knows("/reached")
    publish = partial(agent.call, "ros2_topic_publish", topic_name="/reached", data={"data": "x"})
    assert "own" not in publish()["note"]
    relay = agent.call("ros2_relay_start", source_topic="/reached", destination_topic="/reached_further")
    sent = until(lambda: (each := publish())["subscribers"] == 2 and each)
    assert "1 of 2 subscribers belong to this server" in sent["note"]
    agent.call("ros2_relay_stop", relay_id=relay["relay_id"])
    peer.forget(topic="/reached")


def test_a_publish_without_a_type_to_an_unknown_topic_is_refused(agent) -> None:
    refusal = agent.refusal("ros2_topic_publish", topic_name="/nobody_knows", data={"data": "x"})
    assert "There is no topic /nobody_knows" in refusal


def test_a_publish_of_the_wrong_type_names_the_right_one(agent, peer) -> None:
    peer.listen(topic="/typed", kind=STRING)
    agent.knows("/typed")
    refusal = agent.refusal(
        "ros2_topic_publish", topic_name="/typed", message_type="std_msgs/Bool", data={"data": True}
    )
    assert "/typed has the type std_msgs/msg/String, not std_msgs/msg/Bool." in refusal
    peer.forget(topic="/typed")


def test_a_best_effort_subscriber_is_reached_without_an_acknowledgement(agent, peer) -> None:
    """Best effort promises nothing: what comes before the subscriber has discovered its publisher is lost, without a
    word; so it is published until the first one comes.
    """
    topic = "/lossy"
    peer.listen(topic=topic, kind=STRING, best_effort=True)
    agent.knows(topic)

    def heard() -> list[str]:
        sent = agent.call("ros2_topic_publish", topic_name=topic, data={"data": "x"})
        assert (sent["status"], sent["subscribers"], sent["acknowledged"]) == ("published", 1, None)
        return peer.texts(topic=topic, expected=1, within_s=1.0)

    assert set(until(heard)) == {"x"}
    peer.forget(topic=topic)


@pytest.mark.full
def test_the_first_message_to_a_best_effort_subscriber_arrives(agent, peer) -> None:
    topics = (f"/lossy_{number}" for number in count())

    def heard() -> list[str]:
        topic = next(topics)
        peer.listen(topic=topic, kind=STRING, best_effort=True)
        agent.knows(topic)
        sent = agent.call("ros2_topic_publish", topic_name=topic, data={"data": "x"})
        assert (sent["status"], sent["subscribers"], sent["acknowledged"]) == ("published", 1, None)
        return peer.texts(topic=topic, expected=1)

    for _ in range(5):
        assert undisturbed(heard) == ["x"]


def test_a_publish_without_a_type_waits_for_a_subscriber_that_is_coming_up(agent, peer) -> None:
    for number in range(10 if FULL else 3):
        topic = f"/coming_up_{number}"
        sent = agent.begin("ros2_topic_publish", topic_name=topic, data={"data": "x"})
        peer.listen(topic=topic, kind=STRING)
        assert sent.result(20)["status"] == "published"
        assert peer.texts(topic=topic, expected=1) == ["x"]
        peer.forget(topic=topic)


def test_an_object_that_comes_as_text_is_published_and_an_empty_one_is_not(agent, peer) -> None:
    peer.listen(topic="/as_text", kind=STRING)
    agent.knows("/as_text")
    assert "object is expected" in agent.refusal("ros2_topic_publish", topic_name="/as_text", data="{}")
    assert agent.call("ros2_topic_publish", topic_name="/as_text", data='{"data": "x"}')["subscribers"] == 1
    assert peer.texts(topic="/as_text", expected=1) == ["x"]
    peer.forget(topic="/as_text")


def test_a_call_on_several_topics_of_which_all_fail_is_an_error(agent, peer) -> None:
    peer.offer(topic="/is_there", kind=STRING, seed=1, latched=True)
    agent.knows("/is_there")
    wrong = [{"topic_name": "/is_there", "data": {"no_such": 1}}, {"topic_name": "/nowhere_at_all", "data": {}}]
    said = agent.refusal("ros2_publish_multiple_topics", topics=wrong)
    assert said.startswith("AllFailed: ") and "no_such" in said and "/nowhere_at_all" in said
    missing = [{"name": "/nowhere_at_all", "duration": 0.1}]
    assert "/nowhere_at_all" in agent.refusal("ros2_subscribe_multiple_topics", topics=missing)
    assert "/nowhere_at_all" in agent.refusal("ros2_topic_stats", topic_names=["/nowhere_at_all"], duration_s=0.1)
    assert agent.call("ros2_topic_stats", topic_names=["/is_there"], duration_s=0.5)["duration"] == 0.5
    one_of_two = agent.call("ros2_subscribe_multiple_topics", topics=[*missing, {"name": "/is_there"}])["topics"]
    assert [bool(read["error"]) for read in one_of_two] == [True, False]


@pytest.fixture(scope="module")
def driver(ros_environment: dict[str, str]) -> Iterator[RawServer]:
    """A server that has set nothing in motion but velocities."""
    server = RawServer(ros_environment)
    server.begin("2025-06-18")
    yield server
    server.end()


@pytest.mark.promise("README", "A velocity that is not a finite number is never sent")
def test_a_velocity_that_is_not_finite_is_refused_and_named(driver: RawServer) -> None:
    """However JSON writes it, once and repeatedly."""
    numbers = ("NaN", "-Infinity", "1e400", '"nan"', '"inf"')
    for asked_as, (number, more) in enumerate(product(numbers, ({}, {"frequency": 10.0, "duration": 0.5})), 1001):
        data = {"linear": {"x": 0.1}, "angular": {"z": "NUMBER"}}
        publish = {"topic_name": "/driven", "message_type": TWIST, "data": data, **more}
        params = {"name": "ros2_topic_publish", "arguments": publish}
        call = {"jsonrpc": "2.0", "id": asked_as, "method": "tools/call", "params": params}
        driver.write(json.dumps(call).replace('"NUMBER"', number).encode() + b"\n")
        text = driver.answer(asked_as)["result"]["content"][0]["text"]
        assert text.startswith("BadValue: angular.z: "), text
    assert driver.call("ros2_stop")["structuredContent"]["topics"] == []


@pytest.mark.promise("README", "At most 64 velocity topics are driven at a time, each with its fail-safe")
@pytest.mark.promise("README", "one more is refused")
def test_one_velocity_topic_more_than_can_be_stopped_is_refused(driver: RawServer) -> None:
    twist = {"message_type": TWIST, "data": {"linear": {"x": 0.1}}}
    more = {"topic_name": "/more", **twist}
    sending = [
        driver.send(
            "tools/call", name="ros2_topic_publish", arguments={"topic_name": f"/robot{number}/cmd_vel", **twist}
        )
        for number in range(MAX_FAILSAFES)
    ]
    sent = [driver.answer(each)["result"]["structuredContent"]["status"] for each in sending]
    assert set(sent) == {"no_subscriber"}
    assert "64 velocity topics already" in driver.call("ros2_topic_publish", **more)["content"][0]["text"]
    stopped = driver.call("ros2_stop")["structuredContent"]
    assert (stopped["confirmed"], len(stopped["topics"])) == (False, MAX_FAILSAFES)  # nothing tells of its motion
    assert driver.call("ros2_topic_publish", **more)["structuredContent"]["status"] == "no_subscriber"
