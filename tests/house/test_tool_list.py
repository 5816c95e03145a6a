"""What clients and users rely on: the tools' list and its documentation are never out of date."""

from __future__ import annotations

import asyncio
import re

import pytest
from generate import REFERENCE, SETTINGS, SNAPSHOT, reference, served_tools, settings_reference, snapshot

from ros2_mcp.compose.server import Assembly, assemble
from ros2_mcp.mcp.binding import CallFailed
from ros2_mcp.ops.results.results import silent
from ros2_mcp.settings import Settings
from ros2_mcp.tools import TOOLS
from support.source import ROOT

LESS = (
    "measure",
    "programs",
    "pictures",
    "services",
    "actions",
    "parameters",
    "memory",
    "space",
    "motion",
    "view",
    "navigation",
)
OUT_OF_DATE = "run: python docs/generate.py, look at the difference, and commit it"


def made(*groups: str, read_only: bool = False) -> Assembly:
    return assemble(Settings(tools=groups, read_only=read_only))


def listed(*groups: str, read_only: bool = False) -> list[str]:
    return list(made(*groups, read_only=read_only).toolset.by_name)


def test_the_list_of_tools_is_as_its_snapshot() -> None:
    assert SNAPSHOT.read_text(encoding="utf-8") == snapshot(served_tools()), OUT_OF_DATE


@pytest.mark.promise("README", "Every argument and every field of every result is in the reference")
def test_the_reference_describes_the_tools_as_they_are() -> None:
    assert REFERENCE.read_text(encoding="utf-8") == reference(served_tools()), OUT_OF_DATE


def test_the_reference_describes_the_settings_as_they_are() -> None:
    assert SETTINGS.read_text(encoding="utf-8") == settings_reference(), OUT_OF_DATE


@pytest.mark.promise("README", "Every argument and every field of every result is in the reference")
def test_every_tool_is_described_in_the_reference() -> None:
    text = REFERENCE.read_text(encoding="utf-8")
    assert [tool.name for tool in TOOLS if f"\n## {tool.name}\n" not in text] == []


@pytest.mark.promise("README", "--tools all offers everything")
def test_the_order_of_tools_is_the_order_of_their_declaration() -> None:
    assert listed("all") == [tool.name for tool in TOOLS]


@pytest.mark.promise("README", "tools that write are absent, not refused")
def test_a_read_only_server_has_no_tool_that_writes() -> None:
    assert listed("all", read_only=True) == [
        tool.name
        for tool in TOOLS
        if tool.risk == "read" or tool.runs_programs  # which only reads there
    ]


def test_a_server_without_chosen_groups_has_the_default_tools() -> None:
    assert listed(*Settings().tools) == [tool.name for tool in TOOLS if tool.by_default]


def test_a_group_can_be_added_to_the_default_tools() -> None:
    chosen = [tool.name for tool in TOOLS if tool.by_default or tool.group == "lifecycle"]
    assert listed("default", "lifecycle") == chosen


def test_a_server_has_only_the_groups_that_were_chosen() -> None:
    assert listed("core") == [tool.name for tool in TOOLS if tool.group == "core"]


@pytest.mark.parametrize("made_of", [made(), made(read_only=True)], ids=["default", "read-only"])
def test_what_a_model_reads_before_it_calls_names_only_tools_that_are_offered(made_of: Assembly) -> None:
    offered = made_of.toolset.by_name
    texts = [f"{tool.listed.description} {tool.listed.input_schema}" for tool in offered.values()]
    named = set(re.findall(r"\bros2_\w+", f"{made_of.server.instructions} {texts}"))
    assert named <= offered.keys()


def test_a_server_says_which_groups_have_tools_that_are_left_out() -> None:
    assert "--tools all adds them: lifecycle, relay." in str(made("core", *LESS).server.instructions)
    assert "left out" not in str(made("all", read_only=True).server.instructions)


@pytest.mark.promise("README", "the agent is told to look")
def test_the_agent_is_told_to_look_whether_the_robot_moved() -> None:
    assert "read odometry and sensors to verify what happened" in " ".join(str(made().server.instructions).split())


def test_the_module_of_programs_follows_the_groups_and_what_is_allowed() -> None:
    def functions(*groups: str, read_only: bool = False) -> set[str]:
        return {each.name for each in made(*groups, read_only=read_only).toolset.functions()}

    assert {"publish", "goal", "feedback", "drive", "turn", "stop", "latest", "mean"} <= functions()
    assert functions("core", "programs").isdisjoint({"goal", "feedback", "drive", "turn", "call", "set_parameter"})
    assert {"publish", "latest"} <= functions("core", "programs")
    reads = functions("all", read_only=True)
    assert {"latest", "tf", "statistics"} <= reads
    assert reads.isdisjoint({"publish", "goal", "feedback", "drive", "turn", "call", "stop", "set_parameter"})


def test_a_tool_that_there_is_not_is_refused_with_the_nearest_name() -> None:
    with pytest.raises(CallFailed, match=r"There is no tool ros2_topic_lists\. Did you mean ros2_topic_list\?"):
        asyncio.run(made().toolset.call("ros2_topic_lists", {}, silent))


@pytest.mark.promise("README", "find its way: ros2_")
@pytest.mark.promise("README", "read: ros2_")
@pytest.mark.promise("README", "measure: ros2_")
@pytest.mark.promise("README", "see: ros2_")
@pytest.mark.promise("README", "locate: ros2_")
@pytest.mark.promise("README", "remember: ros2_")
@pytest.mark.promise("README", "publish: ros2_")
@pytest.mark.promise("README", "call services: ros2_")
@pytest.mark.promise("README", "drive actions: ros2_")
@pytest.mark.promise("README", "configure nodes: ros2_")
@pytest.mark.promise("README", "stop: ros2_stop")
def test_readme_names_the_default_tools_and_for_every_other_one_its_group() -> None:
    rows = re.findall(
        r"^\| [^|]+ \|([^|]*`ros2_[^|]*)\|([^|]*)\|$", (ROOT / "README.md").read_text("utf-8"), re.MULTILINE
    )
    default = {name for always, _ in rows for name in re.findall(r"ros2_\w+", always)}
    more = [part for _, groups in rows for part in re.findall(r"`(\w+)`: ([^;|]+)", groups)]
    by_group: dict[str, list[tuple[str, str]]] = {}
    for group, names in more:
        by_group.setdefault(group, []).extend(re.findall(r"(ros2_\w+)(…?)", names))
    assert default == {tool.name for tool in TOOLS if tool.by_default}
    for tool in TOOLS:
        named = [
            name
            for name, rest in by_group.get(tool.group, [])
            if tool.name.startswith(name) and (rest or tool.name == name)
        ]
        assert tool.by_default or named, f"{tool.name} of the group {tool.group} is missing in README"


@pytest.mark.promise("ros2_topic_publish", "Can move the robot")
@pytest.mark.promise("ros2_service_call", "Can move the robot")
@pytest.mark.promise("ros2_send_action_goal", "Can move the robot")
@pytest.mark.promise("ros2_relay_start", "Can move the robot")
@pytest.mark.promise("README", "and a client can ask its user before the latter")
def test_a_tool_says_that_it_can_move_the_robot_exactly_if_its_annotations_do() -> None:
    declared = {tool.name: tool.risk for tool in TOOLS}
    for tool in served_tools():
        assert tool.annotations is not None
        acts = declared[tool.name] == "actuate"
        assert ("an move the robot" in (tool.description or "")) <= acts, tool.name
        assert tool.annotations.destructive_hint == acts or not acts, tool.name
