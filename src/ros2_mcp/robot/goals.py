"""Goals: the jobs that the robot itself carries out, and the command that sends one."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable, Mapping
from time import monotonic
from typing import Any

from ros2_mcp.model.commands import Answer, CancelGoals, Principal, SendGoal
from ros2_mcp.model.errors import NotFound, Stopped
from ros2_mcp.model.goals import CANCEL_TYPE
from ros2_mcp.robot.core import Core
from ros2_mcp.robot.graph import was_refused
from ros2_mcp.robot.jobs import Job
from ros2_mcp.robot.services import call

UNKNOWN_GOAL = 2
TERMINATED_GOAL = 3
"""Codes of action_msgs/srv/CancelGoal (`CANCEL_CODES`)."""
_AGAIN_S = 0.1
"""Between requests to cancel a goal that its server has yet to accept."""
CANCELLED_S = 3.0
"""A server that is alive answers within milliseconds; the end of a client does not wait longer for one that is not."""


class Goal(Job):
    """A goal that this server sent; its id is the goal's own.

    It is running until somebody has seen it end, and may move the robot until then: no process tells us of its end
    unasked. `is_accepted` is false as long as its server has not said that it takes it, and so may know nothing of it;
    `was_sent` is false once it is known that it never left.
    """

    kind = "goal"
    most_running = 1000
    """Those that nobody follows to their end would otherwise be kept for ever."""
    most_kept = 1000
    is_displaced = True
    ends_elsewhere = True
    stopped_by = "ros2_cancel_action_goal"

    def __init__(
        self,
        *,
        owner: Principal,
        goal_id: str,
        action: str,
        action_type: str,
        ask_to_cancel: Callable[[], Awaitable[Mapping[str, Any]]],
    ) -> None:
        super().__init__(owner=owner, moves=[action], job_id=goal_id)
        self.action = action
        self.action_type = action_type
        self.is_accepted = False
        self.was_sent = True
        self._ask_to_cancel = ask_to_cancel
        self._has_ended = asyncio.Event()

    async def run(self) -> None:
        """Waits until somebody has seen it end."""
        self.begun()
        await self._has_ended.wait()

    async def stop(self) -> None:
        """Asks its server to cancel it. It is running until it is seen to end, as it may move the robot until then."""
        if self.is_stopping:  # it has been given up: the bridge's fail-safe cancels it
            await self.wait()
        elif self.is_running:
            await self.request_cancel(CANCELLED_S)

    async def request_cancel(self, within_s: float) -> Mapping[str, Any]:
        """Asks its server to cancel it; the fields of the answer (`action_msgs/srv/CancelGoal`).

        What stops does not pass the policy. A server that has yet to accept the goal does not know it: it is asked
        again, for `within_s`. Raises as a `ServiceBorne`.
        """
        deadline = monotonic() + within_s
        while True:
            is_on_its_way = self.is_running and not self.is_accepted
            response = await self._ask_to_cancel()
            if response["return_code"] != UNKNOWN_GOAL or not is_on_its_way or monotonic() > deadline:
                return response
            await asyncio.sleep(_AGAIN_S)

    def has_been_seen_to_end(self) -> None:
        """Notes that it has ended, or was not accepted."""
        self._has_ended.set()

    @property
    def is_running(self) -> bool:
        """Whether it has not been seen to end: at once, and not only when its task has run."""
        return super().is_running and not self._has_ended.is_set()


async def send(core: Core, command: SendGoal) -> Answer:
    """Sends a goal that is a job before it leaves: `ros2_stop` cancels it, and the bridge does if this process dies.

    It ends at once if its server does not take it. Raises as a `ServiceBorne`.
    """
    await core.values.learn(command.type, CANCEL_TYPE)
    core.values.encode_known(f"{command.type}_Goal", command.value)  # a goal that does not fit becomes no job
    core.check_stop()
    former = core.jobs.get(Goal, command.goal_id)
    if former and former.is_running:  # its server refuses a second one of that id, and goes on with the first
        return await call(core, command)
    cancel = CancelGoals(principal=command.principal, name=command.name, goal_id=command.goal_id, timeout_s=CANCELLED_S)

    async def ask_to_cancel() -> Mapping[str, Any]:
        answer = await call(core, cancel)
        response = core.values.in_full(answer.type, answer.body)
        code = response["return_code"]
        if code == TERMINATED_GOAL or (code == UNKNOWN_GOAL and goal.is_accepted):
            ended(core, goal.id)
        return response

    goal = Goal(
        owner=command.principal,
        goal_id=command.goal_id,
        action=command.name,
        action_type=command.type,
        ask_to_cancel=ask_to_cancel,
    )
    if len(core.jobs.running(Goal)) >= Goal.most_running:  # the oldest one is forgotten, and may still be running
        core.no_known_stop.note("service", f"{command.service} ({command.service_type})")
    await core.jobs.start(goal)
    core.failsafes.leave_cancel(command.goal_id, command.name)
    try:
        await asyncio.sleep(0)  # the fail-safe's task writes first: the stream keeps the order
        answer = await call(core, command)
    except (NotFound, Stopped) as error:
        if was_refused(error):  # any other was sent, and may run: its server was out of sight for a while
            goal.was_sent = False
            ended(core, command.goal_id)
        raise
    response: Any = core.values.codec.decode(answer.type, answer.body)
    goal.is_accepted = response.accepted
    if not goal.is_accepted:
        ended(core, command.goal_id)
    return answer


def ended(core: Core, goal_id: str) -> None:
    """Notes that a goal has ended or was not accepted, if it is one of ours."""
    if goal := core.jobs.get(Goal, goal_id):
        goal.has_been_seen_to_end()
    core.failsafes.withdraw(goal_id)
