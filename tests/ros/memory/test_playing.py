"""A bag is played: an independent node hears what was recorded, in its rhythm, and nothing else."""

from __future__ import annotations

import json
import subprocess
import time
from collections.abc import Iterator
from itertools import pairwise
from typing import Any

import pytest

from ros2_mcp.bags.stored import StoredTopic
from ros2_mcp.bags.writer import BagWriter
from ros2_mcp.model.samples import Sample
from support.agent import Agent, Refusal, agent_for
from support.processes import peer_command, running
from support.standstill import undisturbed

START_NS = 1_700_000_000_000_000_000
NUMBERS = {"/a": range(10), "/b": range(100, 105)}
PERIODS_NS = {"/a": 100_000_000, "/b": 200_000_000}
LASTS_S = 0.9
"""From the first message to the last."""
HEARD = ("/a", "/b", "/c", "/live")
PATIENCE_S = 30.0


class Listener:
    """The independent node, and what it has heard since the last time."""

    def __init__(self, process: subprocess.Popen[str]) -> None:
        self._process = process

    def heard(self, command: str = "forget") -> dict[str, list[tuple[int, float]]]:
        assert self._process.stdin and self._process.stdout
        self._process.stdin.write(f"{command}\n")
        self._process.stdin.flush()
        return json.loads(self._process.stdout.readline())

    def heard_so_many(self, counts: dict[str, int]) -> dict[str, list[tuple[int, float]]]:
        """What it has heard, as soon as there is so much of each topic; then all is forgotten."""
        deadline = time.monotonic() + PATIENCE_S
        while time.monotonic() < deadline:
            heard = self.heard("look")
            if all(len(heard[topic]) >= count for topic, count in counts.items()):
                break
            time.sleep(0.02)
        return self.heard()

    def numbers(self, topic: str, count: int) -> list[int]:
        """The numbers on one topic, as soon as there are so many; then all is forgotten."""
        return [number for number, _ in self.heard_so_many({topic: count})[topic]]


@pytest.fixture(scope="module")
def agent(ros_environment: dict[str, str], tmp_path_factory: pytest.TempPathFactory) -> Iterator[Agent]:
    folder = tmp_path_factory.mktemp("bags")
    (folder / "run").mkdir()
    writer = BagWriter(folder / "run", "run")
    for topic in NUMBERS:
        writer.add_topic(StoredTopic(topic, "std_msgs/msg/Int32", None, "ros2msg", "int32 data\n"))
    stored = [(START_NS + i * PERIODS_NS[topic], topic, n) for topic in NUMBERS for i, n in enumerate(NUMBERS[topic])]
    for at_ns, topic, number in sorted(stored):
        writer.write(topic, Sample(at_ns, at_ns, None, b"\0\1\0\0" + number.to_bytes(4, "little")))
    writer.close()
    (folder / "moves").mkdir()
    writer = BagWriter(folder / "moves", "moves")
    writer.add_topic(StoredTopic("/cmd_vel", "geometry_msgs/msg/Twist", None, "ros2msg", ""))
    writer.write("/cmd_vel", Sample(START_NS, START_NS, None, b"\0\1\0\0" + bytes(48)))
    writer.close()
    (folder / "mixed").mkdir()
    writer = BagWriter(folder / "mixed", "mixed")
    kinds = {"/a": "std_msgs/msg/Int32", "/größe der tür": "std_msgs/msg/Int32", "/maker": "strange_msgs/msg/Thing"}
    for topic, kind in kinds.items():
        writer.add_topic(StoredTopic(topic, kind, None, "ros2msg", "int32 data\n"))
    for number in range(3):
        at_ns = START_NS + number * 10**8
        for topic in kinds:
            writer.write(topic, Sample(at_ns, at_ns, None, b"\0\1\0\0" + number.to_bytes(4, "little")))
    writer.close()
    with agent_for(ros_environment, "--tools", "all", "--record-dir", str(folder)) as started:
        yield started


@pytest.fixture(scope="module")
def listening(ros_environment: dict[str, str], agent: Agent) -> Iterator[Listener]:
    with running(ros_environment, *peer_command("memory_peer", "listen", *HEARD), sigterm=False) as process:
        agent.knows(*HEARD, "/cmd_vel")
        while "/memory_peer" not in str(agent.call("ros2_topic_info", topic_name="/cmd_vel")):
            pass
        yield Listener(process)


@pytest.fixture
def listener(listening: Listener) -> Listener:
    listening.heard()
    return listening


