"""Recordings that others made: what a file holds is decided where it is opened, and every tool asks that."""

from __future__ import annotations

import asyncio
import json
import struct
from collections.abc import AsyncIterator, Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import pytest
from mcap.writer import CompressionType

from ros2_mcp.compose.server import SOURCE_KINDS
from ros2_mcp.guard.state import StateFolder
from ros2_mcp.mcp.binding import CallFailed
from ros2_mcp.mcp.toolset import Toolset
from ros2_mcp.ops.memory.bag_store import BagStore
from ros2_mcp.ops.sources.kinds import Sources
from ros2_mcp.ops.sources.recorded_robot import recorded_robot
from ros2_mcp.robot import Robot
from ros2_mcp.view.acting import Acting
from ros2_mcp.view.viewing import Viewing
from support.foreign_bags import STRING, Channel, number, numbers, text, write_db3, write_mcap
from support.made_bridge import MadeBridge, robot_of

ROBOT_STATE = {"type": "object", "properties": {"mode": {"type": "string"}, "battery": {"type": "number"}}}


def json_channel(topic: str, *messages: object, schema: object = None, name: str = "app.State") -> Channel:
    definition = json.dumps(schema).encode() if schema is not None else b""
    data = [json.dumps(message).encode() for message in messages]
    return Channel(topic, data, name, "jsonschema", definition, "json", has_schema=schema is not None)


@dataclass
class Tools:
    """The tools over a folder of recordings, or over one that stands for the robot."""

    folder: Path
    tools: Toolset
    store: BagStore

    async def call(self, name: str, **arguments: Any) -> tuple[str, dict[str, Any], bool]:
        try:
            result = await self.tools.call(name, arguments, lambda *_: asyncio.sleep(0))
        except CallFailed as failed:
            return str(failed), {}, True
        said: str = result.content[0].text  # type: ignore[union-attr]
        return said, result.structured_content or {}, bool(result.is_error)

    async def structured(self, name: str, **arguments: Any) -> dict[str, Any]:
        said, found, is_error = await self.call(name, **arguments)
        assert not is_error, said
        return found


Open = Callable[..., Tools]


@pytest.fixture
async def opened(tmp_path: Path, anyio_backend: str) -> AsyncIterator[Open]:
    stores: list[BagStore] = []

    def open_tools(subject: Path | None = None) -> Tools:
        store = BagStore(tmp_path / "records", tmp_path, subject)
        stores.append(store)
        robot: Robot = recorded_robot(store) if subject else robot_of(MadeBridge())
        viewing = Viewing(Sources(robot, store, SOURCE_KINDS), "", Acting(StateFolder(tmp_path / "state")))
        return Tools(tmp_path, Toolset(robot, store, ["all"], SOURCE_KINDS, viewing=viewing), store)

    yield open_tools
    for store in stores:
        await store.close()


# ── encodings ────────────────────────────────────────────────────────────────────────────────────────────────────────


@pytest.mark.parametrize("compression", list(CompressionType))
async def test_json_is_read_with_and_without_a_schema(
    opened: Open, tmp_path: Path, compression: CompressionType
) -> None:
    with_schema = [{"mode": "idle", "battery": 0.5}, {"mode": "drive"}, {"mode": "drive", "battery": 1, "extra": [1]}]
    path = write_mcap(
        tmp_path / "mixed.mcap",
        json_channel("/state", *with_schema, schema=ROBOT_STATE),
        json_channel("/free", {"pose": {"x": 1.5, "y": None}}, [1, 2], 7),
        numbers("/v"),
        compression=compression,
    )
    found = opened(path)
    state = await found.structured("ros2_topic_subscribe", topic_name="/state", message_limit=3)
    assert state["topic_type"] == "json:app.State"
    assert state["messages"] == [*with_schema[:2], {"mode": "drive", "battery": 1, "extra": [1]}]
    free = await found.structured("ros2_topic_subscribe", topic_name="/free", message_limit=3)
    assert free["topic_type"] == "json:/free" and free["count"] == 3


