"""The tool that reads the audit."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field

from ros2_mcp.ops.audit import read as audit
from ros2_mcp.robot import Robot
from ros2_mcp.robot.session import Session
from ros2_mcp.tools.arguments import Whole
from ros2_mcp.tools.declare import tool

PLACE = 135
"""After the tools for recordings."""


@tool(
    title="What was done",
    risk="read",
    group="memory",
    by_default=False,
    finds="what was done, history of commands, audit",
)
async def ros2_audit_read(
    robot: Robot,
    session: Session,
    limit: Annotated[Whole, Field(ge=1, le=audit.MOST, description="Number of newest entries to return.")] = 50,
) -> audit.AuditExcerpt:
    """Read the audit log: what you did to this robot, what was refused and why."""
    return await audit.read(robot, session, limit)
