"""The same questions to the robot and to the recording of that time; and a recording in the place of the robot."""

from __future__ import annotations

import re
import sys
import venv
from collections.abc import Callable, Iterator
from datetime import datetime, timedelta
from itertools import product
from pathlib import Path
from typing import Any

import pytest

from ros2_mcp.bags.bag import Bag
from ros2_mcp.ops.results.results import four_digits
from support.agent import Agent, agent_for, until
from support.raw_server import RawServer

StartAgent = Callable[..., Agent]
SAME = ("count", "min", "max", "mean", "std", "first", "last", "zeros", "not_finite")
TOPICS = ["/odom", "/scan", "/imu"]
MANY = 100
"""Messages, of which numbers are compared."""
PICTURES, DIAGNOSTICS = "/camera/image_raw", "/diagnostics"
EXACTLY, EDGE = timedelta(), timedelta(milliseconds=1)
SITE_PACKAGES = Path(next(entry for entry in sys.path if entry.endswith("site-packages")))


def numbers(statistics: dict[str, Any]) -> dict[str, dict[str, list[Any]]]:
    """What must be the same, by topic and field."""
    found: dict[str, dict[str, list[Any]]] = {}
    for topic in statistics["topics"]:
        of_topic = found[topic["topic_name"]] = {"": [topic["count"], topic["topic_type"], topic["dropped"]]}
        for field in topic["fields"]:
            of_topic[field["field"]] = [field[name] for name in SAME if name in field]
    return found


def moment(text: str) -> datetime:
    return datetime.fromisoformat(text.replace("Z", "+00:00"))


def window_of(statistics: dict[str, Any], earlier: timedelta = EXACTLY, later: timedelta = EXACTLY) -> dict[str, str]:
    topic = statistics["topics"][0]
    start = moment(topic["started_at"])
    end = start + timedelta(seconds=topic["duration"])
    return {"start": (start - earlier).isoformat(), "end": (end + later).isoformat()}


def check_that_numbers_are_the_same(live: dict[str, Any], ask: Callable[..., dict[str, Any]]) -> None:
    """Whether a recording has the numbers of what was measured live at that time.

    Two subscriptions receive the same message some microseconds apart. The one at an edge of the window may be in it
    for the one and not for the other, so each edge of each topic may be a millisecond to either side.
    """
    missing = numbers(live)
    for shifts in product((EXACTLY, EDGE, -EDGE), repeat=2):
        again = numbers(ask(topic_names=list(missing), **window_of(live, *shifts)))
        missing = {topic: fields for topic, fields in missing.items() if again[topic] != fields}
        if not missing:
            return
    assert not missing, numbers(ask(topic_names=TOPICS, **window_of(live)))


def has_begun(agent: Agent, bag: str, topics: list[str]) -> bool:
    """Whether messages of all these topics are in the recording of that name."""
    states = [each for each in agent.call("ros2_record_status")["recordings"] if each["bag"] == bag]
    written = {topic["topic_name"] for state in states for topic in state["topics"] if topic["written"]}
    return written >= set(topics)


Recorded = tuple[Agent, dict[str, Any], Path]


@pytest.fixture(scope="module")
def recorded(
    ros_environment: dict[str, str], demo_robot: object, tmp_path_factory: pytest.TempPathFactory
) -> Iterator[Recorded]:
    """What was measured live, while `run` was being recorded; the lidar was switched off afterwards. And the folder."""
    folder = tmp_path_factory.mktemp("recordings")
    with agent_for(ros_environment, "--tools", "all", "--record-dir", str(folder)) as agent:
        yield measured_and_recorded(agent, folder)


def measured_and_recorded(agent: Agent, folder: Path) -> Recorded:
    others = ["/rosout", DIAGNOSTICS, PICTURES, "/map"]
    agent.knows(*TOPICS, *others)
    begun = agent.call("ros2_record_start", topic_names=[*TOPICS, *others], name="run")
    until(lambda: has_begun(agent, "run", TOPICS))
    durations = iter((2.0, 3.0, 5.0, 10.0, 20.0))
    live = until(lambda: measured_whole(agent, begun["recording_id"], next(durations)), 120.0)
    agent.call("ros2_parameter_set", node_name="/lidar", values={"enabled": False})
    until(lambda: agent.call("ros2_log_read", node_name="/lidar", level="warn")["lines"])  # that it is dead
    silent = received_at(agent)
    until(lambda: received_at(agent) > silent + timedelta(seconds=2))
    for topic in (DIAGNOSTICS, PICTURES, "/odom"):  # not kept by others: the recording has them of its last moments
        assert agent.call("ros2_topic_echo_wait", topic_name=topic, timeout=30)["received"]
    agent.call("ros2_record_stop", recording_id=begun["recording_id"])
    agent.call("ros2_parameter_set", node_name="/lidar", values={"enabled": True})
    return agent, live, folder


