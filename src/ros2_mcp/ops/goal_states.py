"""The states of an action's goals, as its server tells them on the latched topic `<action>/_action/status`."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from ros2_mcp.model.errors import NotFound
from ros2_mcp.model.goals import STATUS, goal_id_hex
from ros2_mcp.model.samples import Sample
from ros2_mcp.robot import Robot

STATUS_TYPE = "action_msgs/msg/GoalStatusArray"
_LATCHED_S = 0.5


@dataclass(frozen=True, slots=True)
class GoalState:
    """A goal and its state as its server tells it; `accept_stamp` is {sec, nanosec}."""

    goal_id: str
    accept_stamp: dict[str, Any]
    status_code: int
    status: str


async def states_now(robot: Robot, action: str) -> list[GoalState]:
    """The newest states; none where the server has not told of any goal."""
    try:
        async with robot.listen(f"{action}/_action/status", STATUS_TYPE, keep="latest") as heard:
            samples = await heard.take(_LATCHED_S)
    except NotFound:
        return []
    return states_in(robot, samples[-1]) if samples else []


def states_in(robot: Robot, sample: Sample) -> list[GoalState]:
    """The states in one message of the topic."""
    from ros2_mcp.codec.render import RenderOptions

    message: Mapping[str, Any] = robot.values.render(STATUS_TYPE, sample.data, RenderOptions(exact=True)).value
    return [
        GoalState(
            goal_id_hex(entry["goal_info"]["goal_id"]["uuid"]),
            entry["goal_info"]["stamp"],
            int(entry["status"]),
            STATUS.get(int(entry["status"]), str(entry["status"])),
        )
        for entry in message["status_list"]
    ]
