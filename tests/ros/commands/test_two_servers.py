"""What two nodes serve is told before it is ordered, and ordered only by a word more; a goal outlives its server."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

from support.agent import Agent, until
from support.commanded import CommandedProcess


@pytest.fixture(scope="module")
def twins(ros_environment: dict[str, str], agent: Agent) -> Iterator[CommandedProcess]:
    process = CommandedProcess("twin_peer", ros_environment)
    until(lambda: len(agent.call("ros2_list_actions")["actions"]) == 2)
    until(lambda: any(row["providers"][1:] for row in agent.call("ros2_service_list", pattern="/reset")["services"]))
    yield process
    process.kill()


def test_a_service_of_two_nodes_is_called_only_by_a_word_more(agent: Agent, twins: CommandedProcess) -> None:
    answer = agent.call("ros2_service_call", service_name="/reset")
    assert not answer["called"]
    assert "/driver_a" in answer["note"] and "/driver_b" in answer["note"]
    assert twins.called() == []
    forced = agent.call("ros2_service_call", service_name="/reset", force_call=True)
    assert forced["called"] and "/driver_b" in forced["note"]
    until(lambda: twins.called() or True)


def test_what_only_reads_is_called_and_its_two_servers_are_told(agent: Agent, twins: CommandedProcess) -> None:
    answer = agent.call("ros2_service_call", service_name="/read", fields={"names": []})
    assert answer["called"] and "/driver_a" in answer["note"] and "/driver_b" in answer["note"]


def test_a_service_of_one_node_is_called_as_ever(agent: Agent, twins: CommandedProcess) -> None:
    answer = agent.call("ros2_service_call", service_name="/alone")
    assert (answer["called"], answer["note"]) == (True, "")


def test_a_goal_for_two_servers_is_sent_only_by_a_word_more(agent: Agent, twins: CommandedProcess) -> None:
    goal = {"action_name": "/spin", "goal_fields": {"order": 0}}
    twins.called()
    refused = agent.refusal("ros2_send_action_goal", **goal)
    assert "/driver_a" in refused and "/driver_b" in refused and "force" in refused
    raw = {"goal_id": {"uuid": [7] * 16}, "goal": {"order": 0}}
    assert not agent.call("ros2_service_call", service_name="/spin/_action/send_goal", fields=raw)["called"]
    assert twins.called() == []
    sent = agent.call("ros2_send_action_goal", **goal, force=True)
    assert sent["accepted"] and "/driver_b" in sent["note"]


def test_of_a_goal_whose_server_left_and_came_back_it_is_told_what_is_known(
    agent: Agent, twins: CommandedProcess
) -> None:
    sent = agent.call("ros2_send_action_goal", action_name="/alone", goal_fields={"order": 60})
    asked = {"action_name": "/alone", "goal_id_hex": sent["goal_id"], "timeout_sec": 5}
    twins.leave()
    until(lambda: len(agent.call("ros2_list_actions")["actions"]) == 1)
    gone = agent.call("ros2_action_request_result", **asked)
    assert gone["status"] == "UNKNOWN"
    assert "sent it" in gone["note"] and "accepted" in gone["note"]
    twins.come()
    until(lambda: len(agent.call("ros2_list_actions")["actions"]) == 2)
    # A server drops its answer where it has not discovered the client's reader yet.
    back = until(lambda: (one := agent.call("ros2_action_request_result", **asked))["status"] == "UNKNOWN" and one)
    assert "sent it" in back["note"] and "accepted" in back["note"]
    of_nobody = agent.call("ros2_action_request_result", **{**asked, "goal_id_hex": "ab" * 16})
    assert "sent it" not in of_nobody["note"]
