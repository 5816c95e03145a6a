"""What counts as not given, and what is taken at its bound: in every tool that only reads, and in no tool that acts."""

from __future__ import annotations

import re
from collections.abc import AsyncIterator, Iterator, Mapping
from pathlib import Path
from typing import Any

import pytest
from pydantic import ValidationError

from ros2_mcp.compose.server import assemble
from ros2_mcp.mcp.binding import BoundTool, CallFailed
from ros2_mcp.mcp.toolset import Toolset
from ros2_mcp.ops.results.results import silent
from ros2_mcp.settings import Settings
from ros2_mcp.tools.leniency import as_meant
from support.damaged_bags import LENGTH_S, RATE_HZ, START_NS, whole_mcap

TOOLS = list(assemble(Settings(tools=("all",))).toolset.by_name.values())
READ = [tool for tool in TOOLS if not tool.acts]
ACT = [tool for tool in TOOLS if tool.acts]


def optional(tool: BoundTool) -> Iterator[tuple[str, Mapping[str, Any]]]:
    schema = tool.listed.input_schema
    return ((name, node) for name, node in schema["properties"].items() if name not in schema.get("required", ()))


def meant(tool: BoundTool, **arguments: Any) -> tuple[dict[str, Any], list[str]]:
    return as_meant(tool.listed.input_schema, arguments, acts=tool.acts)


def faults(tool: BoundTool, taken: Mapping[str, Any]) -> list[Any]:
    """What is wrong with arguments, but for those that are missing."""
    try:
        tool.arguments.model_validate(taken)
    except ValidationError as error:
        return [fault for fault in error.errors() if fault["type"] != "missing"]
    return []


@pytest.mark.parametrize("tool", TOOLS, ids=[tool.name for tool in TOOLS])
def test_null_means_not_given_for_every_optional_argument(tool: BoundTool) -> None:
    assert meant(tool, **{name: None for name, _ in optional(tool)}) == ({}, [])


@pytest.mark.parametrize("tool", READ, ids=[tool.name for tool in READ])
@pytest.mark.parametrize("nothing", [0, "", []], ids=repr)
def test_what_the_schema_does_not_have_is_not_given_where_nothing_acts(tool: BoundTool, nothing: Any) -> None:
    for name, node in optional(tool):
        if node["type"] != "boolean":
            taken, told = meant(tool, **{name: nothing})
            assert told == [] and faults(tool, taken) == []


@pytest.mark.parametrize("tool", READ, ids=[tool.name for tool in READ])
def test_what_is_too_large_is_taken_at_its_bound_and_told_where_nothing_acts(tool: BoundTool) -> None:
    for name, node in optional(tool):
        if "maximum" in node:
            assert meant(tool, **{name: node["maximum"]}) == ({name: node["maximum"]}, [])
            taken, [told] = meant(tool, **{name: 10 * node["maximum"]})
            assert taken == {name: node["maximum"]}
            assert told == f"{name}: {10 * node['maximum']:g} is above the maximum; {node['maximum']:g} was used."


@pytest.mark.parametrize("tool", ACT, ids=[tool.name for tool in ACT])
@pytest.mark.parametrize("given", [0, "", [], 10**9], ids=repr)
def test_a_tool_that_acts_takes_what_is_given(tool: BoundTool, given: Any) -> None:
    for name, _ in optional(tool):
        assert meant(tool, **{name: given}) == ({name: given}, [])


def test_null_keeps_its_own_meaning_where_it_has_one() -> None:
    """Of a result: wait as long as it takes."""
    result = next(tool for tool in READ if tool.name == "ros2_action_request_result")
    meaning, _ = result._as_meant({"timeout_sec": None, "wait_for_service_sec": None, "action_name": "/go"})
    assert meaning == {"timeout_sec": None, "action_name": "/go"}


@pytest.mark.parametrize("empty", [[], {}, "", "[]", None], ids=repr)
def test_an_empty_request_of_a_service_may_be_written_in_every_way(empty: Any) -> None:
    service = next(tool for tool in ACT if tool.name == "ros2_service_call")
    taken, _ = meant(service, service_name="/reset", fields=empty)
    assert not service.arguments.model_validate(taken).fields  # type: ignore[attr-defined]
    assert faults(service, {"service_name": "/reset", "fields": [1]}) != []


@pytest.mark.parametrize(
    ("name", "argument"),
    [("ros2_bag_play", "topics"), ("ros2_record_start", "topics"), ("ros2_record_start", "patterns")],
)
def test_no_topics_never_means_all_where_it_acts(name: str, argument: str) -> None:
    tool = next(tool for tool in ACT if tool.name == name)
    taken, _ = meant(tool, **{argument: []})
    assert faults(tool, taken) != []


def test_a_flag_of_zero_is_not_taken_for_true() -> None:
    health = next(tool for tool in READ if tool.name == "ros2_health_check")
    assert meant(health, check_rates=0) == ({"check_rates": 0}, [])


def test_it_holds_inside_of_lists_too() -> None:
    several = next(tool for tool in READ if tool.name == "ros2_subscribe_multiple_topics")
    topics = [
        {"name": "/odom", "duration": 0, "message_limit": "", "msg_type": None},
        {"name": "/imu", "duration": "9000"},
    ]
    taken, told = meant(several, topics=topics)
    assert taken == {"topics": [{"name": "/odom"}, {"name": "/imu", "duration": 3600}]}
    assert told == ["topics[1].duration: 9000 is above the maximum; 3600 was used."]


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    made = tmp_path_factory.mktemp("bags")
    whole_mcap(made / "run")
    return made


