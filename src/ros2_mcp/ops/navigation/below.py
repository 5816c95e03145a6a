"""Ends the goals of Nav2's servers after the navigator died, hung or failed to cancel, and checks that the robot
stands.

A controller follows its path to the end, even after the navigator that sent the path is gone.
"""

from __future__ import annotations

import asyncio
import math
from collections.abc import Callable, Sequence, Set
from dataclasses import dataclass
from time import monotonic

from ros2_mcp.model.commands import CancelGoals
from ros2_mcp.model.errors import NotFound, Refused, RobotError, TimedOut
from ros2_mcp.model.nav2 import BELOW
from ros2_mcp.model.text import listed, named
from ros2_mcp.ops.actions.running import RunningGoal, running_goals
from ros2_mcp.ops.nodes.own_services import ask_node, service_of
from ros2_mcp.ops.nodes.stacks import stack_of
from ros2_mcp.ops.stop.judge import Observation
from ros2_mcp.ops.stop.observe import observe_still
from ros2_mcp.robot import Robot
from ros2_mcp.robot.goals import TERMINATED_GOAL, UNKNOWN_GOAL
from ros2_mcp.robot.session import Session

_ANSWER_S = 0.8
"""A node that spins answers within milliseconds, a busy one within some tenths of a second. Each node is asked
twice."""
_CANCELLED_S = 1.0
"""A controller handles a request to cancel between two of its steps: steps are 0.05 s apart."""
_AFTER_S = 0.3
"""Wait between a request to cancel and the next check of the running goals: a controller ends its goal with its next
step."""
_UNSEEN_ROUNDS = 2
"""Number of checks for a robot that does not report its motion."""
_STANDS_S = 30.0
"""Longest wait for a robot that stands while a goal is still running: a recovery waits for 5 s or more."""
MOST_S = 600.0
"""Longest wait while the robot moves or a goal is running: a path of 200 m at 0.4 m/s takes 500 s."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Below:
    """`ended`: actions whose goals were cancelled. `left`: a sentence for each goal that is still running. `seen`: the
    robot's motion according to its odometry and joint states."""

    ended: Sequence[str]
    left: Sequence[str]
    seen: Observation

    @property
    def stands(self) -> bool:
        """Whether no goal is running, and the robot stands or does not report its motion."""
        return not self.left and not self.seen.is_moving

    @property
    def sentence(self) -> str:
        """A summary: which goals were cancelled, whether the robot stands, and which goals are still running."""
        ended = [f"Cancelled below it: {listed(self.ended, 4)}."] if self.ended else []
        if self.seen.is_moving:
            state = f"THE ROBOT STILL MOVES: {self.seen.sentence.removeprefix('NOT observed still: ')}"
        else:
            state = f"The robot stands. {self.seen.sentence}" if self.seen.stands else self.seen.sentence
        return " ".join([*ended, state, *self.left])


async def why_lost(robot: Robot, action: str) -> str:
    """Say that the server of an action is gone or does not answer; "" if it answers, or if the graph cannot be read."""
    if not robot.graph.is_connected:
        return ""
    try:
        servers = sorted(set(await robot.graph.servers(f"{action}/_action/send_goal")))
    except RobotError:
        return ""
    if not servers:
        return f"the server of {named(action)} is gone"
    answers = await asyncio.gather(*(_answers(robot, node) for node in servers))
    if any(answers) or not robot.graph.is_connected:
        return ""
    return f"{listed(servers, 2)} does not answer: killed, frozen, or very busy"


async def idle_server(robot: Robot, action: str) -> str:
    """Say that the server of an action is a lifecycle node that is not active, and how to activate it.

    Return "" if the server is active, has no lifecycle, does not answer, or if several nodes serve the action.
    """
    kind = "lifecycle_msgs/srv/GetState"
    try:
        present = {row.name for row in await robot.graph.services() if kind in row.types}
        nodes = sorted(set(await robot.graph.servers(f"{action}/_action/send_goal")))
        asked = [node for node in nodes if service_of(node, kind) in present]
        if len(asked) != 1:
            return ""
        answer = await ask_node(robot, asked[0], kind, {}, timeout_s=_ANSWER_S, wait_s=0.0)
        state = str((await robot.fields_of(answer))["current_state"]["label"])
    except RobotError:
        return ""
    if state == "active":
        return ""
    stack = await stack_of(robot, asked[0])
    how = 'ros2_nav_recover(stack="resume")' if stack else "ros2_lifecycle_change"
    return f"{named(asked[0])} is {named(state)}: {how} activates it."


