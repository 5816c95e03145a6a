"""What the robot says is on the disk, byte for byte, also if the server is killed; and it can be played again."""

from __future__ import annotations

import importlib
import os
import signal
import subprocess
from collections import defaultdict
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from mcap.reader import make_reader
from rosbags.rosbag2 import Reader
from test_msgs.message_fixtures import get_test_msg

from ros2_mcp.bags.bag import Bag
from support.agent import FULL, Agent, until

StartAgent = Callable[..., Agent]
StartPeer = Callable[..., "subprocess.Popen[str]"]
COMMON = "actionlib diagnostic geometry nav sensor shape std stereo trajectory visualization".split()  # noqa: SIM905
COMMANDS = {"/t/geometry_msgs/Twist", "/t/geometry_msgs/TwistStamped"}
PACKAGES = ("test_msgs", *(f"{name}_msgs" for name in (COMMON if FULL else ("nav", "shape"))))


def bodies(path: Path) -> dict[str, list[bytes]]:
    found: dict[str, list[bytes]] = defaultdict(list)
    with Bag(path) as bag:
        for topic, sample in bag.messages():
            found[topic].append(sample.data)
        assert bag.problems == []
    return found


def of(agent: Agent, bag: str) -> str:
    """The id of the recording that writes this bag."""
    return next(each["recording_id"] for each in agent.call("ros2_record_status")["recordings"] if each["bag"] == bag)


def written(agent: Agent, recording: str) -> int:
    return agent.call("ros2_record_status", recording_id=of(agent, recording))["recordings"][0]["messages"]


def topic_of(agent: Agent, recording: str, topic: str) -> dict[str, Any]:
    state = agent.call("ros2_record_status", recording_id=of(agent, recording))["recordings"][0]
    return next((each for each in state["topics"] if each["topic_name"] == topic), {"written": 0, "error": ""})


def types_of(package: str) -> list[str]:
    module = importlib.import_module(f"{package}.msg")
    return [f"{package}/{name}" for name in dir(module) if name[0].isupper()]


def published(type_name: str) -> int:
    """How many messages of a type `memory_peer.py` publishes."""
    package, _, name = type_name.partition("/")
    return 3 + (len(get_test_msg(name)) if package == "test_msgs" else 0)


@pytest.mark.promise("README", "ros2_record_start records (MCAP in the folder that ros2 bag writes)")
@pytest.mark.promise("ros2_record_start", "Start recording topics to disk (MCAP in a rosbag2 folder)")
@pytest.mark.promise("ros2_record_stop", "End a recording and close its files")
@pytest.mark.promise("ros2_record_status", "messages, bytes and losses of each topic")
@pytest.mark.promise("ros2_bag_play", "Publish a bag's messages again")
@pytest.mark.timeout(300)
def test_record_read_play_and_record_again_give_the_same_bytes(
    start_agent: StartAgent, start_peer: StartPeer, tmp_path: Path
) -> None:
    types = [name for package in PACKAGES for name in types_of(package)]
    start_peer("types", *PACKAGES)
    agent = start_agent()
    agent.call("ros2_record_start", patterns=["/t/*"], name="first")
    until(lambda: written(agent, "first") >= sum(map(published, types)), 60.0)
    stopped = agent.call("ros2_record_stop", recording_id=of(agent, "first"))
    assert stopped["state"] == "ended" and not any(topic["dropped"] for topic in stopped["topics"])
    assert {topic["topic_name"]: topic["written"] for topic in stopped["topics"]} == {
        f"/t/{name}": published(name) for name in types
    }
    once, count = bodies(tmp_path / "first"), stopped["messages"]
    check_that_independent_readers_agree(tmp_path / "first", count)
    for name in types:
        read = agent.call("ros2_bag_read", bag="first", topic_name=f"/t/{name}", message_limit=1, max_array=0)
        assert read["topic_type"] == name.replace("/", "/msg/") and read["count"] == 1, name

    before = agent.call("ros2_status")["subscriptions"]
    agent.call("ros2_record_start", patterns=["/u/*"], name="second")
    until(lambda: agent.call("ros2_status")["subscriptions"] == before + len(types))
    remaps = {topic: topic.replace("/t/", "/u/") for topic in once}
    refusal = agent.refusal("ros2_bag_play", bag="first", remaps=remaps)
    assert "live publisher" in refusal and "force" in refusal
    played = agent.call("ros2_bag_play", bag="first", remaps=remaps, force=True)
    assert played["state"] == "ended" and sum(played["published"].values()) == count
    until(lambda: written(agent, "second") >= count)
    agent.call("ros2_record_stop", recording_id=of(agent, "second"))
    again = bodies(tmp_path / "second")
    for topic in COMMANDS & set(once):  # whoever plays commands ends with those that stop the robot
        sent = again[remaps[topic]]
        default = once[topic][0]
        assert sent[len(once[topic]) :] == [default, default]
        del sent[len(once[topic]) :]
    assert again == {remaps[topic]: data for topic, data in once.items()}
    print(f"{len(types)} types, {count} messages")


