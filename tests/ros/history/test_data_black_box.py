"""Both generations of the Data Black Box answer over real services, and none of their traps reaches the user."""

from __future__ import annotations

import time
from datetime import datetime, timezone
from itertools import pairwise
from typing import Any

import pytest

from support.agent import Agent

of_the_first_generation = pytest.mark.parametrize("agent", [1], indirect=True, ids=["generation 1"], scope="module")

TOOL = "ros2_get_messages"
OLD_NAME = "ros2_get_messages_stored_in_influx_data_base"
TYPES = {
    "String": "std_msgs/msg/String",
    "Bool": "std_msgs/msg/Bool",
    "Float64": "std_msgs/msg/Float64",
    "UInt8MultiArray": "std_msgs/msg/UInt8MultiArray",
    "Twist": "geometry_msgs/msg/Twist",
    "PoseStamped": "geometry_msgs/msg/PoseStamped",
    "Odometry": "nav_msgs/msg/Odometry",
    "Imu": "sensor_msgs/msg/Imu",
    "BatteryState": "sensor_msgs/msg/BatteryState",
    "JointState": "sensor_msgs/msg/JointState",
}
VALUES = {
    "String": lambda m: m["data"] == "grüße 7",
    "Bool": lambda m: m["data"] is True,
    "Float64": lambda m: m["data"] == 7 / 3,
    "UInt8MultiArray": lambda m: m["data"] == list(range(7)),
    "Twist": lambda m: m["linear"]["x"] == 1.0,
    "PoseStamped": lambda m: m["header"] == {"stamp": {"sec": 7, "nanosec": 0}, "frame_id": "map"},
    "Odometry": lambda m: m["header"]["stamp"]["sec"] == 7 and m["pose"]["covariance"] == {"$diagonal": [0.0] * 6},
    "Imu": lambda m: m["header"]["stamp"]["sec"] == 7,
    "BatteryState": lambda m: m["voltage"] == 17.0 and m["cell_voltage"] == ["nan"] * 3,
    "JointState": lambda m: m["position"] == [0.5, 7.0] and m["name"] == ["a", "b"],
}


def seconds(answer: dict[str, Any]) -> list[float]:
    return [datetime.fromisoformat(each.replace("Z", "+00:00")).timestamp() for each in answer["timestamps"]]


def numbers(answer: dict[str, Any]) -> list[int]:
    """Which of the ten messages of `/kept/Float64` they are."""
    return [round(message["data"] * 3) for message in answer["messages"]]


def ask(agent: Agent, **arguments: Any) -> dict[str, Any]:
    return agent.call(TOOL, **{"topic_name": "/kept/Float64", "message_type": "std_msgs/msg/Float64", **arguments})


@pytest.mark.promise("ros2_get_messages", "Get messages published earlier")
@pytest.mark.parametrize("kind", TYPES)
def test_messages_of_every_type_come_back_with_values_and_times(agent: Agent, kind: str) -> None:
    answer = agent.call(TOOL, topic_name=f"/kept/{kind}", message_type=TYPES[kind])
    assert answer["count"] == answer["found"] == len(answer["messages"]) == 10
    assert VALUES[kind](answer["messages"][7]) and not VALUES[kind](answer["messages"][6])
    assert answer["timestamps"][7] == "2026-01-01T00:00:07.250000Z"
    assert f"generation {agent.generation}" in answer["source"]
    assert answer["topic_type"] == TYPES[kind]


def test_the_old_name_of_the_tool_and_of_its_argument_are_answered_but_not_listed(agent: Agent) -> None:
    answer = agent.call(OLD_NAME, topic_name="kept/Float64", message_type="std_msgs/Float64", number_of_msg=2)
    assert numbers(answer) == [8, 9]
    assert TOOL in agent.tools() and OLD_NAME not in agent.tools()


def test_a_number_means_the_last_ones(agent: Agent) -> None:
    assert numbers(ask(agent, number_of_messages=3)) == [7, 8, 9]
    assert numbers(ask(agent, number_of_messages=3, time_end="2026-01-01T00:00:05Z")) == [2, 3, 4]