async def _answers(robot: Robot, node: str) -> bool:
    """Whether a node answers a request for no parameters (every node serves it); true if it cannot be asked."""
    for _ in range(2):  # the first answer may be lost if the node has not discovered our client yet
        try:
            kind = "rcl_interfaces/srv/GetParameters"
            await ask_node(robot, node, kind, {"names": []}, timeout_s=_ANSWER_S, wait_s=_ANSWER_S)
        except (TimedOut, NotFound):
            continue
        except RobotError:
            return True
        return True
    return False


class _Ending:
    """Cancels the goals of these kinds in the namespace of `action`, the goals of Nav2's servers below it. A goal that
    the policy refuses to cancel is not asked for again.
    """

    def __init__(self, robot: Robot, session: Session, action: str, kinds: Set[str]) -> None:
        self._robot, self._session, self._action, self._kinds = robot, session, action, kinds
        self._refused: dict[str, str] = {}
        self.ended: dict[str, None] = {}
        self.left: list[str] = []

    async def again(self) -> bool:
        """Cancel the goals that are running now; return whether any of them is ending because of that. `left` gets a
        sentence for each goal that keeps running."""
        namespace = self._action.rpartition("/")[0]
        try:
            known = await self._robot.types.actions()
            own = {name: kinds for name, kinds in known.items() if name.rpartition("/")[0] == namespace}
            running = await running_goals(
                self._robot, {name: kinds for name, kinds in own.items() if not self._kinds.isdisjoint(kinds)}
            )
        except RobotError as error:
            self.left = [f"What runs below {named(self._action)} could not be read: {error.message}"]
            return False
        told = await asyncio.gather(*map(self._end, running))
        ending = {goal.action_name for goal, why in zip(running, told, strict=True) if not why}
        self.ended |= dict.fromkeys(sorted(ending))
        self.left = [
            f"{named(goal.action_name)} continues its goal: {why.rstrip('.')}. To end it: {goal.ended_by}."
            for goal, why in zip(running, told, strict=True)
            if why
        ]
        return bool(ending)

    async def _end(self, goal: RunningGoal) -> str:
        """Cancel one goal; return why that failed, or ""."""
        if goal.status == "CANCELING":
            return ""
        if why := self._refused.get(goal.goal_id):
            return why
        principal = self._session.principal
        command = CancelGoals(principal=principal, name=goal.action_name, goal_id=goal.goal_id, timeout_s=_CANCELLED_S)
        try:
            response = await self._robot.fields_of(await self._robot.do(command, self._robot.session(principal)))
        except Refused as error:
            self._refused[goal.goal_id] = error.message
            return error.message
        except RobotError as error:
            return error.message
        is_over = bool(response["goals_canceling"]) or response["return_code"] in (UNKNOWN_GOAL, TERMINATED_GOAL)
        return "" if is_over else "its server refuses to cancel it"


async def settle(
    robot: Robot,
    session: Session,
    action: str,
    tell: Callable[[str], None],
    most_s: float = MOST_S,
    kinds: Set[str] = BELOW,
) -> Below:
    """Cancel the goals of these kinds below a navigator, and wait until the robot stands and no goal is running.

    The wait ends after `most_s`, or 30 s after the robot came to a stop. `tell` gets a sentence on the state in each
    round. Raises no `RobotError`.
    """
    end, unseen = monotonic() + most_s, 0
    ending, stands_since = _Ending(robot, session, action, kinds), math.inf
    while True:
        is_ending = await ending.again()
        await asyncio.sleep(_AFTER_S if is_ending else 0.0)
        seen = await observe_still(robot)
        found = Below(ended=list(ending.ended), left=ending.left, seen=seen)
        tell(found.sentence)
        now = monotonic()
        unseen += not (seen.stands or seen.is_moving)
        stands_since = min(stands_since, now) if seen.stands else math.inf
        is_over = found.stands and not is_ending and (seen.stands or unseen >= _UNSEEN_ROUNDS)
        if is_over or now > end or now - stands_since > _STANDS_S:
            return found
