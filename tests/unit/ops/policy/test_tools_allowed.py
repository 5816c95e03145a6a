"""Which tools a policy leaves: told by ros2_policy, and in the description of each that is left out."""

from __future__ import annotations

import pytest

from ros2_mcp.guard.policy_file import policy_for
from ros2_mcp.guard.words import limits
from ros2_mcp.settings import Settings
from ros2_mcp.tools.declare import DECLARED

ACTING = {"ros2_drive", "ros2_navigate", "ros2_joint_move", "ros2_topic_publish", "ros2_record_start"}


@pytest.mark.parametrize(
    ("profile", "allowed"),
    [
        ("arm-slow", {"ros2_joint_move", "ros2_record_start"}),
        ("teleop-slow", {"ros2_drive", "ros2_topic_publish", "ros2_record_start"}),
        ("nav", {"ros2_drive", "ros2_navigate", "ros2_topic_publish", "ros2_record_start"}),
        ("lab", ACTING),
        ("", ACTING),
    ],
)
def test_a_tool_is_of_use_where_a_rule_allows_what_it_does(profile: str, allowed: set[str]) -> None:
    policy = policy_for(Settings(policy=(profile,) if profile else ()))
    left = {tool.name for tool in DECLARED if tool.is_of_use(policy)}
    assert left & ACTING == allowed
    assert {"ros2_stop", "ros2_topic_list", "ros2_service_call", "ros2_cancel_action_goal"} <= left


def test_two_policies_leave_what_both_allow() -> None:
    policy = policy_for(Settings(policy=("arm-slow", "teleop-slow")))
    assert {tool.name for tool in DECLARED if tool.is_of_use(policy)} & ACTING == {"ros2_record_start"}


def test_angular_limits_are_told_in_the_units_of_the_tools_too() -> None:
    (document,) = policy_for(Settings(policy=("lab",))).documents
    twist = next(line for line in limits(document.rules) if "Twist" in line)
    assert "1.5 rad/s (86 °/s)" in twist and "linear at most 1 m/s" in twist
