"""The tool that reports what the policy allows."""

from __future__ import annotations

from dataclasses import replace

from ros2_mcp.ops.policy import in_force
from ros2_mcp.robot import Robot
from ros2_mcp.tools.declare import DECLARED, tool

PLACE = 11
"""Right after the status: a model that wants to act should call it first."""


@tool(title="What is allowed", risk="read", finds="what is allowed, permissions, speed limits, forbidden, rules")
async def ros2_policy(robot: Robot) -> in_force.InForce:
    """Show what this server's policy allows, in words and numbers: topics, speeds, rates, durations, approvals. Plan
    within it; no tool changes it.
    """
    refused = [tool.name for tool in DECLARED if not tool.is_of_use(robot.policy)]
    return replace(await in_force.in_force(robot), tools_not_allowed=refused)
