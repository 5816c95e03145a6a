"""What the tools' descriptions promise, where no other test asks for it: a server, and nodes that appear as they go."""

from __future__ import annotations

import subprocess
import sys
import time

import pytest

from support.agent import until
from support.commanded import CommandedProcess
from support.standstill import undisturbed

STRING = "std_msgs/msg/String"
SPOKEN = ("/promise_a", "/promise_b")


@pytest.fixture(scope="module")
def latched(agent, peer) -> tuple[str, str]:
    """Two topics with one message each, of which one would come to nobody who asks for other QoS than is offered."""
    for topic in SPOKEN:
        peer.offer(topic=topic, kind=STRING, seed=1, latched=True)
    agent.knows(*SPOKEN)
    return SPOKEN


@pytest.mark.promise("ros2_status", "which ROS 2 this server uses (distribution, middleware, domain), its health")
@pytest.mark.promise("README", "ros2_status tells the domain")
def test_the_status_tells_the_ros_and_its_domain(agent, ros_environment) -> None:
    status = agent.call("ros2_status")
    assert str(status["domain_id"]) == ros_environment["ROS_DOMAIN_ID"]
    assert status["distro"] == "jazzy" and status["rmw"].startswith("rmw_")
    assert status["bridge_node"]


@pytest.mark.promise("README", "--domain-id N sets it")
def test_the_domain_is_that_of_the_option(start_agent, domain_id: int) -> None:
    assert start_agent("--domain-id", str(domain_id + 1)).call("ros2_status")["domain_id"] == domain_id + 1


@pytest.mark.promise("ros2_node_list", "List the nodes of the robot by full name, and names that several nodes share")
def test_nodes_are_listed_and_names_that_two_of_them_share(agent, peer, ros_environment) -> None:
    until(lambda: "/server_peer" in agent.call("ros2_node_list")["nodes"])
    second = CommandedProcess("server_peer", ros_environment)
    try:
        found = until(lambda: (seen := agent.call("ros2_node_list"))["duplicates"] and seen)
        for node in (peer, second):
            node.offer(topic="/of_both", kind=STRING, seed=1, latched=True)
        agent.knows("/of_both")
        mixed = "2 publishers (/server_peer, /server_peer): their messages are mixed."
        until(lambda: mixed in agent.call("ros2_topic_subscribe", topic_name="/of_both")["note"])
    finally:
        second.end_or_kill()
    assert found["duplicates"] == ["/server_peer"]


@pytest.mark.promise("ros2_topic_subscribe", "With neither, the first message")
@pytest.mark.promise("ros2_topic_subscribe", "Read messages of a topic: for a duration, or until a number of messages")
@pytest.mark.promise("README", "Types and QoS are found by themselves")
def test_a_read_without_bounds_ends_with_the_first_message_and_one_of_a_duration_with_its_end(agent, latched) -> None:
    assert agent.call("ros2_topic_subscribe", topic_name=latched[0])["count"] == 1
    assert agent.call("ros2_topic_subscribe", topic_name=latched[0], duration=20, message_limit=1)["duration"] < 10
    assert agent.call("ros2_topic_subscribe", topic_name=latched[0], duration=0.5)["duration"] >= 0.5


@pytest.mark.promise("ros2_subscribe_multiple_topics", "each with its own duration or message limit")
@pytest.mark.promise("ros2_subscribe_multiple_topics", "truly at the same time")
def test_topics_are_read_at_the_same_time_each_for_its_own(agent, peer, latched) -> None:
    """Neither of the two that are silent speaks before both have their reader. What is lost comes again within 3 s."""
    silent = ("/promise_c", "/promise_d")
    for topic in silent:
        peer.offer(topic=topic, kind=STRING, seed=1)
    agent.knows(*silent)
    wanted = [{"name": topic, "message_limit": 1, "duration": 50.0} for topic in silent]
    reading = agent.begin("ros2_subscribe_multiple_topics", topics=[*wanted, {"name": latched[0], "duration": 4.0}])
    assert [peer.readers(topic=topic, expected=1) for topic in silent] == [1, 1]
    assert not reading.done()
    for topic in silent:
        peer.offer(topic=topic, kind=STRING, seed=1)
    read = reading.result(40)["topics"]
    assert [topic["count"] for topic in read] == [1, 1, 1]
    assert read[2]["duration"] >= 4.0


