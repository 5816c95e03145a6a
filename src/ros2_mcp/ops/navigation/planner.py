"""Nav2's planner, asked for one path; nothing moves."""

from __future__ import annotations

import asyncio
from collections.abc import Mapping
from contextlib import suppress
from typing import Any

from ros2_mcp.model.errors import RobotError
from ros2_mcp.model.goals import STATUS, goal_id_bytes
from ros2_mcp.model.nav2 import COMPUTE_PATH
from ros2_mcp.model.text import named
from ros2_mcp.ops.actions.send_goal import send_goal
from ros2_mcp.robot import Robot
from ros2_mcp.robot.goals import Goal
from ros2_mcp.robot.session import Session

PLAN_S = 30.0
"""Planners answer within tenths of a second; a lattice planner on a large map needs some seconds."""


class Rejected(RobotError):
    """The planner did not accept the goal."""


async def planned(robot: Robot, session: Session, action: str, goal: Mapping[str, Any]) -> Mapping[str, Any]:
    """Send a ComputePathToPose goal, and return all fields of the planner's result.

    Raises:
        Rejected: if the planner does not accept the goal.
        RobotError: what sending a goal raises, and if the planner does not answer.
    """
    sent = await send_goal(robot, session, action, COMPUTE_PATH, goal)
    if not sent.accepted:
        raise Rejected(f"{named(action)} rejected the goal. {sent.note}".rstrip())
    return await _result(robot, action, sent.goal_id)


async def _result(robot: Robot, action: str, goal_id: str) -> Mapping[str, Any]:
    """Return all fields of the planner's result."""
    try:
        answer = await robot.ask_service(
            f"{action}/_action/get_result",
            f"{COMPUTE_PATH}_GetResult",
            {"goal_id": {"uuid": goal_id_bytes(goal_id)}},
            timeout_s=PLAN_S,
        )
    except BaseException:  # cancelled or timed out: the result is no longer needed
        await asyncio.shield(_give_up(robot, goal_id))
        raise
    fields = await robot.fields_of(answer)
    robot.goal_ended(action, goal_id, STATUS.get(int(fields["status"]), ""))
    return fields["result"]


async def _give_up(robot: Robot, goal_id: str) -> None:
    goal = robot.jobs.get(Goal, goal_id)
    if goal and goal.is_running:
        with suppress(RobotError):
            await goal.request_cancel(1.0)