def measured_whole(
    agent: Agent, recording_id: str, duration_s: float, topics: list[str] = TOPICS, many: int = MANY
) -> dict[str, Any] | None:
    """What is measured in that time, if it is much, and neither that nor the recording has lost anything of it: on a
    machine that is held up a best-effort message may reach one of two subscriptions alone.
    """
    before = lost(agent, recording_id)
    live = agent.call("ros2_topic_statistics", topic_names=topics, duration_s=duration_s)
    if sum(topic["count"] for topic in live["topics"]) <= many:
        return None
    is_whole = not any(topic["lost"] or topic["dropped"] for topic in live["topics"])
    return live if is_whole and lost(agent, recording_id) == before else None


def lost(agent: Agent, recording_id: str) -> list[tuple[int, int]]:
    """What a recording has not got, of each topic."""
    (state,) = agent.call("ros2_record_status", recording_id=recording_id)["recordings"]
    return [(topic["lost"], topic["dropped"]) for topic in state["topics"] if topic["topic_name"] in TOPICS]


def received_at(agent: Agent) -> datetime:
    """When the odometry came that is the newest."""
    return moment(agent.call("ros2_topic_echo_wait", topic_name="/odom", timeout=30)["received_at"])


@pytest.mark.promise("README", "The past answers in the same words as the present")
def test_the_recording_of_a_time_gives_the_numbers_that_were_measured_live(
    recorded: Recorded,
) -> None:
    agent, live, _ = recorded

    def ask(**arguments: Any) -> dict[str, Any]:
        again = agent.call("ros2_topic_statistics", bag="run", **arguments)
        assert live["source"].startswith("live") and again["source"].startswith("bag run")
        return again

    assert sum(topic["count"] for topic in live["topics"]) > MANY
    check_that_numbers_are_the_same(live, ask)


@pytest.mark.promise("README", "The past answers in the same words as the present")
@pytest.mark.promise("README", "--black-box keeps the last hours without being asked")
def test_the_servers_own_black_box_is_asked_in_the_same_words(start_agent: StartAgent, demo_robot: object) -> None:
    agent = start_agent("--black-box", "/odom,/scan")
    until(lambda: agent.call("ros2_record_status")["recordings"])
    until(lambda: has_begun(agent, "black-box", ["/odom", "/scan"]))
    (box,) = agent.call("ros2_record_status")["recordings"]
    live = until(lambda: measured_whole(agent, box["recording_id"], 2.0, ["/odom", "/scan"], many=0))
    end = moment(window_of(live, later=EDGE)["end"])
    for topic in ("/odom", "/scan"):
        until(lambda topic=topic: kept_until(agent, topic) > end)
    check_that_numbers_are_the_same(
        live, lambda **arguments: agent.call("ros2_topic_statistics", bag="black box", **arguments)
    )
    unnamed = agent.call(
        "ros2_wait_until", topic_name="/odom", condition="pose.pose.position.x < 1e6", start="last 1 s"
    )
    assert unnamed["met"] and unnamed["source"].startswith("bag black-box")


def kept_until(agent: Agent, topic: str) -> datetime:
    """When the black box received the last message of a topic that is on the disk."""
    last = agent.call("ros2_bag_read", bag="black box", topic_name=topic, message_limit=1, fields=["header.stamp"])
    return times_of(last)[-1]


def times_of(reading: dict[str, Any]) -> list[datetime]:
    """When each message of a reading was received."""
    return [moment(reading["start"]) + timedelta(seconds=seconds) for seconds in reading["times_s"]]


def test_moments_without_a_recording_are_refused(start_agent: StartAgent) -> None:
    refusal = start_agent().refusal("ros2_topic_statistics", topic_names=["/odom"], start="last 1 s")
    assert "no recording is named" in refusal and "ros2_bag_list" in refusal


