"""The robot's log is kept from the start of the server on, and read by time, node, level and text."""

from __future__ import annotations

import os
import signal
import threading
import time
from collections.abc import Callable
from typing import Any

import pytest

from support.agent import Refusal

PATIENCE_S = 40.0


def wait_for(condition: Callable[[], bool]) -> None:
    deadline = time.monotonic() + PATIENCE_S
    while not holds(condition):
        assert time.monotonic() < deadline, "it did not come true in time"
        time.sleep(0.1)


def holds(condition: Callable[[], bool]) -> bool:
    """False also while there is no bridge."""
    try:
        return condition()
    except Refusal:
        return False


def texts(agent: Any, expected: int, **wanted: Any) -> list[str]:
    """The texts of the lines, as soon as there are so many."""
    deadline = time.monotonic() + PATIENCE_S
    while len(lines := agent.call("ros2_log_read", **wanted)["lines"]) < expected and time.monotonic() < deadline:
        time.sleep(0.1)
    return [line["text"] for line in lines]


@pytest.mark.promise("ros2_log_read", "Read what the robot's nodes logged on /rosout")
def test_lines_are_found_by_node_level_text_and_time(agent, peer) -> None:
    agent.call("ros2_log_read")  # waits until the server listens: nodes keep what they said for ten seconds only
    node = peer("complain", "20").node
    assert texts(agent, 21, node=node)[-2:] == ["number 19", "the arm is stuck"]
    assert texts(agent, 1, node=node, level="error") == ["the arm is stuck"]
    assert texts(agent, 1, node=node, pattern="ARM") == ["the arm is stuck"]
    assert texts(agent, 2, node="relay_peer_complain_*", pattern="number 1?", limit=2) == ["number 18", "number 19"]
    found = agent.call("ros2_log_read", node_name=node, level="warning", limit=5)
    assert (found["matched"], found["lines"][0]["level"]) == (21, "WARN")
    assert [line["text"] for line in found["lines"]][-1] == "the arm is stuck" and len(found["lines"]) == 5
    assert "raise limit" in found["note"]
    assert agent.call("ros2_log_read", node_name=node, since=found["lines"][-1]["time"])["matched"] == 1
    first = agent.call("ros2_log_read", node_name=node)["lines"][0]
    assert texts(agent, 1, node=node, end=first["time"]) == [first["text"]]
    wait_for(lambda: agent.call("ros2_log_read", node_name=node, since=1)["matched"] == 0)  # of the last second


@pytest.mark.promise("ros2_log_read", "and those of a few seconds before")
def test_what_was_said_just_before_the_server_began_is_there(start_agent: Callable[..., Any], peer) -> None:
    """It is said until then: nodes keep their lines for ten seconds, and a server may take longer to begin."""
    speaker, has_begun = peer("complain", "3").ready(), threading.Event()

    def go_on() -> None:
        while not has_begun.wait(0.3):
            speaker.tell("still stuck")

    speaking = threading.Thread(target=go_on)
    speaking.start()
    try:
        own = start_agent()
        own.call("ros2_log_read")
    finally:
        has_begun.set()
        speaking.join()

    def is_there() -> bool:
        log = own.call("ros2_log_read", node_name=speaker.node)
        return any(line["time"] < log["subscribed_since"] for line in log["lines"])

    wait_for(is_there)


def test_the_log_survives_a_lost_bridge_without_lines_twice(start_agent: Callable[..., Any], peer) -> None:
    own = start_agent()
    own.call("ros2_log_read")  # waits until the server listens: nodes keep what they said for ten seconds only
    speaker = peer("complain", "3")
    assert len(texts(own, 4, node=speaker.node)) == 4
    os.kill(own.call("ros2_status")["bridge_pid"], signal.SIGKILL)
    wait_for(lambda: own.call("ros2_status")["bridge_starts"] == 2)
    speaker.tell("after all")
    assert texts(own, 5, node=speaker.node)[-2:] == ["the arm is stuck", "after all"]
    found = own.call("ros2_log_read", node_name=speaker.node)
    assert (found["matched"], "was lost 1 time:" in found["note"]) == (5, True)


def test_a_level_that_is_not_there_is_refused(agent) -> None:
    assert "Did you mean error?" in agent.refusal("ros2_log_read", level="eror")
    assert "Give seconds ago" in agent.refusal("ros2_log_read", since="yesterday")