def check_that_independent_readers_agree(folder: Path, count: int) -> None:
    """Two other libraries read the same topics, times and bytes, in the same order."""
    with Bag(folder) as bag:
        ours = [(topic, sample.received_ns, sample.data) for topic, sample in bag.messages()]
    assert len(ours) == count
    with Reader(folder) as reader:
        assert reader.message_count == count
        theirs = [(connection.topic, at_ns, bytes(data)) for connection, at_ns, data in reader.messages()]
    assert sorted(theirs) == sorted(ours) and [at for _, at, _ in theirs] == [at for _, at, _ in ours]
    with next(folder.glob("*.mcap")).open("rb") as file:
        reader = make_reader(file, validate_crcs=True)
        summary = reader.get_summary()
        assert summary and summary.statistics and summary.statistics.message_count == count
        found = [(channel.topic, message.log_time, message.data) for _, channel, message in reader.iter_messages()]
    assert sorted(found) == sorted(ours) and [at for _, at, _ in found] == [at for _, at, _ in ours]


def server_of(agent: Agent) -> int:
    """The process of this agent's own server: the parent of its bridge. Other tests keep servers of theirs."""
    bridge = agent.call("ros2_status")["bridge_pid"]
    return int(Path(f"/proc/{bridge}/stat").read_text().rpartition(")")[2].split()[1])


def test_a_recording_goes_on_with_the_next_bridge(
    start_agent: StartAgent, start_peer: StartPeer, tmp_path: Path
) -> None:
    start_peer("stream", "/some:50:100")
    agent = start_agent()
    agent.call("ros2_record_start", topic_names=["/some"], name="run")
    until(lambda: written(agent, "run") > 20)
    server = server_of(agent)
    bridges = Path(f"/proc/{server}/task/{server}/children").read_text().split()
    for pid in bridges:
        os.kill(int(pid), signal.SIGKILL)
    before = written(agent, "run")
    until(lambda: written(agent, "run") > before + 20)
    state = agent.call("ros2_record_stop", recording_id=of(agent, "run"))
    assert state["notes"]
    with Bag(tmp_path / "run") as bag:
        assert bag.problems == []


@pytest.mark.promise("ros2_record_stop", "End a recording and close its files")
def test_a_server_that_is_told_to_end_closes_its_recording(
    start_agent: StartAgent, start_peer: StartPeer, tmp_path: Path
) -> None:
    start_peer("stream", "/some:50:100")
    agent = start_agent()
    agent.call("ros2_record_start", name="run")
    until(lambda: topic_of(agent, "run", "/some")["written"] > 20)
    os.kill(server_of(agent), signal.SIGTERM)
    until((tmp_path / "run" / "metadata.yaml").exists)
    with Bag(tmp_path / "run") as bag:
        assert bag.problems == []
        assert bag.counts()["/some"] > 20


@pytest.mark.promise("ros2_record_start", "The recording runs until a limit or ros2_record_stop")
@pytest.mark.promise("ros2_record_start", "topics that appear later join")
@pytest.mark.promise("ros2_record_status", "why a recording ended")
def test_a_topic_that_appears_later_joins_and_limits_end_the_recording(
    start_agent: StartAgent, start_peer: StartPeer, tmp_path: Path
) -> None:
    agent = start_agent()
    assert agent.call("ros2_record_start", patterns=["/late*"], max_bytes=2_000_000, name="../x")["messages"] == 0
    start_peer("stream", "/late_one:100:20000")
    state = until(lambda: (s := agent.call("ros2_record_status")["recordings"][0])["state"] != "recording" and s)
    assert state["state"] == "ended" and "2000000 bytes" in state["reason"]
    assert state["path"] == str(tmp_path / "x")
    assert sum(path.stat().st_size for path in (tmp_path / "x").iterdir()) < 2_100_000
    assert "no bag" in agent.refusal("ros2_bag_info", bag="y")
    assert "outside the folder of bags" in agent.refusal("ros2_bag_info", bag="../../../etc")


def test_a_second_type_that_joins_a_topic_is_told(start_agent: StartAgent, start_peer: StartPeer) -> None:
    agent = start_agent()
    start_peer("stream", "/live:100:10")
    agent.call("ros2_record_start", topic_names=["/live"], name="run")
    until(lambda: written(agent, "run") > 10)
    start_peer("listen", "/other")  # it publishes on /live, too
    assert until(lambda: topic_of(agent, "run", "/live")["other_types"]) == ["std_msgs/msg/Int32"]
    told = agent.whole("ros2_record_stop", {}).content[0].text
    assert "/live: only std_msgs/msg/UInt8MultiArray is recorded, not std_msgs/msg/Int32." in told


@pytest.mark.promise("README", "--black-box keeps the last hours without being asked")
def test_the_black_box_keeps_small_topics_without_being_asked(
    start_agent: StartAgent, start_peer: StartPeer, tmp_path: Path
) -> None:
    start_peer("stream", "/small:50:100", "/large:20:40000")
    agent = start_agent("--black-box")
    until(lambda: agent.call("ros2_record_status")["recordings"][:1])
    until(lambda: written(agent, "black-box") > 50)
    until(lambda: "40016 bytes" in (large := topic_of(agent, "black-box", "/large"))["error"] and not large["written"])
    asked = {"bag": "black-box", "topic_name": "/small", "start": "last 0.5 s", "limit": 100}
    until(lambda: 10 <= agent.call("ros2_bag_read", **asked)["count"] <= 30)  # where the stream does not catch up
