"""A latched topic replays what it kept, the oldest first: whoever judges by it judges by the newest alone."""

from __future__ import annotations

from typing import Any

from support.agent import Agent, until
from support.commanded import CommandedProcess
from support.standstill import TIMES

OLD = [9.0, 8.0, 7.0, 6.0, 5.0, 4.0, 3.0, 2.0, 1.0, 0.0]
TOPIC = "/kept/level"


def test_what_was_true_long_ago_is_neither_echoed_nor_meets_a_condition(agent: Agent, robot: CommandedProcess) -> None:
    robot.put(base="/kept")
    robot.keep(topic=TOPIC, values=OLD)
    agent.knows(TOPIC, "/kept/cmd_vel", "/kept/odom")
    assert agent.call("ros2_topic_echo_wait", topic_name=TOPIC, timeout=20)["message"] == {"data": 0.0}

    def waited() -> dict[str, Any] | None:
        found = agent.call("ros2_wait_until", topic_name=TOPIC, condition="data > 5", timeout_s=0.6)
        return found if found["messages_checked"] else None

    found = until(waited)
    assert (found["met"], found["messages_checked"], found["values"]) == (False, 1, {"data": 0.0})
    met = agent.call("ros2_wait_until", topic_name=TOPIC, condition="data < 5", timeout_s=20)
    assert met["messages_checked"] == 1
    assert "s old, from before" in met["from_before"]

    def moved(base: str, condition: str) -> dict[str, Any]:
        robot.put(base=base)
        agent.knows(f"{base}/cmd_vel", f"{base}/odom")
        event = {"topic_name": TOPIC, "condition": condition, "is_event": True}
        return agent.call("ros2_move_until", **event, linear_x=0.1, timeout=1.0, command_topic=f"{base}/cmd_vel")

    for number in range(TIMES):  # again where a busy machine silenced the odometry, or was late with the old message
        on = moved(f"/on_{number}", "data > 5")
        if on["outcome"] != "silent" and on["from_before"]:
            break
    assert (on["outcome"], on["met"]) == ("timeout", False), on["note"]
    for number in range(TIMES):
        still = moved(f"/still_{number}", "data < 5")
        if not still["sent"]:
            break
    assert (still["met"], still["values"], still["sent"]) == (True, {"data": 0.0}, 0), still["note"]
    assert still["from_before"].startswith("1 message, ") and still["from_before"].endswith("s old, from before")
    assert on["from_before"].endswith("s old, from before")  # what did not meet it is as old
