"""Messages at time 0 have no time, and where times go back is told with the place: real files, read by the tools."""

from __future__ import annotations

import asyncio
import struct
from collections.abc import AsyncIterator, Awaitable, Callable
from pathlib import Path
from typing import Any

import pytest

from ros2_mcp.compose.server import SOURCE_KINDS
from ros2_mcp.mcp.toolset import Toolset
from ros2_mcp.ops.memory.bag_store import BagStore
from support.foreign_bags import FLOAT, START_NS, STEP_NS, Channel, number, numbers, write_db3, write_mcap
from support.made_bridge import MadeBridge, robot_of

TIME_TEXT = f"{'=' * 80}\nMSG: builtin_interfaces/Time\nint32 sec\nuint32 nanosec\n"
HEADER_TEXT = f"builtin_interfaces/Time stamp\nstring frame_id\n{TIME_TEXT}"
Ask = Callable[..., Awaitable[dict[str, Any]]]
Write = Callable[[Path, dict[str, list[int]]], Path]


def as_mcap(folder: Path, topics: dict[str, list[int]]) -> Path:
    """Float64 at these times, in this order, several chunks of them."""
    channels = [Channel(name, [number(at) for at in range(len(ns))], times_ns=ns) for name, ns in topics.items()]
    return write_mcap(folder / "odd.mcap", *channels, chunk_bytes=400)


def as_db3(folder: Path, topics: dict[str, list[int]]) -> Path:
    """The same as a database."""
    rows = [(name, FLOAT, [(ns, number(at)) for at, ns in enumerate(times)]) for name, times in topics.items()]
    return write_db3(folder / "odd.db3", rows)


@pytest.fixture
async def ask(tmp_path: Path, anyio_backend: str) -> AsyncIterator[Ask]:
    """A tool's structured result, over the recordings in the test's folder."""
    store = BagStore(tmp_path / "records", tmp_path)
    tools = Toolset(robot_of(MadeBridge()), store, ["all"], SOURCE_KINDS)

    async def call(name: str, **arguments: Any) -> dict[str, Any]:
        result = await tools.call(name, arguments, lambda *_: asyncio.sleep(0))
        assert not result.is_error, result
        return result.structured_content or {}

    yield call
    await store.close()


FILES = pytest.mark.parametrize("write", [as_mcap, as_db3])


def every(count: int, first_ns: int = START_NS) -> list[int]:
    """Times a tenth of a second apart."""
    return [first_ns + at * STEP_NS for at in range(count)]


# ── messages without a time ──────────────────────────────────────────────────────────────────────────────────────────


@FILES
async def test_messages_at_time_0_are_counted_and_named_and_belong_to_no_span(
    tmp_path: Path, ask: Ask, write: Write
) -> None:
    path = write(tmp_path, {"/speed": [0, 0, 0, *every(21)], "/other": every(5)})
    found = await ask("ros2_bag_info", bag=path.name)
    assert found["start"].startswith("2023-11-14") and found["duration_s"] == 2.0
    assert {row["topic_name"]: row["messages"] for row in found["topics"]} == {"/speed": 24, "/other": 5}
    (told,) = [problem for problem in found["problems"] if "without a time" in problem]
    assert "/speed 3" in told and "/other" not in told


@FILES
async def test_rate_statistics_and_plots_leave_messages_at_time_0_out(tmp_path: Path, ask: Ask, write: Write) -> None:
    path = write(tmp_path, {"/speed": [0, *every(21)], "/other": every(5)})
    (flow,) = (await ask("ros2_topic_stats", bag=path.name, topic_names=["/speed"]))["topics"]
    assert (flow["count"], flow["rate_hz"]) == (21, 10.0) and "1 of its messages have no time" in flow["note"]
    (values,) = (await ask("ros2_topic_statistics", bag=path.name, topic_names=["/speed"]))["topics"]
    assert (values["count"], values["fields"][0]["min"]) == (21, 1.0) and "no time" in values["note"]
    plotted = await ask("ros2_plot", bag=path.name, series=["/speed:data", "/other:data"])
    assert plotted["duration"] < 3 and plotted["series"][0]["count"] == 21 and "no time" in plotted["note"]


