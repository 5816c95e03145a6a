"""Tools for actions: send goals, follow them, cancel them."""

from __future__ import annotations

from typing import Annotated, Any

from pydantic import Field

from ros2_mcp.ops.actions.cancel import Cancellation, cancel
from ros2_mcp.ops.actions.feedback import FeedbackMessages, follow_feedback
from ros2_mcp.ops.actions.list import ActionList, list_actions
from ros2_mcp.ops.actions.result import GoalResult, request_result
from ros2_mcp.ops.actions.send_goal import GoalOutcome, send_goal
from ros2_mcp.ops.actions.status import MAX_MESSAGES, KnownGoals, StatusFrames, all_goals, follow_status
from ros2_mcp.ops.results.results import Report
from ros2_mcp.ops.sources.selection import Selection
from ros2_mcp.robot import Robot
from ros2_mcp.robot.session import Session
from ros2_mcp.tools.arguments import Flag, Number, Pattern, Whole
from ros2_mcp.tools.declare import tool
from ros2_mcp.tools.injection import Waits
from ros2_mcp_common.wire.limits import MAX_DURATION_S

PLACE = 90

ActionName = Annotated[str, Field(description="Such as /navigate_to.")]
ActionType = Annotated[str, Field(description="Such as nav2_msgs/action/NavigateToPose. Default: the action's own.")]
GoalId = Annotated[str, Field(description="ID of the goal: 32 hexadecimal digits.")]
Duration = Annotated[Number, Field(gt=0, le=MAX_DURATION_S, description="Listening time in seconds.")]
MaxMessages = Annotated[Whole, Field(ge=1, le=MAX_MESSAGES, description="Stop after this many messages.")]
ResultTimeout = Annotated[Number | None, Field(ge=0, le=MAX_DURATION_S, description="Maximum wait in seconds.")]


@tool(title="List actions", risk="read", group="actions", finds="which actions are there, list actions, abilities")
async def ros2_list_actions(robot: Robot, pattern: Pattern = "") -> ActionList:
    """List the actions of the robot with their types and the fields of their goals."""
    return await list_actions(robot, pattern)


@tool(
    title="Send a goal",
    risk="actuate",
    does={"goal": ()},
    group="actions",
    program="goal",
    finds="gripper open or close, move the arm, dock, take off, start an action",
)
async def ros2_send_action_goal(
    robot: Robot,
    session: Session,
    report: Report,
    action_name: ActionName,
    goal_fields: Annotated[dict[str, Any], Field(description="The goal's fields.")],
    action_type: ActionType = "",
    wait_for_result: Annotated[Flag, Field(description="Wait until the goal has ended.")] = False,
    timeout_sec: ResultTimeout = 60.0,
    cancel_when: Annotated[
        str,
        Field(
            description='Cancel the goal when its feedback, or a topic ("/scan: nearest(-20, 20) < 0.4"), meets this.'
        ),
    ] = "",
    force: Annotated[Flag, Field(description="Send even if several nodes serve the action.")] = False,
) -> GoalOutcome:
    """Send a goal to an action server. Can move the robot.

    With wait_for_result, waits for the result and reports feedback as progress; after a time-out the goal continues
    (status TIMEOUT). Without it, call ros2_action_request_result with the goal_id later.
    """
    return await send_goal(
        robot,
        session,
        action_name,
        action_type,
        goal_fields,
        cancel_when=cancel_when,
        wait_for_result=wait_for_result,
        force=force,
        timeout_s=60.0 if timeout_sec is None else timeout_sec,
        report=report,
    )


@tool(title="Cancel goals", risk="actuate", group="actions", program="cancel", finds="cancel a goal, abort an action")
async def ros2_cancel_action_goal(
    robot: Robot,
    session: Session,
    action_name: ActionName,
    goal_id_hex: Annotated[str, Field(description="Required unless cancel_all is true.")] = "",
    cancel_all: Annotated[Flag, Field(description="Cancel every goal.")] = False,
    stamp_sec: Annotated[
        Whole, Field(description="Also goals accepted up to this time; with cancel_all, only those.")
    ] = 0,
    stamp_nanosec: Annotated[Whole, Field(ge=0, lt=1_000_000_000, description="Nanoseconds of that time.")] = 0,
    wait_timeout_sec: Annotated[Number, Field(gt=0, le=60, description="Maximum wait in seconds.")] = 3.0,
) -> Cancellation:
    """Ask an action server to cancel a goal, or all goals."""
    return await cancel(
        robot,
        session,
        action_name,
        goal_id_hex,
        cancel_all=cancel_all,
        stamp={"sec": stamp_sec, "nanosec": stamp_nanosec},
        timeout_s=wait_timeout_sec,
    )


@tool(
    title="Result of a goal",
    risk="read",
    group="actions",
    program="result",
    finds="result of a goal, is the action done",
)
async def ros2_action_request_result(
    robot: Robot,
    report: Report,
    action_name: ActionName,
    goal_id_hex: GoalId,
    action_type: ActionType = "",
    timeout_sec: ResultTimeout = 60.0,
    wait_for_service_sec: Annotated[
        Number, Field(ge=0, le=60, description="Maximum wait for the server, in seconds.")
    ] = 3.0,
    *,
    waits: Waits,
) -> GoalResult:
    """Wait for the result of a goal, whoever sent the goal. A time-out does not cancel the goal."""
    return await request_result(
        robot,
        action_name,
        action_type,
        goal_id_hex,
        timeout_s=timeout_sec,
        wait_for_service_s=wait_for_service_sec,
        waits=waits,
        report=report,
    )


@tool(title="Feedback of goals", risk="read", group="actions", finds="progress of a goal, action feedback")
async def ros2_action_subscribe_feedback(
    robot: Robot,
    report: Report,
    action_name: ActionName,
    action_type: ActionType = "",
    goal_id_hex: Annotated[str | None, Field(description="Only this goal. Default: every goal.")] = None,
    duration_sec: Duration = 5.0,
    max_messages: MaxMessages = 100,
    *,
    selection: Selection,
) -> FeedbackMessages:
    """Report the feedback of an action's goals for duration_sec, whoever sent the goals."""
    return await follow_feedback(
        robot,
        action_name,
        action_type,
        goal_id=goal_id_hex,
        duration_s=duration_sec,
        max_messages=max_messages,
        max_bytes=selection.max_bytes,
        report=report,
    )


@tool(
    title="Status of an action's goals", risk="read", group="actions", finds="follow the states of goals of an action"
)
async def ros2_action_subscribe_status(
    robot: Robot,
    report: Report,
    action_name: ActionName,
    duration_sec: Duration = 5.0,
    max_messages: MaxMessages = 100,
) -> StatusFrames:
    """Report state changes of an action's goals for duration_sec; the last known states come first."""
    return await follow_status(robot, action_name, duration_s=duration_sec, max_messages=max_messages, report=report)


@tool(
    title="All goals",
    risk="read",
    group="actions",
    by_default=False,
    finds="which goals are running, state of all actions",
)
async def ros2_action_status(robot: Robot) -> KnownGoals:
    """List every goal of every action with its state and age."""
    return await all_goals(robot)