def bare_python(root: Path) -> str:
    """A Python environment with what the server needs, and without ROS 2."""
    venv.create(root, symlinks=True)
    site_packages = next(root.glob("lib/python3*/site-packages"))
    for entry in SITE_PACKAGES.iterdir():
        if "ros_jazzy" not in entry.name and "rclpy" not in entry.name and entry.suffix != ".pth":
            (site_packages / entry.name).symlink_to(entry)
    return str(root / "bin" / "python")


def rate_hz(received_ns: list[int]) -> float:
    return (len(received_ns) - 1) / (received_ns[-1] - received_ns[0]) * 1e9


def check_that_reading_works(
    server: RawServer, call: Callable[..., dict[str, Any]], received_ns: dict[str, list[int]]
) -> None:
    """The tools that read topics, with a recording in the place of the robot; and when it received which."""
    begin_ns, end_ns = (end(map(end, received_ns.values())) for end in (min, max))
    first = call("ros2_topic_subscribe", topic_name="/odom", start="first 0 s", message_limit=3)
    assert first["count"] == 3 and "x" in first["messages"][0]["pose"]["pose"]["position"]
    begin = re.fullmatch(r"bag run, .* s from (\S+) \(0 s in\) on", first["source"])
    assert begin and first["start"] == begin[1] and all(seconds >= 0 for seconds in first["times_s"])
    last = call("ros2_topic_echo_wait", topic_name="/odom", timeout=0.1)
    assert last["received"] and moment(last["received_at"]) > max(times_of(first))
    kept = call("ros2_get_messages", topic_name="/odom", number_of_messages=1)
    assert kept["messages"] == [last["message"]] and kept["timestamps"] == [last["received_at"]]
    assert kept["times_s"] == [pytest.approx(last["seconds_from_start"], abs=0.001)] and times_of(kept) == [
        moment(last["received_at"])
    ]
    several = call("ros2_subscribe_multiple_topics", topics=[{"name": "/imu", "duration": 1}, {"name": "/nowhere"}])
    assert several["topics"][0]["received"] == sum(at > end_ns - 1_000_000_000 for at in received_ns["/imu"]) > 0
    assert "no topic /nowhere" in several["topics"][1]["error"]
    for stats in call("ros2_topic_stats", topic_names=["/odom", "/scan"], end="first 2 s")["topics"]:
        first = [at for at in received_ns[stats["topic_name"]] if at < begin_ns + 2_000_000_000]
        assert (stats["count"], stats["rate_hz"]) == (len(first), four_digits(rate_hz(first)))
    assert call("ros2_topic_stats", topic_names=["/scan"], start="last 1 s")["topics"][0]["count"] == 0
    for tool, asked in (
        ("ros2_topic_subscribe", {"topic_name": "/camera/image_raw"}),
        ("ros2_topic_echo_wait", {"topic_name": "/camera/image_raw"}),
        ("ros2_subscribe_multiple_topics", {"topics": [{"name": "/camera/image_raw"}]}),
        ("ros2_get_map_as_image", {"topic_name": "/map"}),
    ):
        shown = server.call(tool, **asked, start="last 1 s")  # of the map, the message came long before
        assert not shown.get("isError") and shown["content"][-1]["type"] == "image", shown["content"][0]
    plotted = server.call("ros2_plot", series=["/odom:pose.pose.position.x"], start="last 2 s")
    assert plotted["content"][-1]["type"] == "image"
    assert "sensor_msgs/msg/LaserScan" in call("ros2_interface_list", pattern="Laser")["interfaces"]
    assert "std_msgs/msg/Header" in call("ros2_interface_list")["interfaces"]
    assert call("ros2_get_message_fields", message_type="sensor_msgs/LaserScan")["kind"] == "msg"
    for absent in ("ros2_status", "ros2_node_list", "ros2_topic_publish"):
        refusal = server.call(absent)
        assert refusal["isError"] and "the robot of this server is a recording" in refusal["content"][0]["text"]


