"""Find the goals that run now, on every action and from any client, by the status that action servers publish."""

from __future__ import annotations

import asyncio
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace

from ros2_mcp.model.errors import RobotError
from ros2_mcp.model.goals import TERMINAL
from ros2_mcp.model.nav2 import BELOW, CANNOT_MOVE, DOCK, FOLLOW_WAYPOINTS, NAVIGATORS
from ros2_mcp.model.text import listed, named
from ros2_mcp.ops.actions.status import LATCHED_S, states_now
from ros2_mcp.robot import Robot
from ros2_mcp.robot.goals import Goal

_MOST_ACTIONS = 60
"""The most actions that are checked: three times as many as Nav2 and MoveIt have together."""
_MOST_NAMED = 3


@dataclass(frozen=True, slots=True)
class RunningGoal:
    """A goal whose action server reports that it has not ended. `from_this_server`: this server sent it.

    `delegated_to` are the actions that the server in turn uses to carry out the goal.
    """

    action_name: str
    action_type: str
    goal_id: str
    status: str
    from_this_server: bool = False
    delegated_to: Sequence[str] = ()

    @property
    def ended_by(self) -> str:
        """The tool call that ends the goal."""
        return f'ros2_cancel_action_goal(action_name="{self.action_name}", goal_id_hex="{self.goal_id}")'

    @property
    def sentence(self) -> str:
        """A sentence about the goal, with the call that ends it."""
        through = f", carried out by {listed(self.delegated_to, _MOST_NAMED)}" if self.delegated_to else ""
        whose = "this server's own" if self.from_this_server else "another client's"
        return (
            f"{named(self.action_name)} runs {whose} goal {self.goal_id} ({self.status}{through}): it may move the "
            f"robot. To end it: {self.ended_by}."
        )


async def running_goals(
    robot: Robot,
    actions: Mapping[str, Sequence[str]] | None = None,
    *,
    beside: Collection[str] = (),
    within_s: float = LATCHED_S,
) -> list[RunningGoal]:
    """Return the running goals of these actions, or of all actions, that can move a robot, except goals whose ids are
    in `beside`.

    Takes `within_s` if a server has had no goal yet; on a busy computer a status may come later than that. A dead
    server reports nothing. Raises the same errors as `Resolution.actions`.
    """
    known = await robot.types.actions() if actions is None else actions
    asked = [(name, kinds) for name, kinds in sorted(known.items()) if not CANNOT_MOVE.issuperset(kinds)]
    found = await asyncio.gather(*(_running(robot, name, kinds, within_s) for name, kinds in asked[:_MOST_ACTIONS]))
    return [goal for goals in found for goal in goals if goal.goal_id not in beside]


async def _running(robot: Robot, action: str, kinds: Sequence[str], within_s: float) -> list[RunningGoal]:
    try:
        states = await states_now(robot, action, within_s)
    except RobotError:
        return []
    running = [state for state in states if state.status_code not in TERMINAL]
    return [
        RunningGoal(
            action, kinds[0] if kinds else "", state.goal_id, state.status, _is_ours(robot, action, state.goal_id)
        )
        for state in running
    ]


def _is_ours(robot: Robot, action: str, goal_id: str) -> bool:
    goal = robot.jobs.get(Goal, goal_id)
    return goal is not None and goal.action == action


def from_above(goals: Sequence[RunningGoal]) -> list[RunningGoal]:
    """Return the goals without the goals that Nav2's servers carry out for another goal in the list. That goal names
    them in `delegated_to`; ending it ends them, too.
    """
    carried: dict[str, list[str]] = {}
    for goal in goals:
        if above := next((one for one in goals if _is_above(one, goal)), None):
            carried.setdefault(above.goal_id, []).append(goal.action_name)
    below = {name for actions in carried.values() for name in actions}
    return [
        replace(goal, delegated_to=sorted(carried.get(goal.goal_id, ())))
        for goal in goals
        if goal.action_name not in below
    ]


def _is_above(one: RunningGoal, goal: RunningGoal) -> bool:
    """Return whether the goal `goal` is carried out for the goal `one`."""
    if one.action_name.rpartition("/")[0] != goal.action_name.rpartition("/")[0]:
        return False
    if one.action_type == FOLLOW_WAYPOINTS:
        return goal.action_type in NAVIGATORS - {FOLLOW_WAYPOINTS}
    if one.action_type == DOCK:  # the docking server has the navigator drive to the place before the dock
        return goal.action_type in NAVIGATORS | BELOW - {DOCK}
    return goal.action_type != DOCK and one.action_type in NAVIGATORS and goal.action_type in BELOW
