"""Types that are not installed where the bridge runs, or are broken there, and those that services imply."""

from __future__ import annotations

import os
import shutil
from collections.abc import Iterator
from pathlib import Path

import pytest

from support.agent import Agent, agent_for, until
from support.demo_robot import build_interfaces, with_interfaces
from support.foreign_bags import Channel, numbers, write_mcap
from support.processes import peer_command, running

pytest.importorskip("rosidl_generator_py", reason="needs the interface generators of the ROS 2 wheels")
pytestmark = pytest.mark.timeout(300)

EVENT = "std_srvs/srv/SetBool_Event"


@pytest.fixture(scope="module")
def prefixes() -> list[Path]:
    """The packages that only the node has."""
    return build_interfaces("drone", later=True)


@pytest.fixture(scope="module")
def node(ros_environment: dict[str, str], prefixes: list[Path]) -> Iterator[None]:
    """A node with messages of those packages, and services with introspection."""
    with running(with_interfaces(ros_environment, prefixes), *peer_command("described_peer")):
        yield


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Where the server looks for recordings, and puts its own."""
    return tmp_path_factory.mktemp("bags")


@pytest.fixture(scope="module")
def stranger(
    ros_environment: dict[str, str], node: None, folder: Path, tmp_path_factory: pytest.TempPathFactory
) -> Iterator[Agent]:
    """A server without those packages."""
    environment = {**ros_environment, "XDG_CACHE_HOME": str(tmp_path_factory.mktemp("cache"))}
    options = "--tools", "all", "--record-dir", str(folder), "--bag-dir", str(folder)
    with agent_for(environment, *options) as agent:
        agent.knows("/state", "/landed", "/waypoints", "/tf")
        yield agent


@pytest.fixture(scope="module")
def spoilt(
    ros_environment: dict[str, str], node: None, prefixes: list[Path], tmp_path_factory: pytest.TempPathFactory
) -> Iterator[Agent]:
    """A server whose mavros_msgs has a message with a field `from`, as rosidl builds it without a word."""
    root = tmp_path_factory.mktemp("spoilt")
    (whole,) = (prefix for prefix in prefixes if prefix.name.startswith("mavros_msgs"))
    copied = Path(shutil.copytree(whole, root / whole.name))
    for other in (prefix for prefix in prefixes if prefix != whole):
        (root / other.name).symlink_to(other)  # where its libraries look for those of others
    for file in copied.glob("s*/mavros_msgs/msg/*aypoint.*"):
        file.write_text(file.read_text().replace("param1", "from"))
    environment = {**ros_environment, "XDG_CACHE_HOME": str(root / "cache")}
    used = [option for one in prefixes for option in ("--interfaces", str(root / one.name))]
    with agent_for(environment, "--tools", "all", *used) as agent:
        agent.knows("/state", "/waypoints")
        yield agent


# ── not installed ────────────────────────────────────────────────────────────────────────────────────────────────────


def test_a_type_that_only_its_node_has_is_shown_with_its_constants(stranger: Agent) -> None:
    shown = stranger.call("ros2_get_message_fields", message_type="mavros_msgs/msg/ExtendedState")
    assert shown["fields"]["landed_state"] == "uint8"
    assert any("LANDED_STATE_IN_AIR" in line and "2" in line for line in shown["text"].splitlines())
    listed = stranger.call("ros2_interface_list", package="mavros_msgs")
    assert listed["interfaces"] == []  # it is not said to be installed


@pytest.mark.parametrize(
    ("topic", "path", "value"),
    [
        ("/state", ("mode",), "GUIDED"),
        ("/landed", ("landed_state",), 2),
        ("/waypoints", ("waypoints", 0, "x_lat"), 47.5),
    ],
)
def test_messages_of_a_type_that_is_not_installed_are_read(
    stranger: Agent, topic: str, path: tuple[str | int, ...], value: object
) -> None:
    found = stranger.call("ros2_topic_echo_wait", topic_name=topic, timeout=20)["message"]
    for step in path:
        found = found[step]
    assert found == value


def test_what_is_measured_of_such_topics_is_their_rate_and_the_frames_in_them(stranger: Agent) -> None:
    def is_ten_hz() -> bool:
        """Of two seconds in which a busy machine has held up nobody."""
        (measured,) = stranger.call("ros2_topic_stats", topic_names=["/state"], duration_s=2)["topics"]
        return 5 < (measured["rate_hz"] or 0.0) < 15

    until(is_ten_hz)
    found = stranger.call("ros2_tf_lookup", target_frame="map", source_frame="base_link")
    assert found["translation"]["x"] == 2.5


def test_such_a_topic_is_recorded_with_the_definition_of_its_node(stranger: Agent, folder: Path) -> None:
    stranger.call("ros2_record_start", topic_names=["/waypoints", "/arm/_service_event"], name="of_others")
    stranger.call("ros2_topic_subscribe", topic_name="/waypoints", message_limit=10, duration=20)
    stranger.call("ros2_record_stop")
    with agent_for(dict(os.environ), "--tools", "all", "--bag", str(folder / "of_others")) as reader:
        read = reader.call("ros2_topic_subscribe", topic_name="/waypoints", message_limit=1)
        assert read["messages"][0]["waypoints"][0]["frame"] == 3
        event = reader.call("ros2_topic_subscribe", topic_name="/arm/_service_event", message_limit=20)
        assert {"value": True} in [one["request"][0] for one in event["messages"] if one["request"]]


def test_such_a_type_is_not_published_and_the_answer_says_what_to_install(stranger: Agent) -> None:
    told = stranger.refusal("ros2_topic_publish", topic_name="/state", data={"mode": "AUTO"})
    assert told.startswith("UnknownInterface") and "mavros_msgs/msg/State" in told and "nstall" in told


def test_a_service_that_no_node_describes_is_listed_and_the_answer_says_what_is_missing(stranger: Agent) -> None:
    told = stranger.refusal("ros2_get_message_fields", message_type="mavros_msgs/srv/SetMode")
    assert "no node provides it" in told and "mavros_msgs is not there" in told


# ── a field whose name is a word of Python ───────────────────────────────────────────────────────────────────────────


def test_a_field_that_is_a_word_of_python_spoils_no_other_message(spoilt: Agent) -> None:
    assert spoilt.call("ros2_topic_echo_wait", topic_name="/state", timeout=20)["message"]["armed"] is True
    sent = spoilt.call("ros2_topic_publish", topic_name="/mode", message_type="mavros_msgs/msg/State", data={})
    assert sent["status"] == "published" or sent["subscribers"] == 0


def test_its_own_message_is_refused_with_the_name_of_the_field(spoilt: Agent) -> None:
    told = spoilt.refusal(
        "ros2_topic_publish", topic_name="/one", message_type="mavros_msgs/msg/Waypoint", data={"frame": 3}
    )
    assert "its field from is a word of Python" in told and "sourced" not in told


def test_a_message_that_contains_it_is_refused_with_the_message_and_the_field(spoilt: Agent) -> None:
    told = spoilt.refusal("ros2_topic_echo_wait", topic_name="/waypoints", timeout=5)
    assert "in mavros_msgs/msg/Waypoint the field from is a word of Python" in told


# ── events of services ───────────────────────────────────────────────────────────────────────────────────────────────


@pytest.mark.parametrize(
    ("topic", "asked", "answered"),
    [
        ("/grip/_service_event", {"data": True}, {"success": True, "message": "gripped"}),
        ("/arm/_service_event", {"value": True}, {"success": True, "result": 7}),  # of a type that is not installed
    ],
)
def test_the_events_of_a_service_are_read_live(
    stranger: Agent, topic: str, asked: dict[str, object], answered: dict[str, object]
) -> None:
    events = stranger.call("ros2_topic_subscribe", topic_name=topic, message_limit=16, duration=20)["messages"]
    assert {event["info"]["event_type"] for event in events} == {0, 1, 2, 3}
    assert asked in [event["request"][0] for event in events if event["request"]]
    assert answered in [event["response"][0] for event in events if event["response"]]


def test_recorded_events_are_read_without_ros(stranger: Agent, folder: Path) -> None:
    stranger.call("ros2_record_start", topic_names=["/grip/_service_event"], name="events")
    stranger.call("ros2_topic_subscribe", topic_name="/grip/_service_event", message_limit=12, duration=20)
    stranger.call("ros2_record_stop")
    (topic,) = stranger.call("ros2_bag_info", bag="events")["topics"]
    assert (topic["topic_type"], topic["has_definition"]) == (EVENT, True)
    with agent_for(dict(os.environ), "--tools", "all", "--bag", str(folder / "events")) as reader:
        events = reader.call("ros2_topic_subscribe", topic_name="/grip/_service_event", message_limit=8)["messages"]
        assert {"data": True} in [event["request"][0] for event in events if event["request"]]


def test_events_in_a_bag_without_their_definition_are_read_by_the_robots_and_named_where_there_is_none(
    stranger: Agent, folder: Path
) -> None:
    info = b"\0\1\0\0" + b"\1" + bytes(3) + (1_700_000_000).to_bytes(4, "little") + bytes(4) + bytes(range(16))
    info += bytes(-(len(info) - 4) % 8) + (42).to_bytes(8, "little")
    event = info + (1).to_bytes(4, "little") + b"\1" + bytes(3) + bytes(4)
    events = Channel("/grip/_service_event", [event] * 3, EVENT, definition=b"")
    path = write_mcap(folder / "undefined.mcap", events, numbers("/speed"))
    read = stranger.call("ros2_bag_read", bag="undefined.mcap", topic_name="/grip/_service_event")["messages"]
    assert [(one["info"]["sequence_number"], one["request"], one["response"]) for one in read] == [
        (42, [{"data": True}], [])
    ] * 3
    with agent_for(dict(os.environ), "--tools", "all", "--bag", str(path)) as reader:
        told = reader.refusal("ros2_topic_subscribe", topic_name="/grip/_service_event")
        assert f"no definition of {EVENT}" in told
        assert len(reader.call("ros2_topic_subscribe", topic_name="/speed", message_limit=9)["messages"]) == 5