@pytest.mark.promise("ros2_topic_echo_wait", "Images and maps come as pictures")
@pytest.mark.promise("ros2_subscribe_multiple_topics", "Images and maps come as pictures")
@pytest.mark.promise("ros2_record_start", "Latched messages are included")
@pytest.mark.promise("README", "Camera topics come back as pictures")
@pytest.mark.promise("ros2_topic_subscribe", "Images and maps come as pictures")
@pytest.mark.promise("README", "ros2-mcp --bag FILE serves one in the place of the robot, with no ROS at all")
@pytest.mark.promise("ros2_topic_subscribe", "from start on, or without start the last seconds or messages")
@pytest.mark.promise("ros2_subscribe_multiple_topics", "from start on, or without start the last seconds or messages")
@pytest.mark.promise("ros2_topic_echo_wait", "or without start the last message")
@pytest.mark.promise("ros2_interface_list", "or stored in the recording")
def test_a_recording_in_the_place_of_the_robot_needs_no_ros(
    recorded: Recorded, ros_environment: dict[str, str], tmp_path: Path
) -> None:
    _, live, folder = recorded
    environment = {**ros_environment, "ROS2_MCP_ROS_ROOT": str(tmp_path / "none")}
    command = [bare_python(tmp_path / "bare"), "-m", "ros2_mcp", "--bag", str(folder / "run")]
    server = RawServer(environment, command=command)
    try:
        introduction = server.begin("2025-11-25")
        assert "recording" in introduction["instructions"] and "«run»" in introduction["instructions"]
        tools = {tool["name"] for tool in server.ask("tools/list")["result"]["tools"]}
        assert tools >= {"ros2_topic_list", "ros2_topic_info", "ros2_bag_read", "ros2_log_read", "ros2_wait_until"}
        assert not tools & {"ros2_topic_publish", "ros2_service_call", "ros2_bag_play", "ros2_record_start"}

        def call(tool: str, **arguments: Any) -> dict[str, Any]:
            result = server.call(tool, **arguments)
            assert not result.get("isError"), result
            return result["structuredContent"]

        received_ns: dict[str, list[int]] = {}
        with Bag(folder / "run") as bag:
            counts = bag.counts()
            for topic, sample in bag.messages():
                received_ns.setdefault(topic, []).append(sample.received_ns)
        assert {topic["topic_name"] for topic in call("ros2_topic_list")["topics"]} == set(bag.topics)
        assert call("ros2_topic_info", topic_name="/scan")["topic_types"] == ["sensor_msgs/msg/LaserScan"]
        assert "float32" in str(call("ros2_get_message_fields", message_type="sensor_msgs/msg/LaserScan"))
        check_that_numbers_are_the_same(live, lambda **asked: call("ros2_topic_statistics", **asked))
        met = call("ros2_wait_until", topic_name="/odom", condition="pose.pose.orientation.w > -2")
        assert met["met"] and met["messages_checked"] == 1
        assert (
            call("ros2_wait_until", topic_name="/odom", condition="pose.pose.position.x > 1e6")["messages_checked"]
            == (counts["/odom"])
        )
        health = call("ros2_health_check", expected_topics=["/scan", "/nowhere"])
        assert health["verdict"] == "CRITICAL"
        assert [each["subject"] for each in health["findings"] if each["severity"] == "critical"] == [
            "/nowhere",
            "lidar: status",
            "/scan",
        ]
        stopped = next(each["problem"] for each in health["findings"] if each["subject"] == "/scan")
        assert re.match(r"It has stopped: no message in the last \d+\.\d s, from ", stopped)
        (scan,) = call("ros2_topic_stats", topic_names=["/scan"])["topics"]
        assert "It has stopped" in scan["note"] and scan["longest_gap_s"] > 1.9
        end = call("ros2_health_check", start="last 1.5 s")
        assert [row["topic_name"] for row in end["topics"] if row["state"] == "SILENT"] == ["/scan"]
        check_that_reading_works(server, call, received_ns)
        log = call("ros2_log_read", level="warn")
        assert log["source"].startswith("bag run")
        assert [line["node"] for line in log["lines"]] == ["/lidar"]
        nothing = server.call(
            "ros2_topic_statistics", topic_names=TOPICS, start="2001-01-01T00:00:00Z", end="2001-01-02T00:00:00Z"
        )
        assert nothing["isError"] and "has no messages in that time. It covers" in nothing["content"][0]["text"]
    finally:
        server.end()
