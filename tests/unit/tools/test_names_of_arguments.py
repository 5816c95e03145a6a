"""Each concept has one name in the schemas, where existing configurations do not fix another; other names are taken."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import pytest
from generate import served_tools

from ros2_mcp.tools import TOOLS

FIXED: Mapping[str, Sequence[str]] = {
    "duration": ("ros2_topic_subscribe", "ros2_topic_publish"),
    "duration_sec": (
        "ros2_action_subscribe_feedback",
        "ros2_action_subscribe_status",
        "ros2_relay_start",
        "ros2_topic_compare",
    ),
    "rate_check_duration_sec": ("ros2_health_check",),
    "timeout": ("ros2_topic_echo_wait", "ros2_get_pointcloud_as_bev"),
    "timeout_sec": ("ros2_service_call", "ros2_send_action_goal", "ros2_action_request_result"),
    "wait_timeout_sec": ("ros2_cancel_action_goal",),
    "wait_for_service_sec": ("ros2_action_request_result",),
    "stamp_sec": ("ros2_cancel_action_goal",),
    "stamp_nanosec": ("ros2_cancel_action_goal",),
}
"""Names of times that configurations of other servers have in these tools, or in the prompts that lead to them."""
SCHEMAS = {tool.name: tool.input_schema["properties"] for tool in served_tools()}


def test_times_are_in_seconds_and_say_so_in_their_names() -> None:
    odd = {
        (name, tool)
        for tool, arguments in SCHEMAS.items()
        for name in arguments
        if name.startswith(("duration", "timeout", "wait_", "max_duration")) or name.endswith(("_sec", "nanosec"))
        if not name.endswith("_s") and name != "wait_for_result"
    }
    assert odd == {(name, tool) for name, tools in FIXED.items() for tool in tools}


@pytest.mark.parametrize("name", ["node", "nodes", "msg_count", "recording", "playback", "service", "action", "topic"])
def test_names_of_things_have_no_short_form_beside_them(name: str) -> None:
    assert [tool for tool, arguments in SCHEMAS.items() if name in arguments] == []


def test_former_names_lead_to_arguments_that_there_are() -> None:
    for tool in TOOLS:
        for former, name in tool.aliases.items():
            known = SCHEMAS.get(tool.name)
            assert known is None or not name or name in known, (tool.name, former)
            assert known is None or former not in known
