"""Claude Code's model knows most tools by name only until it searches: words of a person find the right one."""

from __future__ import annotations

import subprocess
from collections.abc import Mapping

import pytest

from support.clients.claude_code import ClaudeCode
from support.clients.client import session
from support.clients.script import Call

pytestmark = [pytest.mark.full, pytest.mark.timeout(300)]

ENDS_S = 120.0
PHRASES: Mapping[str, tuple[str, ...]] = {
    "camera picture": ("ros2_topic_subscribe",),
    "laser obstacle": ("ros2_topic_subscribe", "ros2_scene"),
    "battery": ("ros2_topic_subscribe", "ros2_health_check"),
    "record": ("ros2_record_start",),
    "which nodes": ("ros2_node_list",),
    "why does it not move": ("ros2_health_check",),
    "go to the kitchen": ("ros2_navigate",),
    "move the arm": ("ros2_joint_move", "ros2_send_action_goal"),
    "take off": ("ros2_service_call",),
    "what happened": ("ros2_log_read", "ros2_get_messages"),
}
"""What a person says, and the tools that are right for it."""
SELECTED = "ros2_status"
"""A tool that is called first, since a search while the server starts finds nothing."""
ALWAYS = ("ros2_robot", "ros2_stop")


def found(tools: str, ros_environment: dict[str, str], phrases: list[str]) -> dict[str, list[str]]:
    """The first two of our tools that each phrase finds, with these groups of tools."""
    searches = [[Call("ToolSearch", {"query": phrase, "max_results": 5}, own=True)] for phrase in phrases]
    client = ClaudeCode()
    more = {"ROS2_MCP_TOOLS": tools}
    with session(client, ros_environment, [[Call(SELECTED)], *searches], options=client.allow_all, server=more) as run:
        run.ends(ENDS_S)
        results = run.model.results()[1:]
    names = [[line.removeprefix("mcp__ros2__") for line in turn[0].text.splitlines()] for turn in results]
    return {phrase: lines[:2] for phrase, lines in zip(phrases, names, strict=True)}


@pytest.mark.parametrize("tools", ["default", "all"])
def test_what_a_person_says_finds_the_right_tool_first_or_second(
    tools: str, ros_environment: dict[str, str], robot: subprocess.Popen[str]
) -> None:
    without = () if tools == "all" else ("record",)
    phrases = [phrase for phrase in PHRASES if phrase not in without]
    first_two = found(tools, ros_environment, phrases)
    assert {phrase: names for phrase, names in first_two.items() if not {*names} & {*PHRASES[phrase]}} == {}


def test_the_summary_of_the_robot_and_the_stop_need_no_search(
    ros_environment: dict[str, str], robot: subprocess.Popen[str]
) -> None:
    """`anthropic/alwaysLoad` in a tool's `_meta`: the tool is offered as soon as the server has told of it."""
    client = ClaudeCode()
    nothing = Call("ToolSearch", {"query": "select:nothing", "max_results": 1}, own=True)
    client.waiting = lambda _: nothing  # type: ignore[method-assign]
    turns = [[Call("ros2_robot")], [Call("ros2_stop")]]
    with session(client, ros_environment, turns, options=client.allow_all) as run:
        run.ends(ENDS_S)
        assert [len(turn) for turn in run.model.results()] == [1, 1]
        offered = {tool.name.removeprefix("mcp__ros2__") for tool in run.model.agent_requests[-1].tools}
    assert {name for name in offered if name.startswith("ros2_")} == {*ALWAYS}
