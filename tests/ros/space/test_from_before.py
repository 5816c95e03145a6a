"""What was sent before anybody listened here is told as old, with its age, by the same words in every tool."""

from __future__ import annotations

import json
import subprocess
import time
from collections.abc import Iterator
from typing import Any

import pytest

from support.agent import Agent, until
from support.processes import peer_command, running
from support.viewing import Asked, viewing

OLD = "s old, from before"
TOPICS = (
    "/count",
    "/last_count",
    "/armed",
    "/steady",
    "/turn_read",
    "/turn_judged",
    "/battery",
    "/odom",
    "/goal_pose",
    "/map",
    "/joint_states",
)


@pytest.fixture(scope="module", autouse=True)
def latched(ros_environment: dict[str, str], agent: Agent) -> Iterator[subprocess.Popen[str]]:
    """A robot that was done talking before the server came to know of it, but for `/steady` and the turns."""
    with running(ros_environment, *peer_command("latched_peer")) as process:
        agent.knows(*TOPICS)
        yield process


def told(agent: Agent, tool: str, **arguments: object) -> str:
    return agent.whole(tool, dict(arguments)).content[0].text  # type: ignore[union-attr]


def test_one_message_of_a_topic_that_keeps_ten_is_the_newest(agent: Agent) -> None:
    read = agent.call("ros2_topic_subscribe", topic_name="/count", message_limit=1)
    assert [one["data"] for one in read["messages"]] == [9]
    assert OLD in read["from_before"] and read["source"].endswith(OLD) and "live" not in read["source"]
    said = told(agent, "ros2_topic_subscribe", topic_name="/count", message_limit=1)
    assert "/count: 1 message, " in said and OLD in said and "live" not in said


def test_three_of_ten_are_the_newest_three_and_what_is_left_out_is_counted(agent: Agent) -> None:
    read = agent.call("ros2_topic_subscribe", topic_name="/count", message_limit=3)
    assert [one["data"] for one in read["messages"]] == [7, 8, 9]
    assert "7 older messages published before this call" in read["note"]


def test_what_is_from_before_is_told_apart_from_what_came(agent: Agent) -> None:
    read = agent.call("ros2_topic_subscribe", topic_name="/turn_read", message_limit=15)
    assert [one["data"] for one in read["messages"]] == [True] * 10 + [False] * 5
    assert read["source"].startswith("live") and f"{OLD})" in read["source"]
    assert read["from_before"].startswith("10 messages")


def test_a_condition_is_not_met_by_what_was_true_before(agent: Agent) -> None:
    waited = agent.call("ros2_wait_until", topic_name="/turn_judged", condition="data == true", timeout=4.0)
    assert (waited["met"], waited["from_before"], waited["values"]) == (False, "", {"data": False})
    assert agent.call("ros2_wait_until", topic_name="/turn_judged", condition="data == false", timeout=5.0)["met"]


def test_a_comparison_tells_of_each_topic_what_is_from_before(agent: Agent) -> None:
    found = agent.call("ros2_topic_compare", topic1_name="/count", topic2_name="/last_count", duration=2)
    reasons = " ".join(found["reasons"])
    assert "/count: 10 messages, " in reasons and "/last_count: 1 message, " in reasons and reasons.count(OLD) == 2
    assert found["source"].endswith(OLD) and "live" not in found["source"]


def test_the_next_message_the_map_and_the_scene_say_how_old_they_are(agent: Agent) -> None:
    for tool, arguments in (  # each again where it is matched too late for so short a time
        ("ros2_topic_echo_wait", {"topic_name": "/armed"}),
        ("ros2_get_map_as_image", {"topic_name": "/map"}),
        ("ros2_topic_stats", {"topic_names": ["/armed"], "duration": 0.5}),
        ("ros2_topic_statistics", {"topic_names": ["/count"], "duration": 0.5}),
        ("ros2_plot", {"series": ["/count:data"], "duration": 0.5}),
    ):
        until(lambda tool=tool, arguments=arguments: OLD in told(agent, tool, **arguments))

    def layers() -> dict[str, Any] | None:
        found = {one["kind"]: one for one in agent.call("ros2_scene")["layers"]}
        return found if found.keys() >= {"grid", "goal"} else None

    shown = until(layers)
    assert all(OLD in shown[kind]["from_before"] and shown[kind]["age_s"] > 1.5 for kind in ("grid", "goal"))


def test_the_robot_in_brief_says_of_each_value_that_it_is_old(agent: Agent) -> None:
    def says() -> bool:
        said = told(agent, "ros2_robot", whole=True)
        lines = {
            topic: next((line for line in said.splitlines() if line.lstrip("- ").startswith(f"{topic} ")), "")
            for topic in ("/armed", "/count", "/steady")
        }
        return (
            all(OLD in lines[topic] for topic in ("/armed", "/count"))
            and "9" in lines["/count"]
            and "false" in lines["/steady"]
            and OLD not in lines["/steady"]
            and "(odometry, /odom, " in said.partition("frames")[0]
            and OLD in said.partition("frames")[0]
            and "The battery is at 15% (" in said
        )

    until(says)


def test_a_condition_that_only_an_old_message_meets_says_so(agent: Agent) -> None:
    waited = agent.call("ros2_wait_until", topic_name="/armed", condition="data == true", timeout=5.0)
    assert waited["met"] and OLD in waited["from_before"] and waited["waited"] >= 1.0

    def says() -> bool:  # in that time, if it is matched soon enough
        said = told(agent, "ros2_wait_until", topic_name="/armed", condition="data == true", timeout=0.5)
        return OLD in said and "no newer message came" in said

    until(says)


def test_a_program_and_a_resource_get_the_newest_with_its_age(agent: Agent) -> None:
    program = "import robot\nm = robot.latest('/count')\nprint(m['data'], m['_age_s'] > 1.5, m['_from_before'])"
    assert "9 True True" in told(agent, "ros2_program_run", program=program)
    sample = json.loads(agent.ask("read_resource", "ros2://topic//count").contents[0].text)["sample"]
    assert sample["message"] == {"data": 9} and OLD in sample["from_before"]


def test_each_panel_of_the_page_says_what_is_from_before(ros_environment: dict[str, str], agent: Agent) -> None:
    with viewing(ros_environment) as address:
        page = Asked(address)
        for panel, topic in (("values", "/battery"), ("image", "/still"), ("plot", "/count")):
            told = until(lambda panel=panel, topic=topic: shown(page, panel, topic))
            assert told["from_before"] and time.time() - told["at_s"] > 1.5, panel
        until(lambda: (told := shown(page, "values", "/steady")) and not told["from_before"])
        for panel, which in (("map", ("grid /map", "goal /goal_pose")), ("space", ("/signs",))):
            until(lambda panel=panel, which=which: all(one in old(page, panel) for one in which))
            assert old(page, panel).count(OLD) >= len(which), panel


def shown(page: Asked, panel: str, topic: str) -> dict[str, Any] | None:
    told = page.shown(**{panel: topic}).get(panel, {})
    return told if told.get("topic") == topic and "at_s" in told else None


def old(page: Asked, panel: str) -> str:
    return "; ".join(page.shown(**{panel: ""}).get(panel, {}).get("old", ()))


def test_positions_of_joints_from_before_are_told_as_old(agent: Agent) -> None:
    def says() -> bool:
        said = told(agent, "ros2_robot", whole=True)
        return "lift 0.25" in said and "The joint positions of /joint_states are" in said

    until(says)
