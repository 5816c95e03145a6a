"""Whatever odd inputs a tool is given, in its arguments or in a recording, no words of a library are in its answer."""

from __future__ import annotations

import asyncio
import math
import random
import re
from collections.abc import AsyncGenerator
from pathlib import Path
from typing import Any

import pytest
from mcp.types import TextContent

from ros2_mcp.bags.qos import qos_text
from ros2_mcp.bags.stored import StoredTopic
from ros2_mcp.bags.writer import BagWriter
from ros2_mcp.compose.server import SOURCE_KINDS
from ros2_mcp.mcp.binding import CallFailed
from ros2_mcp.mcp.toolset import Toolset
from ros2_mcp.model.qos import QoS
from ros2_mcp.model.samples import Sample
from ros2_mcp.ops.memory.bag_store import BagStore
from ros2_mcp.ops.sources.recorded_robot import recorded_robot
from support.made_bridge import MadeBridge, robot_of
from support.made_windows import START_NS, encoded
from support.msg_texts import text_of

LIBRARY = re.compile(
    r"<[\w.]+ object|object at 0x|\bBytesIO|unpack_from|Traceback|\[?Errno|\bnumpy|np\.|pydantic|\bPIL\b"
    r"|\b\w*(?:KeyError|ValueError|TypeError|IndexError|AttributeError|OverflowError|struct\.error)\b"
    r"|cannot identify|NoneType|list index out of|invalid literal|not enough values|Expecting value"
    r"|must be real|out of bounds for|a bytes-like object|codec can't|cannot reshape|broadcast"
    r"|\bnan\b(?!['\"])|fault of this server"
)
"""What libraries and the language say; and a number that is none, in a sentence."""
MESSAGES: dict[str, tuple[str, dict[str, Any]]] = {
    "/image": ("sensor_msgs/msg/Image", {"width": 4, "height": 4, "encoding": "rgb8", "step": 12, "data": [1, 2, 3]}),
    "/image_of_nothing": ("sensor_msgs/msg/Image", {"encoding": "no_such", "data": []}),
    "/compressed": ("sensor_msgs/msg/CompressedImage", {"format": "jpeg", "data": [255, 216, 1, 2, 3]}),
    "/compressed_oddly": ("sensor_msgs/msg/CompressedImage", {"format": "", "data": []}),
    "/cloud": (
        "sensor_msgs/msg/PointCloud2",
        {
            "width": 3,
            "height": 1,
            "point_step": 8,
            "row_step": 24,
            "fields": [{"name": name, "offset": 4 * at, "datatype": 7, "count": 1} for at, name in enumerate("xyz")],
            "data": [0] * 24,
        },
    ),
    "/cloud_of_nothing": ("sensor_msgs/msg/PointCloud2", {"width": 9}),
    "/scan": ("sensor_msgs/msg/LaserScan", {"ranges": [1.0, math.nan, math.inf], "angle_increment": 0.0}),
    "/scan_of_nothing": ("sensor_msgs/msg/LaserScan", {"angle_min": math.nan}),
    "/map": (
        "nav_msgs/msg/OccupancyGrid",
        {
            "info": {"width": 3, "height": 3, "resolution": math.nan, "origin": {"position": {"x": math.nan}}},
            "data": [0],
        },
    ),
    "/map_of_nothing": ("nav_msgs/msg/OccupancyGrid", {}),
    "/odom": (
        "nav_msgs/msg/Odometry",
        {
            "pose": {"pose": {"position": {"x": math.nan}, "orientation": {"w": 0.0}}},
            "twist": {"twist": {"linear": {"x": math.inf}}},
        },
    ),
    "/tf": (
        "tf2_msgs/msg/TFMessage",
        {
            "transforms": [
                {
                    "header": {"frame_id": "map"},
                    "child_frame_id": "base",
                    "transform": {"translation": {"x": math.nan}},
                },
                {"header": {"frame_id": "base"}, "child_frame_id": "base"},
            ]
        },
    ),
    "/robot_description": ("std_msgs/msg/String", {"data": "<robot><joint name='a'><limit lower='low'/></joint>"}),
    "/joint_states": ("sensor_msgs/msg/JointState", {"name": ["a", "b"], "position": [math.nan]}),
    "/path": ("nav_msgs/msg/Path", {"poses": [{"pose": {"position": {"y": math.inf}}}]}),
    "/battery": ("sensor_msgs/msg/BatteryState", {"percentage": math.nan, "voltage": math.nan}),
    "/text": ("std_msgs/msg/String", {"data": "\u202e é"}),
    "/diagnostics": (
        "diagnostic_msgs/msg/DiagnosticArray",
        {"status": [{"name": "", "values": [{"key": "temperature", "value": "nan"}]}]},
    ),
}
CONDITIONS = (
    "",
    "data",
    "data ==",
    "== 3",
    "data == 'x",
    "a..b > 1",
    "ranges[ > 1",
    "ranges[9] > 1",
    "1 > 2 and",
    "data > 'x'",
    "not",
    "((data))",
    "data = 3",
    "ranges[x] > 1",
)
FIELDS = (
    "",
    ".",
    "[",
    "data[",
    "data[0:",
    "ranges[5]",
    "ranges[a:b]",
    "name[*]",
    "x y",
    "header.stamp.sec.x",
    "transforms[child_frame_id == ].x",
    "🤖",
)
TIMES = ("yesterday", "12 s in in", "-1", "1e400", "2026-13-45T99:00:00Z", "last s", "last -5 s", "now", "9" * 40, "0")
TOPICS = ("", "/", "image", "//x", "/none", "/a b", "~x", "/9", "x" * 300)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A recording of odd messages, and beside it files that are none."""
    folder = tmp_path_factory.mktemp("odd")
    (folder / "odd").mkdir()
    writer, garbage = BagWriter(folder / "odd", "odd"), random.Random(7)
    for number, (topic, (kind, value)) in enumerate(MESSAGES.items()):
        whole = encoded(kind, value)
        for name, data in ((topic, whole), (f"{topic}_cut", whole[:-3]), (f"{topic}_noise", garbage.randbytes(60))):
            writer.add_topic(StoredTopic(name, kind, None, "ros2msg", text_of(kind), qos_text([QoS()])))
            for second in range(3):
                at_ns = START_NS + second * 10**9 + number
                writer.write(name, Sample(at_ns, at_ns, second, data))
    writer.close()
    (folder / "empty.mcap").write_bytes(b"")
    (folder / "no.mcap").write_bytes(b"hello, I am no recording" * 10)
    (folder / "no.db3").write_bytes(b"SQLite format 3\x00" + b"\xff" * 200)
    (folder / "text.db3").write_text("x")
    (folder / "sub").mkdir()
    (folder / "sub" / "metadata.yaml").write_text("rosbag2_bagfile_information: [")
    return folder


@pytest.fixture
async def tools(folder: Path, name: str) -> AsyncGenerator[Toolset, None]:
    if name == "ros2_get_messages":  # it names no bag: there the recording stands for the robot
        store = BagStore(folder, subject=folder / "odd")
        robot = recorded_robot(store)
    else:
        store = BagStore(folder)
        robot = robot_of(MadeBridge())
    yield Toolset(robot, store, ["all"], SOURCE_KINDS)
    await store.close()


async def told(tools: Toolset, name: str, arguments: dict[str, Any]) -> str:
    try:
        result = await tools.call(name, arguments, lambda *_: asyncio.sleep(0))
    except CallFailed as error:
        return str(error)
    return " ".join(part.text for part in result.content if isinstance(part, TextContent))


def odd_calls() -> dict[str, list[dict[str, Any]]]:
    """By tool, what it is asked."""
    every = [f"{topic}{kind}" for topic in MESSAGES for kind in ("", "_cut", "_noise")]
    one = {"bag": "odd"}
    topics = [{**one, "topic_name": topic} for topic in (*every, *TOPICS)]
    times = [{**one, "topic_name": "/odom", "start": time} for time in TIMES]
    fields = [{**one, "topic_name": topic, "fields": [path]} for topic in ("/odom", "/tf", "/image") for path in FIELDS]
    conditions = [
        {**one, "topic_name": topic, "condition": text} for topic in ("/scan", "/text") for text in CONDITIONS
    ]
    files = [{"bag": name} for name in ("empty", "no", "no.mcap", "no.db3", "text", "sub", "..", "/etc", "🤖")]
    return {
        "ros2_topic_subscribe": [*topics, *fields, *times],
        "ros2_topic_echo_wait": topics,
        "ros2_topic_stats": [{**one, "topic_names": [topic]} for topic in every],
        "ros2_topic_statistics": [{**one, "topic_names": [topic]} for topic in every],
        "ros2_topic_compare": [{**one, "topic1_name": topic, "topic2_name": f"{topic}_cut"} for topic in MESSAGES],
        "ros2_wait_until": conditions,
        "ros2_plot": [
            {**one, "series": [text]}
            for text in ("/odom", "/odom:", ":x", "/odom:pose.pose.position.x", "/scan:ranges[0]", "/text:data")
        ],
        "ros2_get_map_as_image": topics,
        "ros2_get_pointcloud_as_bev": topics,
        "ros2_bag_read": [*topics, *files],
        "ros2_bag_info": [*files, one],
        "ros2_get_messages": [{"topic_name": topic} for topic in (*every, *TOPICS)],
        "ros2_health_check": [one, *files],
        "ros2_scene": [one, *({**one, "time": time} for time in TIMES)],
        "ros2_robot": [one],
        "ros2_tf_tree": [one],
        "ros2_tf_lookup": [{**one, "target": target, "source": "base"} for target in ("map", "", "base", "🤖")],
        "ros2_log_read": [one, *({**one, "since": time} for time in TIMES)],
    }


@pytest.mark.parametrize("name", odd_calls())
async def test_no_words_of_a_library_are_in_an_answer(tools: Toolset, name: str) -> None:
    found: list[str] = []
    for arguments in odd_calls()[name]:
        said = await told(tools, name, arguments)
        found += [f"{arguments}: …{said[max(at.start() - 90, 0) : at.end() + 60]}" for at in LIBRARY.finditer(said)][:1]
    assert found == []
