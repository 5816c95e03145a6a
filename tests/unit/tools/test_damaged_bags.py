"""Every tool that reads a bag says what of it is damaged, with times; and no hole is laid to the robot."""

from __future__ import annotations

import asyncio
import json
import os
import re
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest

from ros2_mcp.bags.bag import Bag
from ros2_mcp.compose.server import SOURCE_KINDS
from ros2_mcp.guard.state import StateFolder
from ros2_mcp.mcp.binding import CallFailed
from ros2_mcp.mcp.toolset import Toolset
from ros2_mcp.model.times import iso_time
from ros2_mcp.ops.memory.bag_store import BagStore
from ros2_mcp.ops.results.results import AnswerBytes
from ros2_mcp.ops.sources.kinds import Sources
from ros2_mcp.ops.sources.recorded_robot import recorded_robot
from ros2_mcp.robot import Robot
from ros2_mcp.tools import TOOLS
from ros2_mcp.view.acting import Acting
from ros2_mcp.view.viewing import Viewing
from support.damaged_bags import KINDS, START_NS, whole_mcap, with_undecodable_messages
from support.made_bridge import MadeBridge, robot_of

IN_THE_HOLE = "in the hole"
"""As the time of a start: the middle of the damaged part."""
READERS: dict[str, dict[str, Any]] = {
    "ros2_topic_subscribe": {"topic_name": "/odom", "duration": 100},
    "ros2_subscribe_multiple_topics": {"topics": [{"name": "/odom", "duration": 100}, {"name": "/imu", "duration": 9}]},
    "ros2_topic_echo_wait": {"topic_name": "/odom", "start": IN_THE_HOLE},
    "ros2_topic_stats": {"topic_names": ["/odom", "/imu"]},
    "ros2_wait_until": {"topic_name": "/odom", "condition": "pose.pose.position.x > 1000"},
    "ros2_health_check": {"expected_topics": ["/odom"]},
    "ros2_topic_statistics": {"topic_names": ["/odom", "/imu"]},
    "ros2_topic_compare": {"topic1_name": "/odom", "topic2_name": "/odom_again"},
    "ros2_plot": {"series": ["/odom:pose.pose.position.x"]},
    "ros2_get_map_as_image": {"topic_name": "/map", "start": IN_THE_HOLE},
    "ros2_get_pointcloud_as_bev": {"topic_name": "/cloud", "start": IN_THE_HOLE},
    "ros2_scene": {"time": IN_THE_HOLE},
    "ros2_view": {"time": IN_THE_HOLE},
    "ros2_log_read": {},
    "ros2_bag_info": {},
    "ros2_bag_read": {"topic_name": "/odom", "start": "10 s in", "message_limit": 400},
}
"""Every tool with an argument `bag`, and what it is asked."""
PLAYS = {"ros2_bag_play"}
"""Tools that do not answer from a bag; tests/unit/ops/memory/test_play.py has what they say."""
ASKED_ELSEWHERE = {"ros2_robot", "ros2_tf_lookup", "ros2_tf_tree"}
"""Tools that need other topics than these bags have; what they say of damage is in tests/unit/ops/space."""
LAID_TO_THE_ROBOT = re.compile(r"jump|stuck|nothing for|silence|stopped|interrupted|slow|no partner", re.IGNORECASE)
TIME = re.compile(r"2023-11-14T22:1\d:\d\d\.\d{6}Z")


def test_every_tool_that_takes_a_bag_is_asked_here() -> None:
    found = {tool.name for tool in TOOLS if "bag" in tool.arguments().parameters}
    assert found - PLAYS - ASKED_ELSEWHERE == READERS.keys()


@dataclass(frozen=True)
class Damaged:
    """A folder with a damaged bag, and a time in its hole."""

    folder: Path
    hole_ns: int