@pytest.mark.promise("ros2_bag_play", "Publish a bag's messages again with their timing")
@pytest.mark.parametrize("rate", [1.0, 4.0])
def test_a_bag_is_heard_whole_and_takes_its_time(agent: Agent, listener: Listener, rate: float) -> None:
    _, elapsed_s = played_whole(agent, listener, rate)
    assert elapsed_s > LASTS_S / rate - 0.02


@pytest.mark.full
@pytest.mark.parametrize("rate", [1.0, 4.0])
def test_a_bag_is_heard_in_its_rhythm(agent: Agent, listener: Listener, rate: float) -> None:
    heard, _ = undisturbed(lambda: played_whole(agent, listener, rate))
    for topic, numbers in NUMBERS.items():
        times = [at for _, at in heard[topic]]
        expected_s = (len(numbers) - 1) * PERIODS_NS[topic] / 1e9 / rate
        assert times[-1] - times[0] == pytest.approx(expected_s, abs=0.12)
        assert sorted(b - a for a, b in pairwise(times))[len(times) // 2] == pytest.approx(
            PERIODS_NS[topic] / 1e9 / rate, abs=0.04
        )


def played_whole(agent: Agent, listener: Listener, rate: float) -> tuple[dict[str, list[tuple[int, float]]], float]:
    """What is heard of a bag that is played, which is what is in it, and how long that took, as is told."""
    counts = {topic: len(numbers) for topic, numbers in NUMBERS.items()}
    played = agent.call("ros2_bag_play", bag="run", rate=rate)
    assert (played["state"], played["progress"], played["loops"]) == ("ended", 1.0, 1)
    assert played["published"] == counts and not played["note"]
    heard = listener.heard_so_many(counts)
    for topic, numbers in NUMBERS.items():
        assert [number for number, _ in heard[topic]] == list(numbers)
    assert not heard["/c"] and not heard["/live"]
    return heard, played["elapsed_s"]


def test_only_the_chosen_topics_of_the_chosen_time_are_played_under_other_names(
    agent: Agent, listener: Listener
) -> None:
    played = agent.call(
        "ros2_bag_play", bag="run", topic_names=["/a"], start="first 0.3 s", end="first 0.6 s", remaps={"/a": "/c"}
    )
    assert played["published"] == {"/c": 3} and played["elapsed_s"] < 10  # and not the days until that time
    heard = listener.heard_so_many({"/c": 3})
    assert [number for number, _ in heard["/c"]] == [3, 4, 5]
    assert not heard["/a"] and not heard["/b"]


@pytest.mark.promise("ros2_bag_play_status", "Show the progress of bag playbacks")
@pytest.mark.promise("ros2_bag_play_stop", "Stop playing a bag")
def test_a_loop_goes_on_until_it_is_stopped(agent: Agent, listener: Listener) -> None:
    begun = agent.call("ros2_bag_play", bag="run", topic_names=["/a"], rate=5, loop=True, wait_s=0)
    assert begun["state"] == "playing"
    numbers = listener.numbers("/a", 25)
    assert numbers == [index % 10 for index in range(len(numbers))]
    running = agent.call("ros2_bag_play_status", playback_id=begun["playback_id"])["playbacks"][0]
    assert running["state"] == "playing" and running["loops"] >= 2 and 0 <= running["progress"] <= 1
    refusal = agent.refusal("ros2_bag_play", bag="run", topic_names=["/a"])
    assert f"/a ({begun['playback_id']})" in refusal  # two rhythms on one topic make no sense
    stopped = agent.call("ros2_bag_play_stop", playback_id=begun["playback_id"])
    assert stopped["state"] == "stopped"
    rest = listener.heard_so_many({"/a": stopped["published"]["/a"] - len(numbers)})["/a"]
    agent.call("ros2_bag_play", bag="run", topic_names=["/b"], rate=5)
    heard = listener.heard_so_many({"/b": 5})  # several turns of the loop later
    assert len(numbers) + len(rest) == stopped["published"]["/a"] and not heard["/a"]
    assert agent.call("ros2_bag_play_stop", playback_id=begun["playback_id"])["state"] == "stopped"


def test_a_live_publisher_is_not_disturbed_unless_it_is_forced(agent: Agent, listener: Listener) -> None:
    onto: dict[str, Any] = {"bag": "run", "topics": ["/a"], "rate": 10, "remaps": {"/a": "/live"}}
    refusal = agent.refusal("ros2_bag_play", **onto)
    assert "/live (/memory_peer)" in refusal and "force" in refusal
    assert agent.call("ros2_bag_play", **onto, force=True)["state"] == "ended"
    assert listener.numbers("/live", 10) == list(NUMBERS["/a"])