@pytest.mark.full
def test_two_topics_that_are_read_for_a_second_take_no_two(agent, latched) -> None:
    def seconds() -> float:
        began = time.monotonic()
        wanted = [{"name": topic, "duration": 1.0} for topic in latched] + [{"name": latched[0], "message_limit": 1}]
        read = agent.call("ros2_subscribe_multiple_topics", topics=wanted)["topics"]
        assert [topic["count"] for topic in read] == [1, 1, 1]
        assert read[2]["duration"] < 1.0 <= min(topic["duration"] for topic in read[:2])
        return time.monotonic() - began

    assert undisturbed(seconds) < 1.9


@pytest.mark.promise("ros2_topic_echo_wait", "Wait for the next message of a topic")
@pytest.mark.promise("ros2_topic_echo_wait", "the topic may appear while waiting")
def test_a_message_of_a_topic_that_appears_later_is_waited_for(agent, peer) -> None:
    waiting = agent.begin("ros2_topic_echo_wait", topic_name="/promise_later", timeout=30)
    assert "/promise_later" not in str(agent.call("ros2_topic_list"))
    assert not waiting.done()
    peer.offer(topic="/promise_later", kind=STRING, seed=1, latched=True)
    assert waiting.result(40)["received"]


@pytest.mark.promise("ros2_relay_start", "Returns a relay_id at once")
@pytest.mark.promise("ros2_relay_list", "List this server's relays with the messages published and filtered out")
@pytest.mark.promise("ros2_relay_list", "and the relays that ended last")
@pytest.mark.promise("ros2_relay_stop", "Stop a relay")
def test_a_relay_begins_at_once_and_is_listed_while_it_runs_and_afterwards(agent, latched) -> None:
    begun = agent.call("ros2_relay_start", source_topic=latched[0], destination_topic="/promise_relayed")

    def listed() -> dict:
        relays = agent.call("ros2_relay_list")["relays"]
        return next(relay for relay in relays if relay["relay_id"] == begun["relay_id"])

    until(lambda: listed()["published"])
    assert (listed()["state"], listed()["filtered_out"]) == ("running", 0)
    agent.call("ros2_relay_stop", relay_id=begun["relay_id"])
    assert listed()["state"] == "stopped"


@pytest.mark.promise("ros2_bag_list", "List the bags (recordings) that can be read, the newest first")
@pytest.mark.promise("ros2_bag_info", "Show the topics, types, counts and times of a bag")
def test_bags_are_listed_the_newest_first_and_shown_with_their_topics(start_agent, agent, latched, tmp_path) -> None:
    own = start_agent("--tools", "all", "--record-dir", str(tmp_path))
    own.knows(*latched)
    for name in ("older", "newer"):
        begun = own.call("ros2_record_start", topic_names=[latched[0]], name=name)
        until(lambda: own.call("ros2_record_status")["recordings"][0]["messages"] == 1)
        own.call("ros2_record_stop", recording_id=begun["recording_id"])
    assert [bag["bag"] for bag in own.call("ros2_bag_list")["bags"]] == ["newer", "older"]
    info = own.call("ros2_bag_info", bag="older")
    assert [(topic["topic_name"], topic["topic_type"], topic["messages"]) for topic in info["topics"]] == [
        (latched[0], STRING, 1)
    ]
    assert info["start"] and info["end"]


@pytest.mark.promise("README", "--log-level debug shows more, on stderr")
def test_at_the_level_debug_more_is_said_on_stderr(ros_environment) -> None:
    said = []
    for options in ([], ["--log-level", "debug"]):
        command = [sys.executable, "-m", "ros2_mcp", *options, "call", "ros2_status", "--json"]
        ended = subprocess.run(command, env=ros_environment, capture_output=True, text=True, check=True, timeout=60)
        said.append(len(ended.stderr.splitlines()))
    assert said[1] > said[0]