@FILES
async def test_where_no_message_has_a_time_they_are_read_and_have_no_rate(
    tmp_path: Path, ask: Ask, write: Write
) -> None:
    path = write(tmp_path, {"/speed": [0] * 4})
    found = await ask("ros2_bag_info", bag=path.name)
    assert (found["start"], found["duration_s"], found["messages"]) == ("", 0, 4)
    assert any("/speed 4" in problem for problem in found["problems"])
    read = await ask("ros2_bag_read", bag=path.name, topic_name="/speed")
    assert [message["data"] for message in read["messages"]] == [0, 1, 2, 3]
    (flow,) = (await ask("ros2_topic_stats", bag=path.name, topic_names=["/speed"]))["topics"]
    assert flow.get("rate_hz") is None


# ── times that go back ───────────────────────────────────────────────────────────────────────────────────────────────


@FILES
async def test_where_times_go_back_is_told_with_the_message_and_by_how_much(
    tmp_path: Path, ask: Ask, write: Write
) -> None:
    back = [*every(30), *every(30, START_NS - 60 * 10**9)]
    path = write(tmp_path, {"/speed": back, "/other": every(60)})
    found = await ask("ros2_bag_info", bag=path.name)
    (told,) = [problem for problem in found["problems"] if "go back" in problem]
    assert "/speed at message 31 by 62.9 s, to 2023-11-14T22:12:20" in told and "/other" not in told
    (flow,) = (await ask("ros2_topic_stats", bag=path.name, topic_names=["/speed"]))["topics"]
    assert "go back at message 31 by 62.9 s" in flow["note"]
    plotted = await ask("ros2_plot", bag=path.name, series=["/speed:data"])
    assert "go back at message 31 by 62.9 s" in plotted["note"]
    read = await ask("ros2_bag_read", bag=path.name, topic_name="/speed", message_limit=2)
    assert any("message 31 by 62.9 s" in problem for problem in read["problems"])


@FILES
async def test_times_that_go_back_twice_are_counted_and_those_in_order_are_not_told(
    tmp_path: Path, ask: Ask, write: Write
) -> None:
    path = write(tmp_path, {"/speed": [*every(10), *every(10), *every(10)], "/other": every(30)})
    problems = (await ask("ros2_bag_info", bag=path.name))["problems"]
    assert [problem for problem in problems if "go back" in problem and "/speed at message 11 by 0.9 s" in problem]
    assert "and 1 time more" in " ".join(problems) and "/other" not in " ".join(problems)


async def test_microseconds_that_threads_of_a_recorder_turn_around_are_not_told(tmp_path: Path, ask: Ask) -> None:
    times = every(10)
    times[5] = times[4] - 20_000
    as_mcap(tmp_path, {"/speed": times})
    assert not (await ask("ros2_bag_info", bag="odd.mcap")).get("problems")


async def test_stamps_that_go_back_are_told_with_the_message(tmp_path: Path, ask: Ask) -> None:
    seconds = [*range(100, 110), *range(50, 60)]
    messages = [b"\0\1\0\0" + struct.pack("<iII", at, 0, 2) + b"m\0" for at in seconds]
    nested = f"std_msgs/Header header\n{'=' * 80}\nMSG: std_msgs/Header\n{HEADER_TEXT}"
    whole = Channel("/header", messages, "odd_msgs/msg/Stamped", definition=nested.encode())
    write_mcap(tmp_path / "stamps.mcap", whole, numbers("/speed"))
    (flow,) = (await ask("ros2_topic_stats", bag="stamps.mcap", topic_names=["/header"]))["topics"]
    assert "stamps go back at message 11 by 59 s" in flow["note"]