def test_a_range_may_have_one_end_only(agent: Agent) -> None:
    assert numbers(ask(agent, time_start="2026-01-01T00:00:06Z")) == [6, 7, 8, 9]
    assert numbers(ask(agent, time_end="2026-01-01T00:00:02Z")) == [0, 1]


def test_times_without_a_zone_are_utc_and_unix_times_are_taken_and_both_are_told(agent: Agent) -> None:
    answer = ask(agent, time_start="2026-01-01T00:00:06", time_end=1_767_225_608)
    assert numbers(answer) == [6, 7]
    assert "time_start: 2026-01-01T00:00:06 has no time zone and was read as UTC." in answer["note"]
    assert "time_end: 1767225608 is 2026-01-01T00:00:08.000000Z." in answer["note"]
    assert numbers(ask(agent, time_start="1767225608.5", time_end=None, number_of_messages=0)) == [9]


def test_fractions_of_seconds_and_offsets_are_exact(agent: Agent) -> None:
    inside = ask(agent, time_start="2026-01-01T01:00:03.25+01:00", time_end="2025-12-31T19:00:04.249999999-05:00")
    assert numbers(inside) == [3]
    after = ask(agent, time_start="2026-01-01T00:00:03.250000001Z", time_end="2026-01-01T00:00:04.25Z")
    assert numbers(after) == [4]


def test_relative_times_count_from_now(agent: Agent) -> None:
    asked_at = time.time()
    answer = agent.call(TOOL, topic_name="/kept/recent", message_type="std_msgs/msg/Float64", time_start="last 10 min")
    assert answer["count"] == 10 and seconds(answer) == sorted(seconds(answer))
    assert seconds(answer)[0] >= asked_at - 600
    assert ask(agent, time_start="last 10 min")["count"] == 0


def test_nothing_in_that_time_is_said(agent: Agent) -> None:
    answer = ask(agent, time_start="2020-01-01T00:00:00Z", time_end="2020-01-02T00:00:00Z")
    assert answer["messages"] == [] and "No message in that time" in answer["note"]
    answer = ask(agent, topic_name="/kept/nothing")
    assert answer["found"] == 0 and "no message of this topic" in answer["note"]


def test_more_than_fits_is_evenly_thinned_and_counted(agent: Agent) -> None:
    answer = agent.call(
        TOOL, topic_name="/kept/many", message_type="sensor_msgs/msg/LaserScan", fields=["ranges[0:100]"]
    )
    assert answer["found"] == 5000 and 5 < answer["count"] < 500 and "omitted evenly, to fit" in answer["note"]
    at = seconds(answer)
    gaps = [round(later - earlier) for earlier, later in pairwise(at)]
    assert max(gaps) - min(gaps) <= 1 and at[-1] - at[0] == 4999
    few = agent.call(
        TOOL, topic_name="/kept/many", message_type="sensor_msgs/msg/LaserScan", fields=["ranges[0]"], every_n=100
    )
    assert few["count"] == 50 and few["messages"][-1] == {"ranges[0]": 4999.0}


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ({"time_start": "soon"}, "time_start: 'soon' is not a time"),
        ({"time_start": "yesterday"}, "is not a time"),
        ({"time_start": "first 30 s"}, "the beginning, which is not known"),
        ({"time_start": "2026-01-02T00:00:00Z", "time_end": "2026-01-01T00:00:00Z"}, "is before"),
        ({"fields": ["speed"]}, "speed"),
        ({"number_of_messages": -1}, "number_of_messages"),
    ],
)
def test_wrong_arguments_are_refused(agent: Agent, arguments: dict[str, Any], words: str) -> None:
    refusal = agent.refusal(
        TOOL, **{"topic_name": "/kept/Float64", "message_type": "std_msgs/msg/Float64", **arguments}
    )
    assert words in refusal


