"""Without a Data Black Box, this server's own recordings and opened bags answer."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from support.agent import Agent, Refusal, until

TOOL = "ros2_get_messages"


def publish(agent: Agent, *numbers: int) -> None:
    for number in numbers:
        agent.call("ros2_topic_publish", topic_name="/said", message_type="std_msgs/msg/Int32", data={"data": number})


@pytest.mark.promise("ros2_get_messages", "from a WiseVision Data Black Box, recordings or opened bags")
def test_a_recording_answers_while_it_runs_and_a_bag_once_it_is_opened(
    start_agent: Callable[..., Agent], tmp_path: Path
) -> None:
    agent = start_agent()
    agent.call("ros2_log_read")  # waits until the server listens to the log, which is a subscription too
    assert "No messages of /said are stored" in agent.refusal(TOOL, topic_name="/said")
    agent.call("ros2_topic_publish", topic_name="/said", message_type="std_msgs/msg/Int32", data={"data": 0})
    before = agent.call("ros2_status")["subscriptions"]
    begun = agent.call("ros2_record_start", topic_names=["/said"], name="mine")
    until(lambda: agent.call("ros2_status")["subscriptions"] == before + 1)
    publish(agent, 1, 2, 3)
    answer = until(lambda: kept(agent, 3))
    assert answer["source"] == "this server's recording mine"
    assert [each["data"] for each in answer["messages"]] == [1, 2, 3]
    assert [each["data"] for each in agent.call(TOOL, topic_name="said", number_of_messages=2)["messages"]] == [2, 3]
    agent.call("ros2_record_stop", recording_id=begun["recording_id"])

    other = start_agent()
    assert "are stored" in other.refusal(TOOL, topic_name="/said")
    other.call("ros2_bag_info", bag="mine")
    answer = other.call(TOOL, topic_name="/said")
    assert answer["source"] == "the bag mine" and answer["found"] == 3

    recorded = start_agent("--bag", str(tmp_path / "mine"))
    answer = recorded.call(TOOL, topic_name="/said", number_of_messages=1, time_end="last 0 s")
    assert answer["source"] == "the bag mine" and answer["messages"][0]["data"] in (2, 3)


def kept(agent: Agent, count: int) -> Any:
    try:
        answer = agent.call(TOOL, topic_name="/said")
    except Refusal:
        return None
    return answer if answer["found"] >= count else None