@pytest.mark.parametrize("schema", [None, {}, {"type": "object"}])
async def test_fields_conditions_statistics_and_plots_work_on_json(
    opened: Open, tmp_path: Path, schema: object
) -> None:
    messages = [{"motor": {"left temp": 20.0 + each, "rpm": each * 100}, "on": each > 3} for each in range(10)]
    write_mcap(tmp_path / "run.mcap", json_channel("/motor", *messages, schema=schema))
    found = opened()
    fields = ["motor.rpm", "motor.left temp"]
    read = await found.structured("ros2_bag_read", bag="run.mcap", topic_name="/motor", fields=fields, message_limit=2)
    assert [message["motor.left temp"] for message in read["messages"]] == [28, 29]
    met = await found.structured(
        "ros2_wait_until", bag="run.mcap", topic_name="/motor", condition="motor.rpm > 450 and on"
    )
    assert met["met"] and met["messages_checked"] == 6
    measured = await found.structured("ros2_topic_statistics", bag="run.mcap", topic_names=["/motor"])
    by_field = {row["field"]: row for row in measured["topics"][0]["fields"]}
    assert (by_field["motor.rpm"]["min"], by_field["motor.rpm"]["max"]) == (0, 900)
    assert by_field["motor.left temp"]["max"] == 29
    _, plotted, is_error = await found.call("ros2_plot", bag="run.mcap", series=["/motor:motor.rpm"])
    assert not is_error and plotted["pictures"]


async def test_a_field_that_a_json_message_lacks_is_no_number(opened: Open, tmp_path: Path) -> None:
    messages = [{"v": 1.0}, {}, {"v": None}, {"v": 3.0}]
    write_mcap(tmp_path / "run.mcap", json_channel("/v", *messages))
    found = opened()
    measured = await found.structured("ros2_topic_statistics", bag="run.mcap", topic_names=["/v"])
    (row,) = measured["topics"][0]["fields"]
    assert (row["count"], row["min"], row["max"]) == (2, 1, 3)
    undecided = await found.structured("ros2_wait_until", bag="run.mcap", topic_name="/v", condition="v > 5")
    assert not undecided["met"] and "2 of 4 messages could not be checked" in undecided["note"]


@pytest.mark.parametrize(
    ("serialization", "encoding"),
    [("protobuf", "protobuf"), ("ros1", "ros1msg"), ("flatbuffer", "flatbuffer"), ("cbor", ""), ("", "")],
)
async def test_other_encodings_are_named_and_measured_and_spoil_nothing_else(
    opened: Open, tmp_path: Path, serialization: str, encoding: str
) -> None:
    other = Channel("/other", [bytes(range(each, each + 30)) for each in range(5)], "x.Pose", encoding, b"\1\2\xff")
    path = write_mcap(tmp_path / "mixed.mcap", numbers("/v"), replace(other, serialization=serialization))
    found = opened(path)
    stats = await found.structured("ros2_topic_stats", topic_names=["/v", "/other"])
    rates = {row["topic_name"]: (row["rate_hz"], row["mean_size_bytes"]) for row in stats["topics"]}
    assert rates == {"/v": (10, 12), "/other": (10, 30)}
    health = await found.structured("ros2_health_check")
    assert health["counts"]["measured"] == 2 and not health["findings"]
    info = await found.structured("ros2_bag_info", bag="mixed.mcap")
    assert [(row["topic_type"], row["has_definition"]) for row in info["topics"]] == [
        (f"{serialization or 'unknown'}:x.Pose", False),
        ("std_msgs/msg/Float64", True),
    ]
    for name, asked in (
        ("ros2_topic_subscribe", {"topic_name": "/other"}),
        ("ros2_topic_statistics", {"topic_names": ["/other"]}),
        ("ros2_plot", {"series": ["/other:x"]}),
        ("ros2_wait_until", {"topic_name": "/other", "condition": "x > 1"}),
    ):
        said, _, _ = await found.call(name, **asked)
        assert f"encoded as {serialization}" in said or ("no encoding" in said and not serialization), said