def test_the_type_is_known_by_the_second_generation_and_asked_for_by_the_first(agent: Agent) -> None:
    if agent.generation == 2:
        answer = agent.call(TOOL, topic_name="/kept/Twist", message_type="std_msgs/msg/Float64")
        assert answer["topic_type"] == TYPES["Twist"] and "not std_msgs/msg/Float64" in answer["note"]
        assert agent.call(TOOL, topic_name="/kept/Twist")["topic_type"] == TYPES["Twist"]
    else:
        assert "Give message_type" in agent.refusal(TOOL, topic_name="/kept/Twist")
        wrong = agent.refusal(TOOL, topic_name="/kept/Float64", message_type="sensor_msgs/msg/LaserScan")
        assert "none of type sensor_msgs/msg/LaserScan" in wrong
        unsure = agent.call(TOOL, topic_name="/kept/Twist", message_type="geometry_msgs/msg/Twist")["note"]
        assert "stores no types" in unsure


def test_the_error_of_a_box_is_told_in_its_own_words(agent: Agent) -> None:
    if agent.generation == 2:
        assert "'nowhere' not found" in agent.refusal(TOOL, topic_name="/kept/Twist", bucket_name="nowhere")
        assert agent.call(TOOL, topic_name="/kept/Twist", bucket_name="fleet")["count"] == 10
    else:
        refusal = agent.refusal(TOOL, topic_name="/kept/broken", message_type="std_msgs/msg/Bool")
        assert "Couldn't connect to server" in refusal


@of_the_first_generation
def test_special_types_of_the_first_generation_come_as_messages(agent: Agent) -> None:
    def messages(kind: str) -> Any:
        return agent.call(TOOL, topic_name="/kept/special", message_type=kind)["messages"]

    assert messages("std_msgs/msg/Int32") == [{"data": -(2**31)}, {"data": 0}, {"data": 7}]
    (micro,) = messages("lora_msgs/msg/MicroPublisher")
    assert micro == {"sensors_generic_data": [{"name": "t", "value": 1.5}], "voltage": 3.5, "percentage": 80}
    (gps,) = messages("lora_msgs/msg/GpsDeviceData")
    assert gps["device_eui"] == {"data": list(range(8))} and gps["nav_value"]["latitude"] == 52.25


@of_the_first_generation
def test_an_answer_that_breaks_off_gives_what_is_whole(agent: Agent) -> None:
    answer = agent.call(TOOL, topic_name="/kept/torn", message_type="std_msgs/msg/Int32")
    assert answer["messages"] == [{"data": 5}] and "truncated in message 2" in answer["note"]
    assert datetime.fromisoformat(answer["timestamps"][0].replace("Z", "+00:00")).tzinfo == timezone.utc


def test_the_box_is_asked_like_a_bag_by_its_name(agent: Agent) -> None:
    said = {"bag": "data black box", "start": "2026-01-01T00:00:02Z", "end": "2026-01-01T00:00:05Z"}
    if agent.generation == 1:
        refusal = agent.refusal("ros2_topic_subscribe", topic_name="/kept/Float64", message_limit=10, **said)
        assert "does not say their type" in refusal
        said["msg_type"] = "std_msgs/msg/Float64"
    read = agent.call("ros2_topic_subscribe", topic_name="/kept/Float64", message_limit=10, **said)
    assert numbers(read) == [2, 3, 4] and f"generation {agent.generation}" in read["source"]


@pytest.mark.promise("ros2_get_messages", "names the source")
def test_what_the_box_does_not_have_comes_from_the_own_recording(agent: Agent) -> None:
    said = {"topic_name": "/aside", "message_type": "std_msgs/msg/Int32"}
    recording_id = agent.call("ros2_record_start", topic_names=["/aside"], name="aside")["recording_id"]
    publishing = agent.begin("ros2_topic_publish", data={"data": 1}, frequency=20.0, duration=60.0, **said)
    while agent.call("ros2_record_status", recording_id=recording_id)["recordings"][0]["messages"] <= 5:
        assert not publishing.done()
        time.sleep(0.1)
    publishing.cancel()
    agent.call("ros2_record_stop", recording_id=recording_id)
    answer = agent.call(TOOL, **said)
    assert answer["source"] == "this server's recording aside" and answer["found"] > 5


def test_a_box_whose_interfaces_are_missing_is_told_with_the_package(agent: Agent, stranger: Agent) -> None:
    package = "lora_msgs" if agent.generation == 1 else "wisevision_msgs"
    assert f"package {package} is not there" in stranger.refusal(TOOL, topic_name="/kept/Bool")
