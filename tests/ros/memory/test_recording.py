"""What the robot says is on the disk, byte for byte, also if the server is killed; and it can be played again."""

from __future__ import annotations

import os
import signal
import subprocess
import time
from collections import defaultdict
from collections.abc import Callable
from pathlib import Path
from typing import Any

from agent import Agent
from rosbags.rosbag2 import Reader

from ros2_mcp.bags.bag import Bag

StartAgent = Callable[..., Agent]
StartPeer = Callable[..., "subprocess.Popen[str]"]


def until(check: Callable[[], Any], seconds: float = 10.0) -> Any:
    deadline = time.monotonic() + seconds
    while not (found := check()):
        assert time.monotonic() < deadline, "it never came true"
        time.sleep(0.1)
    return found


def bodies(path: Path) -> dict[str, list[bytes]]:
    found: dict[str, list[bytes]] = defaultdict(list)
    with Bag(path) as bag:
        for topic, sample in bag.messages():
            found[topic].append(sample.data)
        assert bag.problems == []
    return found


def written(agent: Agent, recording: str) -> int:
    return agent.call("ros2_record_status", recording_id=recording)["recordings"][0]["messages"]


def test_record_read_play_and_record_again_give_the_same_bytes(
    start_agent: StartAgent, start_peer: StartPeer, tmp_path: Path
) -> None:
    start_peer("types")
    agent = start_agent()
    first = agent.call("ros2_record_start", patterns=["/t/*"], name="first")
    assert len(first["topics"]) == 13
    count = until(lambda: (n := written(agent, "first")) > 30 and n == written(agent, "first") and n)
    stopped = agent.call("ros2_record_stop", recording_id="first")
    assert stopped["state"] == "ended" and not any(topic["dropped"] for topic in stopped["topics"])
    once = bodies(tmp_path / "first")

    agent.call("ros2_record_start", patterns=["/u/*"], name="second")
    remaps = {topic: topic.replace("/t/", "/u/") for topic in once}
    refusal = agent.refusal("ros2_bag_play", bag="first", remaps=remaps)
    assert "live publisher" in refusal and "force" in refusal
    played = agent.call("ros2_bag_play", bag="first", remaps=remaps, force=True)
    assert played["state"] == "ended" and sum(played["published"].values()) == count
    until(lambda: written(agent, "second") >= count)
    agent.call("ros2_record_stop", recording_id="second")
    assert bodies(tmp_path / "second") == {remaps[topic]: data for topic, data in once.items()}

    with Reader(tmp_path / "first") as reader:
        assert {each.topic: each.msgcount for each in reader.connections} == {t: len(d) for t, d in once.items()}
    info = agent.call("ros2_bag_info", bag="first")
    assert info["messages"] == count and info["problems"] == []
    read = agent.call("ros2_bag_read", bag="first", topic_name="/t/Arrays", limit=1)
    assert read["topic_type"] == "test_msgs/msg/Arrays" and read["messages"][0]["alignment_check"] is not None


def server_of(agent: Agent) -> int:
    """The process of this agent's own server: the parent of its bridge. Other tests keep servers of theirs."""
    bridge = agent.call("ros2_status")["bridge_pid"]
    return int(Path(f"/proc/{bridge}/stat").read_text().rpartition(")")[2].split()[1])


def test_a_recording_goes_on_with_the_next_bridge(
    start_agent: StartAgent, start_peer: StartPeer, tmp_path: Path
) -> None:
    start_peer("stream", "/some:50:100")
    agent = start_agent()
    agent.call("ros2_record_start", topics=["/some"], name="run")
    until(lambda: written(agent, "run") > 20)
    server = server_of(agent)
    bridges = Path(f"/proc/{server}/task/{server}/children").read_text().split()
    for pid in bridges:
        os.kill(int(pid), signal.SIGKILL)
    before = written(agent, "run")
    until(lambda: written(agent, "run") > before + 20, 20.0)
    state = agent.call("ros2_record_stop", recording_id="run")
    assert state["notes"]
    with Bag(tmp_path / "run") as bag:
        assert bag.problems == []


def test_a_server_that_is_told_to_end_closes_its_recording(
    start_agent: StartAgent, start_peer: StartPeer, tmp_path: Path
) -> None:
    start_peer("stream", "/some:50:100")
    agent = start_agent()
    agent.call("ros2_record_start", name="run")
    until(lambda: written(agent, "run") > 20)
    os.kill(server_of(agent), signal.SIGTERM)
    until((tmp_path / "run" / "metadata.yaml").exists)
    with Bag(tmp_path / "run") as bag:
        assert bag.problems == []
        assert bag.counts()["/some"] > 20


def test_a_topic_that_appears_later_joins_and_limits_end_the_recording(
    start_agent: StartAgent, start_peer: StartPeer, tmp_path: Path
) -> None:
    agent = start_agent()
    assert agent.call("ros2_record_start", patterns=["/late*"], max_bytes=2_000_000, name="../x")["messages"] == 0
    start_peer("stream", "/late_one:20:20000")
    state = until(lambda: (s := agent.call("ros2_record_status")["recordings"][0])["state"] != "recording" and s)
    assert state["state"] == "ended" and "2000000 bytes" in state["reason"]
    assert state["path"] == str(tmp_path / "x")
    assert sum(path.stat().st_size for path in (tmp_path / "x").iterdir()) < 2_100_000
    assert "no bag" in agent.refusal("ros2_bag_info", bag="y")
    assert "not below" in agent.refusal("ros2_bag_info", bag="../../../etc")


def test_the_black_box_keeps_small_topics_without_being_asked(
    start_agent: StartAgent, start_peer: StartPeer, tmp_path: Path
) -> None:
    start_peer("stream", "/small:50:100")
    agent = start_agent("--black-box")
    until(lambda: agent.call("ros2_record_status")["recordings"][:1])
    until(lambda: written(agent, "black-box") > 50)
    read = agent.call("ros2_bag_read", bag="black-box", topic_name="/small", start="last 0.5 s", limit=100)
    assert 10 <= read["count"] <= 30