def test_a_relay_of_this_server_is_not_disturbed_either(agent: Agent, listener: Listener) -> None:
    relay = agent.call("ros2_relay_start", source_topic="/live", destination_topic="/c")["relay_id"]
    refusal = agent.refusal("ros2_bag_play", bag="run", topic_names=["/a"], remaps={"/a": "/c"})
    assert f"/c ({relay})" in refusal
    agent.call("ros2_relay_stop", relay_id=relay)
    played = agent.call("ros2_bag_play", bag="run", topic_names=["/a"], remaps={"/a": "/c"}, rate=10)
    assert played["published"] == {"/c": 10} and listener.numbers("/c", 10) == list(NUMBERS["/a"])


def test_what_cannot_be_played_is_said_before_anything_is(agent: Agent, listener: Listener) -> None:
    assert "no topic /nowhere" in agent.refusal("ros2_bag_play", bag="run", topic_names=["/a", "/nowhere"])
    assert "not played" in agent.refusal("ros2_bag_play", bag="run", topic_names=["/a"], remaps={"/b": "/c"})
    refusal = agent.refusal("ros2_bag_play", bag="run", topic_names=["/a"], remaps={"/a": "/rosout"}, force=True)
    assert "rcl_interfaces/msg/Log" in refusal
    assert not any(listener.heard().values())


def test_what_is_of_a_type_that_is_not_installed_is_left_out_and_told_unless_it_is_asked_for(
    agent: Agent, listener: Listener
) -> None:
    played = agent.call("ros2_bag_play", bag="mixed", rate=10, wait_sec=30)
    assert (played["state"], played["published"]) == ("ended", {"/a": 3})
    assert "/maker" in played["note"] and "strange_msgs/msg/Thing is not known" in played["note"]
    assert listener.numbers("/a", 3) == [0, 1, 2]
    refusal = agent.refusal("ros2_bag_play", bag="mixed", topics=["/a", "/maker"])
    assert "/maker cannot be played" in refusal and "Without it /a can be played" in refusal
    assert "/maker cannot be played" in agent.refusal("ros2_bag_play", bag="mixed", topics=["/maker"])


def test_a_name_that_ros_does_not_allow_is_played_by_another_one(agent: Agent, listener: Listener) -> None:
    name = "/größe der tür"
    assert "remaps" in agent.refusal("ros2_bag_play", bag="mixed", topics=[name])
    played = agent.call("ros2_bag_play", bag="mixed", topics=[name], remaps={name: "/c"}, rate=10, wait_sec=30)
    assert (played["state"], played["published"]) == ("ended", {"/c": 3})
    assert listener.numbers("/c", 3) == [0, 1, 2]


@pytest.mark.promise("ros2_bag_play", "Can move the robot if the bag holds commands")
def test_velocity_commands_that_somebody_listens_to_are_played_by_force_only(agent: Agent, listener: Listener) -> None:
    agent.knows("/cmd_vel")
    with pytest.raises(Refusal, match="would move the robot: /memory_peer listens to /cmd_vel"):
        agent.call("ros2_bag_play", bag="moves")
    elsewhere = agent.call("ros2_bag_play", bag="moves", remaps={"/cmd_vel": "/old/cmd_vel"})
    assert elsewhere["published"] == {"/old/cmd_vel": 1}
    assert elsewhere["note"] == "No subscriber when it began: /old/cmd_vel."
    assert agent.call("ros2_bag_play", bag="moves", force=True)["published"] == {"/cmd_vel": 1}


@pytest.mark.promise("README", "repeats, relays and playbacks ended")
def test_a_playback_that_ros2_stop_ends_is_stopped_and_not_failed(agent: Agent, listener: Listener) -> None:
    begun = agent.call("ros2_bag_play", bag="run", topic_names=["/a"], loop=True, wait_s=0)
    assert listener.numbers("/a", 2)
    agent.call("ros2_stop")
    deadline = time.monotonic() + PATIENCE_S
    while (state := told(agent, begun["playback_id"]))["state"] == "playing":
        assert time.monotonic() < deadline
        time.sleep(0.05)
    assert (state["state"], state["note"]) == ("stopped", "It was ended by ros2_stop.")


def told(agent: Agent, playback_id: str) -> dict[str, Any]:
    [state] = agent.call("ros2_bag_play_status", playback_id=playback_id)["playbacks"]
    return state