async def test_every_tool_that_reads_recordings_bears_foreign_channels(opened: Open, tmp_path: Path) -> None:
    path = write_mcap(
        tmp_path / "mixed.mcap",
        json_channel("/odom", {"x": 1}, name="nav_msgs/msg/Odometry", schema={}),
        Channel("/scan", [b"\1\2\3"] * 3, "sensor_msgs/LaserScan", "protobuf", b"", "protobuf"),
        Channel("/tf", [b"\1"] * 3, "tf2_msgs/TFMessage", "ros1msg", b"", "ros1"),
        Channel("/none", [b"\0\1\0\0"], has_schema=False),
        Channel("/unknown", [b"\0\1\0\0\1\0\0\0"], "odd_msgs/msg/Odd", "unknown", b""),
    )
    found = opened(path)
    for name, asked in (
        ("ros2_robot", {}),
        ("ros2_scene", {}),
        ("ros2_tf_tree", {}),
        ("ros2_topic_list", {}),
        ("ros2_interface_list", {}),
        ("ros2_topic_info", {"topic_name": "/scan"}),
        ("ros2_log_read", {}),
        ("ros2_health_check", {}),
        ("ros2_topic_stats", {}),
        ("ros2_get_messages", {"topic_name": "/scan"}),
        ("ros2_topic_compare", {"topic1_name": "/scan", "topic2_name": "/odom"}),
        ("ros2_bag_info", {"bag": "mixed.mcap"}),
        *(("ros2_topic_echo_wait", {"topic_name": topic}) for topic in ("/odom", "/scan", "/tf", "/none", "/unknown")),
    ):
        said, _, _ = await found.call(name, **asked)
        assert "unpack" not in said and "<_io" not in said, (name, said)
    stats = await found.structured("ros2_topic_stats", topic_names=["/none", "/unknown", "/odom"])
    assert [row["count"] for row in sorted(stats["topics"], key=lambda row: row["topic_name"])] == [1, 1, 1]


async def test_a_definition_is_one_only_if_it_can_be_used(opened: Open, tmp_path: Path) -> None:
    header = b"std_msgs/Header header\nfloat64 v\n"  # without that of the header
    write_mcap(
        tmp_path / "run.mcap",
        Channel("/broken", [b"\0\1\0\0"], "odd_msgs/msg/Broken", definition=b"float64 [data\n"),
        Channel("/lacks", [b"\0\1\0\0" + bytes(12) + b"\0\0\0\0" + number(5)[4:]], "odd_msgs/msg/V", definition=header),
        Channel("/short", [number(1)], "std_msgs/Float64"),
        Channel("/empty", [b"\0\1\0\0\0"], "std_msgs/msg/Empty", definition=b""),
        Channel("/own_empty", [b"\0\1\0\0\0"], "odd_msgs/msg/Trigger", definition=b""),
    )
    found = opened()
    info = await found.structured("ros2_bag_info", bag="run.mcap")
    usable = {row["topic_name"]: row["has_definition"] for row in info["topics"]}
    assert usable == {"/broken": False, "/lacks": False, "/short": True, "/empty": True, "/own_empty": True}
    assert (await found.structured("ros2_bag_read", bag="run.mcap", topic_name="/own_empty"))["messages"] == [{}]
    assert (await found.structured("ros2_bag_read", bag="run.mcap", topic_name="/empty"))["messages"] == [{}]
    assert (await found.structured("ros2_bag_read", bag="run.mcap", topic_name="/short"))["messages"] == [{"data": 1}]
    lacks = await found.structured("ros2_bag_read", bag="run.mcap", topic_name="/lacks")
    assert lacks["messages"][0]["v"] == 5, "what a definition refers to is taken from what ROS defines"