@pytest.fixture(scope="module", params=KINDS)
def damaged(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Damaged:
    folder = tmp_path_factory.mktemp("bags")
    KINDS[request.param](folder / "run")
    with Bag(folder / "run") as bag:
        assert list(bag.messages())
        hole = bag.holes[0]
    return Damaged(folder, (hole.start_ns + hole.end_ns) // 2)


def tools_of(robot: Robot, store: BagStore) -> Toolset:
    """All tools, with pages of a robot that no server acts on."""
    viewing = Viewing(Sources(robot, store, SOURCE_KINDS), "", Acting(StateFolder(Path(os.devnull))))
    return Toolset(robot, store, ["all"], SOURCE_KINDS, viewing=viewing)


async def answer_of(
    tools: Toolset, name: str, arguments: dict[str, Any], hole_ns: int = START_NS
) -> tuple[str, dict[str, Any]]:
    """The summary and the structured answer; asked again as long as a busy machine had no time to read all."""
    arguments = {key: iso_time(hole_ns) if value == IN_THE_HOLE else value for key, value in arguments.items()}
    while True:
        result = await tools.call(name, arguments, lambda *_: asyncio.sleep(0))
        text: str = result.content[0].text  # type: ignore[union-attr]
        if "Only a part of the bag was read in " not in text:
            return text.partition("\n{")[0], result.structured_content or {}


@pytest.mark.promise("ros2_bag_info", "and which parts are damaged or missing")
@pytest.mark.parametrize("name", READERS)
async def test_it_says_which_times_are_lost_and_lays_no_hole_to_the_robot(damaged: Damaged, name: str) -> None:
    store = BagStore(damaged.folder)
    tools = tools_of(robot_of(MadeBridge()), store)
    summary, structured = await answer_of(tools, name, {**READERS[name], "bag": "run"}, damaged.hole_ns)
    await store.close()
    told = structured["damage"] if "damage" in structured else structured["problems"]
    assert any("are lost" in line and TIME.search(line) for line in told), told
    assert all(line in summary for line in told)
    findings = [line for line in summary.splitlines() if line not in told and not line.startswith("Damage: ")]
    assert [line for line in findings if LAID_TO_THE_ROBOT.search(line) and "damage" not in line] == []


@pytest.mark.parametrize("name", READERS)
async def test_so_does_a_recording_that_stands_for_the_robot(damaged: Damaged, name: str) -> None:
    store = BagStore(damaged.folder, subject=damaged.folder / "run")
    tools = tools_of(recorded_robot(store, [AnswerBytes(32_000)]), store)
    named = {"bag": "run"} if name.startswith("ros2_bag") else {}
    summary, _ = await answer_of(tools, name, {**READERS[name], **named}, damaged.hole_ns)
    await store.close()
    assert "are lost" in summary


async def test_messages_of_the_past_come_with_the_damage_of_where_they_are_from(damaged: Damaged) -> None:
    store = BagStore(damaged.folder, subject=damaged.folder / "run")
    tools = tools_of(recorded_robot(store, [AnswerBytes(32_000)]), store)
    summary, structured = await answer_of(tools, "ros2_get_messages", {"topic_name": "/odom"})
    await store.close()
    assert "are lost" in summary and structured["damage"]


async def test_the_newest_messages_come_with_the_damage_behind_them(tmp_path: Path) -> None:
    path = whole_mcap(tmp_path / "run")
    whole = bytearray(path.read_bytes())
    whole[len(whole) * 9 // 10] ^= 0xFF  # in one of the ten chunks that have the newest 200 messages
    path.write_bytes(whole)
    store = BagStore(tmp_path, subject=tmp_path / "run")
    tools = tools_of(recorded_robot(store, [AnswerBytes(32_000)]), store)
    asked = {"topic_name": "/odom", "number_of_messages": 200}
    summary, structured = await answer_of(tools, "ros2_get_messages", asked)
    await store.close()
    assert "are lost" in summary and any("are lost" in line for line in structured["damage"])


async def test_topics_of_which_damage_left_nothing_are_not_said_to_be_silent(damaged: Damaged) -> None:
    store = BagStore(damaged.folder)
    tools = tools_of(robot_of(MadeBridge()), store)
    with store.reading("run") as bag:
        assert list(bag.messages())
        start_ns, end_ns = bag.holes[0].start_ns, bag.holes[0].end_ns
    quarter_ns = (end_ns - start_ns) // 4
    span = {"start": iso_time(start_ns + quarter_ns), "end": iso_time(end_ns - quarter_ns)}
    asked = {**READERS["ros2_topic_compare"], "bag": "run", **span}
    summary, structured = await answer_of(tools, "ros2_topic_compare", asked)
    await store.close()
    assert structured["reasons"] == [
        "Nothing was compared: the recording is damaged, and no message of /odom and /odom_again can be read."
    ]
    assert "are lost" in summary and "sent nothing" not in summary


async def test_an_error_names_the_damage_too(damaged: Damaged) -> None:
    store = BagStore(damaged.folder)
    tools = tools_of(robot_of(MadeBridge()), store)
    await answer_of(tools, "ros2_topic_stats", {"topic_names": ["/odom"], "bag": "run"})
    with pytest.raises(CallFailed, match="are lost"):
        await answer_of(tools, "ros2_get_map_as_image", {"topic_name": "/odom", "bag": "run"})
    await store.close()


async def test_of_a_whole_bag_no_damage_is_told(tmp_path: Path) -> None:
    whole_mcap(tmp_path / "run")
    store = BagStore(tmp_path)
    tools = tools_of(robot_of(MadeBridge()), store)
    for name, arguments in READERS.items():
        summary, structured = await answer_of(tools, name, {**arguments, "bag": "run"})
        assert "lost" not in json.dumps(structured.get("problems", [])) and "damage" not in structured, name
        assert not LAID_TO_THE_ROBOT.search(summary), summary
    await store.close()


DECODE_NOTHING = {"ros2_topic_stats", "ros2_bag_info"}
"""Tools for which all messages are bytes."""


@pytest.mark.parametrize("name", [name for name in READERS if name not in DECODE_NOTHING])
async def test_a_message_that_cannot_be_decoded_is_skipped_counted_and_told(tmp_path: Path, name: str) -> None:
    bad_ns = with_undecodable_messages(tmp_path / "run")
    store = BagStore(tmp_path)
    tools = tools_of(robot_of(MadeBridge()), store)
    arguments = {**READERS[name], "bag": "run", "max_array": 1}
    if name in ("ros2_topic_subscribe", "ros2_subscribe_multiple_topics", "ros2_bag_read"):
        arguments |= {"start": iso_time(bad_ns), "end": iso_time(bad_ns + 200_000_000)}  # few enough to show all
    else:
        del arguments["max_array"]
    summary, _ = await answer_of(tools, name, arguments, bad_ns)
    await store.close()
    assert "1 message that cannot be decoded" in summary
