"""Values go to and come from an independent ROS node exactly: every type, both ways, bit for bit."""

from __future__ import annotations

import base64
from collections.abc import Iterator
from itertools import count
from typing import Any

import pytest

from support import ros_values
from support.agent import CALL_S, FULL, Agent, agent_for, until

RESULT_BYTES = 40_000
"""So that most messages of all types are read at once."""
SEEDS = range(10) if FULL else range(1)
MEGABYTE = {
    "std_msgs/msg/UInt8MultiArray": ("data", 2**20),
    "std_msgs/msg/Float64MultiArray": ("data", 2**17),
    "std_msgs/msg/Float32MultiArray": ("data", 2**18),
    "std_msgs/msg/Int64MultiArray": ("data", 2**17),
}
AT_A_TIME = 4
"""Reads of a megabyte: each waits 1.3 s for a newer message, and 66 of them in turn took 90 s."""
_NUMBERS = count()


@pytest.fixture(scope="module")
def agent(ros_environment: dict[str, str]) -> Iterator[Agent]:
    with agent_for(ros_environment, "--tools", "all", "--result-bytes", str(RESULT_BYTES)) as client:
        yield client


def sample() -> list[str]:
    """Every type of test_msgs and, unless all are wanted, some of each other package."""
    every = ros_values.installed_types()
    return every if FULL else [name for at, name in enumerate(every) if name.startswith("test_msgs") or at % 8 == 0]


def new_topic() -> str:
    return f"/round_trip_{next(_NUMBERS)}"


def read_whole(agent, topic: str) -> dict[str, Any]:
    """The message of the topic: at once, or field by field where it is too long for that."""
    reading = agent.call("ros2_topic_subscribe", topic_name=topic, max_array=10_000, message_limit=1)
    assert reading["count"] == 1, reading["note"]
    message = reading["messages"][0]
    if not reading["truncated"]:
        return message
    return {field: read_field(agent, topic, field) for field in message}


def read_field(agent, topic: str, field: str) -> Any:
    reading = agent.call("ros2_topic_subscribe", topic_name=topic, max_array=10_000, message_limit=1, fields=[field])
    assert reading["truncated"] == []
    return reading["messages"][0][field]


@pytest.mark.promise("README", "nothing is cut or wrapped to fit")
@pytest.mark.promise("README", "Types and QoS are found by themselves")
@pytest.mark.parametrize("kind", sample())
def test_what_we_publish_arrives_with_exactly_those_values(agent, peer, kind: str) -> None:
    topic = new_topic()
    peer.listen(topic=topic, kind=kind)
    agent.knows(topic)
    for seed in SEEDS:
        data = ros_values.as_agent(ros_values.filled(kind, seed))
        sent = agent.call("ros2_topic_publish", topic_name=topic, message_type=kind, data=data)
        assert (sent["status"], sent["subscribers"], sent["acknowledged"]) == ("published", 1, True)
        assert peer.compare(topic=topic, kind=kind, seed=seed) == [], seed
    peer.forget(topic=topic)


@pytest.mark.parametrize("kind", sample())
def test_what_we_read_can_be_published_back_as_the_same_bytes(agent, peer, kind: str) -> None:
    for seed in SEEDS:
        there, back = new_topic(), new_topic()
        peer.offer(topic=there, kind=kind, seed=seed, latched=True)
        peer.listen(topic=back, kind=kind)
        agent.knows(there, back)
        sent = agent.call("ros2_topic_publish", topic_name=back, message_type=kind, data=read_whole(agent, there))
        assert sent["status"] == "published"
        assert peer.compare(topic=back, kind=kind, seed=seed) == [], seed
        peer.forget(topic=there)
        peer.forget(topic=back)


@pytest.mark.parametrize("kind", MEGABYTE)
def test_a_megabyte_is_published_exactly(agent, peer, kind: str) -> None:
    topic, (field, length) = new_topic(), MEGABYTE[kind]
    peer.listen(topic=topic, kind=kind)
    agent.knows(topic)
    data = ros_values.as_agent(ros_values.with_ramp(kind, field, length))
    # For an acknowledgement 2 s are waited: a megabyte, parts of which a busy machine loses, may take longer.
    until(lambda: agent.call("ros2_topic_publish", topic_name=topic, data=data)["acknowledged"], CALL_S)
    assert peer.compare_ramp(topic=topic, kind=kind, field=field, length=length) == []
    peer.forget(topic=topic)


@pytest.mark.promise("ros2_topic_subscribe", "use fields to see a part in full")
@pytest.mark.parametrize("kind", MEGABYTE if FULL else list(MEGABYTE)[:1])
@pytest.mark.timeout(1800 if FULL else 300)
def test_a_megabyte_is_read_exactly_in_pieces(agent, peer, kind: str) -> None:
    topic, (field, length) = new_topic(), MEGABYTE[kind]
    peer.offer_ramp(topic=topic, kind=kind, field=field, length=length, latched=True)
    agent.knows(topic)
    piece = 16_000 if "UInt8" in kind else 2_000
    paths = [f"{field}[{start}:{start + piece}]" for start in range(0, length, piece)]
    whole: list[Any] = []
    for first in range(0, len(paths), AT_A_TIME):
        some = paths[first : first + AT_A_TIME]
        reads = [agent.begin("ros2_topic_subscribe", topic_name=topic, message_limit=1, fields=[path]) for path in some]
        for path, reading in zip(some, [read.result(CALL_S) for read in reads], strict=True):
            assert reading["truncated"] == []
            whole.extend(elements(reading["messages"][0][path]))
    peer.forget(topic=topic)
    again = ros_values.message_class(kind)(data=whole)
    assert ros_values.difference(ros_values.with_ramp(kind, field, length), again) == ""


def elements(value: Any) -> list[Any]:
    """A list, or the bytes of a base64 text."""
    return list(base64.b64decode(value)) if isinstance(value, str) else value


def test_a_megabyte_read_as_a_whole_is_a_summary_that_cannot_be_published(agent, peer) -> None:
    topic, kind = new_topic(), "std_msgs/msg/Float64MultiArray"
    peer.offer_ramp(topic=topic, kind=kind, field="data", length=2**17, latched=True)
    agent.knows(topic)
    whole = agent.whole("ros2_topic_subscribe", {"topic_name": topic, "max_array": 10_000, "message_limit": 1})
    assert len(whole.content[0].text) < RESULT_BYTES
    message = whole.structured_content["messages"][0]
    assert message["data"]["length"] == 2**17
    assert whole.structured_content["truncated"] == ["data"]
    refusal = agent.refusal("ros2_topic_publish", topic_name="/back", message_type=kind, data=message)
    assert "data: this is a summary of a value that was too long to show" in refusal
    peer.forget(topic=topic)