async def test_a_file_is_what_its_bytes_are(opened: Open, tmp_path: Path) -> None:
    write_mcap(tmp_path / "really.mcap", numbers("/v", 3)).rename(tmp_path / "really.db3")
    write_db3(tmp_path / "base.db3", [("/w", "std_msgs/msg/Float64", [(10**18, number(4))])]).rename(
        tmp_path / "base.mcap"
    )
    (tmp_path / "noetic.bag").write_bytes(b"#ROSBAG V2.0\n" + bytes(100))
    found = opened()
    info = await found.structured("ros2_bag_info", bag="really.db3")
    assert info["messages"] == 3 and any("MCAP" in line for line in info["problems"])
    assert (await found.structured("ros2_bag_read", bag="base.mcap", topic_name="/w"))["messages"] == [{"data": 4}]
    said, _, is_error = await found.call("ros2_bag_info", bag="noetic.bag")
    assert is_error and "ROS 1" in said and "rosbags-convert --src noetic.bag" in said
    said, listed, _ = await found.call("ros2_bag_list")
    assert "noetic.bag" in said and {row["bag"] for row in listed["bags"]} == {"really.db3", "base.mcap"}


# ── names ────────────────────────────────────────────────────────────────────────────────────────────────────────────

NAMES = ("speed", "/cam-1/front light", "vehicle.speed", "a//b", "/1st", "/", "λ", "x:y")


async def test_a_name_that_is_listed_can_be_asked_for_by_every_tool(opened: Open, tmp_path: Path) -> None:
    path = write_mcap(tmp_path / "names.mcap", *(numbers(name, 4, 10.0 * at) for at, name in enumerate(NAMES)))
    found = opened(path)
    info = await found.structured("ros2_bag_info", bag="names.mcap")
    assert {row["topic_name"] for row in info["topics"]} == set(NAMES)
    for at, name in enumerate(NAMES):
        read = await found.structured("ros2_bag_read", bag="names.mcap", topic_name=name, message_limit=1)
        assert read["messages"] == [{"data": 10 * at + 3}]
        for tool, asked in (
            ("ros2_topic_subscribe", {"topic_name": name}),
            ("ros2_topic_echo_wait", {"topic_name": name}),
            ("ros2_topic_info", {"topic_name": name}),
            ("ros2_get_messages", {"topic_name": name}),
            ("ros2_topic_statistics", {"topic_names": [name]}),
            ("ros2_topic_stats", {"topic_names": [name]}),
            ("ros2_wait_until", {"topic_name": name, "condition": "data > 1"}),
            ("ros2_health_check", {"expected_topics": [name]}),
            ("ros2_topic_compare", {"topic1_name": name, "topic2_name": NAMES[at - 1]}),
        ):
            said, _, is_error = await found.call(tool, **asked)
            assert not is_error and "no topic" not in said and "MISSING" not in said, (tool, name, said)
    for at, name in enumerate(NAMES):
        plotted = await found.structured("ros2_plot", series=[f"{name}:data"])
        assert plotted["series"][0]["first"] == 10 * at, name


async def test_a_series_is_parted_at_the_last_colon_behind_a_topic(opened: Open, tmp_path: Path) -> None:
    names = ("arm", "arm:speed", "arm:speed:raw")
    found = opened(write_mcap(tmp_path / "arm.mcap", *(numbers(name, 3, 10.0 * at) for at, name in enumerate(names))))
    for series, first in (("arm:data", 0), ("arm:speed:data", 10), ("arm:speed:raw:data", 20), ("arm:speed", 10)):
        plotted = await found.structured("ros2_plot", series=[series])
        assert [one["first"] for one in plotted["series"]] == [first], series
    said, _, is_error = await found.call("ros2_plot", series=["leg:speed:data"])
    assert is_error and "no topic" in said


async def test_a_slash_more_or_less_is_no_other_name(opened: Open, tmp_path: Path) -> None:
    write_mcap(tmp_path / "names.mcap", numbers("speed", 2), numbers("/ok", 2), numbers("/both", 2), numbers("both", 3))
    found = opened()
    counts = {
        name: (await found.structured("ros2_bag_read", bag="names.mcap", topic_name=name, message_limit=9))["count"]
        for name in ("speed", "/speed", "ok", "/ok", "both", "/both")
    }
    assert counts == {"speed": 2, "/speed": 2, "ok": 2, "/ok": 2, "both": 3, "/both": 2}