@pytest.fixture
async def tools(folder: Path, anyio_backend: str) -> AsyncIterator[Toolset]:
    """Of a server whose robot is a recording."""
    made = assemble(Settings(bag=folder / "run"))
    yield made.toolset
    await made.store.close()


async def answer(tools: Toolset, name: str, **arguments: Any) -> tuple[str, dict[str, Any]]:
    """The readable lines and the structured answer."""
    result = await tools.call(name, arguments, silent)
    text: str = result.content[0].text  # type: ignore[union-attr]
    return text.partition("\n{")[0], result.structured_content or {}


async def test_a_call_with_empty_waits_limits_and_filters_is_one_without_them(tools: Toolset) -> None:
    empty = {"message_limit": 0, "duration": "", "fields": "", "msg_type": None, "every_n": 0, "start": 0, "end": []}
    _, plain = await answer(tools, "ros2_topic_subscribe", topic_name="/odom")
    assert await answer(tools, "ros2_topic_subscribe", topic_name="/odom", **empty) == (_, plain)
    _, listed = await answer(tools, "ros2_topic_list", pattern=[], limit=0)
    assert listed["topics"]


@pytest.mark.parametrize("name", ["ros2_topic_statistics", "ros2_topic_stats"])  # with a note of its own, and without
async def test_an_answer_tells_what_was_taken_at_its_bound(tools: Toolset, name: str) -> None:
    lines, value = await answer(tools, name, topic_names=["/odom"], duration_s=9000)
    said = "duration_s: 9000 is above the maximum; 600 was used."
    assert said in value["note"] and lines.count(said) == 1


async def test_an_answer_and_an_error_tell_how_times_were_taken(tools: Toolset) -> None:
    start_s = START_NS // 10**9
    lines, value = await answer(tools, "ros2_get_messages", topic_name="/odom", time_start=start_s)
    assert f"time_start: {start_s} is 2023-11-14T22:13:20.000000Z." in value["note"] and value["note"] in lines
    lines, value = await answer(tools, "ros2_topic_stats", topic_names=["/odom"], start="2023-11-14T22:13:20")
    assert "start: 2023-11-14T22:13:20 has no time zone and was read as UTC." in value["note"]
    with pytest.raises(
        CallFailed, match=r"start: .* has no messages in that time.* start: 2026-01-01 has no time zone"
    ):
        await answer(tools, "ros2_topic_stats", topic_names=["/odom"], start="2026-01-01")
    with pytest.raises(CallFailed, match=r"since: .* has no messages in that time"):
        await answer(tools, "ros2_log_read", since=1_767_225_600)


@pytest.mark.promise("ros2_log_read", "In a recording, seconds ago are counted from its end")
async def test_seconds_ago_in_a_recorded_log_count_back_from_its_end(tools: Toolset) -> None:
    last = LENGTH_S * RATE_HZ - 1
    _, value = await answer(tools, "ros2_log_read", since="2")
    assert [line["text"] for line in value["lines"]] == [f"line {last - ago}" for ago in range(2 * RATE_HZ, -1, -1)]
    _, value = await answer(tools, "ros2_log_read", since=2, end="1")
    assert {line["text"] for line in value["lines"]} == {
        f"line {last - ago}" for ago in range(RATE_HZ + 1, 2 * RATE_HZ + 1)
    }


async def test_the_fields_of_each_topic_are_there_on_request_and_only_then(tools: Toolset) -> None:
    _, value = await answer(tools, "ros2_topic_list", pattern="/odom", request_fields=True)
    assert value["topics"][0]["request_fields"]["pose"] == "geometry_msgs/msg/PoseWithCovariance"
    _, value = await answer(tools, "ros2_topic_list", pattern="/odom")
    assert "request_fields" not in value["topics"][0]


async def test_a_hint_says_which_of_its_tools_are_not_offered_and_how_to_have_them(folder: Path) -> None:
    default, all_of_them = (assemble(Settings(tools=groups, record_dir=folder)).toolset for groups in ((), ("all",)))
    for tools, said in (
        (
            default,
            "ros2_bag_list lists what can be read. "
            "(Not offered here: ros2_bag_list; the option --tools default,memory is needed.)",
        ),
        (all_of_them, "ros2_bag_list lists what can be read."),
    ):
        with pytest.raises(CallFailed) as refused:
            await answer(tools, "ros2_topic_stats", topic_names=["/odom"], bag="none-such")
        assert str(refused.value).endswith(f"Bags: run. {said}")


async def test_the_flow_of_all_topics_of_a_recording_is_one_call(tools: Toolset) -> None:
    _, listed = await answer(tools, "ros2_topic_list")
    _, value = await answer(tools, "ros2_topic_stats")
    assert {row["topic_name"] for row in value["topics"]} | {"/rosout"} == {
        row["topic_name"] for row in listed["topics"]
    }


@pytest.mark.parametrize("groups", [("core",), (), ("all",)], ids=str)
def test_a_description_names_only_tools_that_are_offered(groups: tuple[str, ...]) -> None:
    tools = assemble(Settings(tools=groups)).toolset
    for name, tool in tools.by_name.items():
        assert set(re.findall(r"\bros2_\w+", tool.listed.description or "")) <= tools.by_name.keys(), name
    words = tools.by_name["ros2_topic_stats"].listed.description or ""
    assert words.endswith("The largest come first." if groups == ("core",) else "use ros2_topic_statistics.")
