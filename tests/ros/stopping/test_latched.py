"""A stop that latches, over the real server: it holds over a restart and for a second server, until it is reset."""

from __future__ import annotations

from contextlib import closing

import pytest

from ros2_mcp.guard.servers import servers_in
from ros2_mcp.guard.state import StateFolder
from support.agent import FULL, Refusal, until
from support.driver import Driver, fresh
from support.observer import Observer
from support.velocities import TWIST

SLOW = {"linear": {"x": 0.1}}
"""m/s: the profile allows 0.2."""


def refusal(server: Driver, topic: str) -> str:
    """Why one command is refused."""
    with pytest.raises(Refusal) as refused:
        server.do("ros2_topic_publish", topic_name=topic, message_type=TWIST, data=SLOW)
    return str(refused.value)


def test_it_holds_over_a_restart_and_for_a_second_server_of_which_one_acts(
    start_server, observer: Observer, ros_environment: dict[str, str]
) -> None:
    topic = f"{fresh('latched')}/cmd_vel"
    observer.watch(topic)
    under_policy = ("--tools", "all", "--policy", "teleop-slow")
    first = start_server(*under_policy)
    first.knows(topic, 4)
    first.do("ros2_topic_publish", topic_name=topic, message_type=TWIST, data=SLOW)
    observer.until_driven(topic)
    told, answered_ns = first.stop()
    assert told["latched"] and told["observed"] == "not observed"
    assert observer.comes_to_rest(topic, 1.0 if FULL else 30.0) == []
    second = start_server(*under_policy)
    second.knows(topic, 4)
    first.process.kill()
    restarted = start_server(*under_policy)
    restarted.knows(topic, 4)
    for server in (second, restarted):
        assert "the latch of this robot is set" in refusal(server, topic)
        assert server.do("ros2_status")["latched"]
    assert observer.moved(sent_after=answered_ns, topic=topic) == []
    latch = StateFolder.of(domain_id=int(ros_environment["ROS_DOMAIN_ID"]), env=ros_environment).latch()
    latch.reset(by="operator", seen=latch.look().count)
    for server in (second, restarted):
        until(lambda server=server: not server.do("ros2_status")["latched"])
    assert observer.moved(sent_after=answered_ns, topic=topic) == []
    second.do("ros2_topic_publish", topic_name=topic, message_type=TWIST, data=SLOW)
    assert f"Another server acts on this robot, too: process {second.process.pid}" in refusal(restarted, topic)


def test_a_stop_by_a_person_is_in_doubt_where_nothing_reports_whether_the_robot_stands(
    start_server, ros_environment: dict[str, str]
) -> None:
    start_server().do("ros2_status")
    folder = StateFolder.of(domain_id=int(ros_environment["ROS_DOMAIN_ID"]), env=ros_environment)
    (server,) = servers_in(folder.path)
    with closing(server):
        answer = server.do("stop")
    folder.latch().reset(by="operator", seen=folder.latch().look().count)
    assert (answer["is_doubted"], answer["is_observed_still"]) == (True, False), answer["done"]