# ── folders ──────────────────────────────────────────────────────────────────────────────────────────────────────────


async def test_two_days_in_one_folder_are_two_recordings(opened: Open, tmp_path: Path) -> None:
    folder = tmp_path / "downloads"
    write_mcap(folder / "monday.mcap", numbers("/v", 10))
    write_mcap(folder / "tuesday.mcap", numbers("/v", 10, 1000.0), start_ns=1_700_086_400 * 10**9)
    for part in range(3):
        write_mcap(
            folder / f"run_{part}.mcap", numbers("/v", 10, 10.0 * part), start_ns=1_700_000_000 * 10**9 + part * 10**9
        )
    found = opened()
    _, listed, _ = await found.call("ros2_bag_list")
    assert {row["bag"] for row in listed["bags"]} == {
        "downloads/monday.mcap",
        "downloads/tuesday.mcap",
        "downloads/run",
    }
    info = await found.structured("ros2_bag_info", bag="downloads/run")
    assert (info["messages"], info.get("problems")) == (30, None)
    assert (await found.structured("ros2_bag_info", bag="downloads/monday.mcap"))["duration_s"] < 1
    said, _, is_error = await found.call("ros2_topic_stats", bag="downloads", topic_names=["/v"])
    assert is_error and "downloads/monday.mcap" in said and "downloads/run" in said


async def test_the_files_of_one_recording_are_one_and_a_stranger_beside_them_is_another(
    opened: Open, tmp_path: Path
) -> None:
    folder = tmp_path / "trip"
    for part in range(2):
        write_mcap(folder / f"trip_{part}.mcap", numbers("/v", 5))
    write_mcap(folder / "other.mcap", numbers("/v", 7))
    (folder / "metadata.yaml").write_text(
        "rosbag2_bagfile_information:\n  message_count: 10\n  compression_mode: ''\n"
        "  relative_file_paths: [trip_0.mcap, trip_1.mcap]\n"
    )
    found = opened()
    _, listed, _ = await found.call("ros2_bag_list")
    assert {row["bag"] for row in listed["bags"]} == {"trip", "trip/other.mcap"}
    assert (await found.structured("ros2_bag_info", bag="trip"))["messages"] == 10
    assert (await found.structured("ros2_bag_info", bag="trip/other.mcap"))["messages"] == 7


async def test_a_folder_of_one_file_that_has_its_footer_was_closed(opened: Open, tmp_path: Path) -> None:
    write_mcap(tmp_path / "one" / "walk.mcap", numbers("/v"))
    cut = write_mcap(tmp_path / "cut" / "walk.mcap", numbers("/v"))
    cut.write_bytes(cut.read_bytes()[:-200])
    found = opened()
    assert "problems" not in await found.structured("ros2_bag_info", bag="one")
    assert any("not closed" in line for line in (await found.structured("ros2_bag_info", bag="cut"))["problems"])


async def test_folders_that_are_too_deep_to_be_searched_are_named(opened: Open, tmp_path: Path) -> None:
    write_mcap(tmp_path / "a" / "b" / "c" / "d" / "e" / "deep.mcap", numbers("/v"))
    write_mcap(tmp_path / "a" / "b" / "c" / "d" / "near.mcap", numbers("/v"))
    found = opened()
    said, listed, _ = await found.call("ros2_bag_list")
    assert [row["bag"] for row in listed["bags"]] == ["a/b/c/d"]
    assert "folders in a/b/c/d" in said
    assert (await found.structured("ros2_bag_info", bag="a/b/c/d/e/deep.mcap"))["messages"] == 5


def test_texts_of_other_lengths_are_written_as_they_are() -> None:
    assert text("ab") == b"\0\1\0\0" + struct.pack("<I", 3) + b"ab\0" and STRING.endswith("String")
