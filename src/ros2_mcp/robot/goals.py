"""Goals: the jobs that the robot itself carries out, and the command that sends one."""

from __future__ import annotations

import asyncio
import logging
from collections.abc import Awaitable, Callable, Coroutine, Mapping
from dataclasses import dataclass
from time import monotonic
from typing import Any

import anyio

from ros2_mcp.model.commands import Answer, CancelGoals, Principal, SendGoal
from ros2_mcp.model.errors import BadValue, BridgeLost, RobotError, Unreachable
from ros2_mcp.model.goals import CANCEL_TYPE, STATUS, STATUS_TYPE, TERMINAL, cancel_request, goal_id_hex
from ros2_mcp.model.qos import QoS
from ros2_mcp.model.text import named
from ros2_mcp.robot.core import Core
from ros2_mcp.robot.graph import NO_END_S, was_refused
from ros2_mcp.robot.jobs import Job
from ros2_mcp.robot.prepared import Prepared
from ros2_mcp.robot.services import call

UNKNOWN_GOAL = 2
TERMINATED_GOAL = 3
"""Codes of action_msgs/srv/CancelGoal (`CANCEL_CODES`)."""
_AGAIN_S = 0.1
"""Between requests to cancel a goal that its server has yet to accept."""
_FOLLOWED_AFTER_S = 1.0
"""A goal that is over before needs no subscription."""
_MOST_FOLLOWED = 32
"""Actions whose status is subscribed to for this, one subscription each: more than a robot carries out at a time."""
_FOLLOW_AGAIN_S = 5.0
"""Between looks whether a goal that nobody follows is to be followed now, and after a lost bridge."""
_CLOSE_S = 0.5
"""A bridge that is alive answers within milliseconds; the end of the server does not wait longer for another."""
_MOST_STATES, _MOST_STATE_BYTES = 100, 1_000_000
"""Messages of one status topic that wait; each has all goals of its action, so that the newest would do."""
_STATUS_QOS = QoS(durability="transient_local", depth=1)
"""As every action server publishes its status: whoever comes late gets the newest."""
CANCELLED_S = 3.0
"""A server that is alive answers within milliseconds; the end of a client does not wait longer for one that is not."""
_logger = logging.getLogger(__name__)


class Goal(Job):
    """A goal that this server sent; its id is the goal's own.

    It is running until somebody has seen it end, and may move the robot until then. Where nobody awaits it, that is
    `follow`, which listens to its action's status while it `is_followed`. `is_accepted` is false as long as its server
    has not said that it takes it, and so may know nothing of it; `was_sent` is false once it is known that it never
    left; `is_unanswered` where its server did not answer the last stop. `at_end` is told once of its end, and
    `ended_as` is how that was, in words.
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
        follow: Callable[[Goal], Coroutine[Any, Any, None]] | None = None,
    ) -> None:
        super().__init__(owner=owner, moves=[action], job_id=goal_id)
        self.action = action
        self.action_type = action_type
        self.is_accepted = False
        self.was_sent = True
        self.is_unanswered = False
        self.is_followed = False
        self.ended_as = ""
        self.at_end: Callable[[Goal], None] = lambda _: None
        self._ask_to_cancel = ask_to_cancel
        self._follow = follow
        self._has_ended = asyncio.Event()

    async def run(self) -> None:
        """Waits until somebody has seen it end."""
        self.begun()
        with anyio.move_on_after(_FOLLOWED_AFTER_S):
            await self._has_ended.wait()
        if self._has_ended.is_set():
            return
        async with anyio.create_task_group() as group:
            if self._follow:
                group.start_soon(self._follow, self)
            await self._has_ended.wait()
            group.cancel_scope.cancel()

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

    def has_been_seen_to_end(self, how: str = "") -> None:
        """Notes that it has ended, and how if that was seen, or was not accepted."""
        if not self._has_ended.is_set():
            self.ended_as = how or "it was not seen how"
            self._has_ended.set()
            self.at_end(self)

    @property
    def is_running(self) -> bool:
        """Whether it has not been seen to end: at once, and not only when its task has run."""
        return super().is_running and not self._has_ended.is_set()


@dataclass(frozen=True, kw_only=True, slots=True)
class CancelWhen:
    """A goal that is to be cancelled as soon as a condition on a topic holds: its own feedback (`is_of_feedback`: the
    fields are those of the feedback itself), or any other topic.
    """

    action: str
    goal_id: str
    topic: str
    topic_type: str
    condition: str
    is_of_feedback: bool = True


async def send(core: Core, prepared: Prepared[SendGoal]) -> Answer:
    """Sends a goal that is a job before it leaves: `ros2_stop` cancels it, and the bridge does if this process dies.

    It ends at once if its server does not take it.

    Raises:
        BadValue: if the id is that of a goal of another action: a stop, or a fail-safe, would find only one of the two.
        RobotError: as a `ServiceBorne` raises it.
    """
    command = prepared.command
    await core.values.learn(command.type, CANCEL_TYPE)
    await prepared.body()  # a goal that does not fit becomes no job
    core.check_stop(prepared.session)
    former = core.jobs.get(Goal, command.goal_id)
    if former and former.action != command.name:
        problem = f"{command.goal_id} is the id of a goal of {named(former.action)} already; nothing was sent."
        raise BadValue("goal_id.uuid", problem, "Give 16 random bytes.")
    if former and former.is_running:  # its server refuses a second one of that id, and goes on with the first
        core.failsafes.leave_cancel(command.goal_id, command.name)
        return await call(core, prepared)
    cancel = CancelGoals(principal=command.principal, name=command.name, goal_id=command.goal_id, timeout_s=CANCELLED_S)

    async def ask_to_cancel() -> Mapping[str, Any]:
        answer = await call(core, Prepared(core.values, prepared.session, cancel))
        response = await core.values.in_full(answer.type, answer.body)
        code = response["return_code"]
        if code == TERMINATED_GOAL or (code == UNKNOWN_GOAL and goal.is_accepted):
            ended(core, goal.action, goal.id)
        return response

    goal = Goal(
        owner=command.principal,
        goal_id=command.goal_id,
        action=command.name,
        action_type=command.type,
        ask_to_cancel=ask_to_cancel,
        follow=lambda goal: _follow(core, goal),
    )
    if len(core.jobs.running(Goal)) >= Goal.most_running:  # the oldest one is forgotten, and may still be running
        core.stops.unknown.note("service", f"{command.service} ({command.service_type})")
    await core.jobs.start(goal)
    core.failsafes.leave_cancel(command.goal_id, command.name)
    try:
        answer = await call(core, prepared)
    except RobotError as error:
        if was_refused(error):  # any other was sent, and may run: its server was out of sight for a while
            goal.was_sent = False
            ended(core, command.name, command.goal_id)
        raise
    response: Any = core.values.codec.decode(answer.type, answer.body)
    goal.is_accepted = response.accepted
    if not goal.is_accepted:
        ended(core, command.name, command.goal_id)
    return answer


async def _follow(core: Core, goal: Goal) -> None:
    """Listens to the status of the goal's action, which tells of all its goals, unless another goal does it already."""
    while True:
        followed = [other for other in core.jobs.running(Goal) if other.is_followed]
        if len(followed) < _MOST_FOLLOWED and all(other.action != goal.action for other in followed):
            goal.is_followed = True
            try:
                await _take_states(core, goal.action)
            except Exception as error:  # noqa: BLE001 - a goal that cannot be followed goes on, and must stay known
                _logger.debug("the status of %s cannot be followed: %s", goal.action, error)
            finally:
                goal.is_followed = False
        await asyncio.sleep(_FOLLOW_AGAIN_S)


async def _take_states(core: Core, action: str) -> None:
    """Notes which goals of an action have ended, as its server tells it, until this is cancelled."""
    await core.values.learn(STATUS_TYPE)
    topic = f"{action}/_action/status"
    subscription = await core.subscribe(
        topic, STATUS_TYPE, _STATUS_QOS, max_samples=_MOST_STATES, max_bytes=_MOST_STATE_BYTES
    )
    try:
        while True:
            samples = await subscription.take(_FOLLOW_AGAIN_S)
            messages: list[Any] = await core.values.decode_all(STATUS_TYPE, samples)
            for state in (state for message in messages for state in message.status_list):
                goal_id = goal_id_hex(state.goal_info.goal_id.uuid)
                if state.status in TERMINAL:
                    ended(core, action, goal_id, STATUS.get(state.status, ""))
    finally:
        with anyio.move_on_after(_CLOSE_S, shield=True):  # a scope that is cancelled cancels every await again
            await subscription.close()


@dataclass(frozen=True, slots=True)
class WhenMet:
    """What a condition was met by, and what the server of its goal said to the request to cancel it.

    `report` is that of `ros2_mcp_bridge.motion.asking.Asking`; `was_taken` whether the server cancels the goal.
    """

    report: Mapping[str, Any]
    was_taken: bool


async def cancel_when(core: Core, asked: CancelWhen, name: str) -> WhenMet:
    """Has the bridge ask a condition until it is met, and then cancel the goal; `name` is that of this asking there.

    A bridge that is lost leaves it to the next one. What stops does not pass the policy. Raises as `Graph.ask`.
    """
    await core.values.learn(CANCEL_TYPE, asked.topic_type)
    body = core.values.encode_known(f"{CANCEL_TYPE}_Request", cancel_request(asked.goal_id))
    while True:
        try:
            reply = await core.graph.ask(
                "cancel_when",
                body,
                timeout_s=NO_END_S,
                wait_s=CANCELLED_S,
                within_s=CANCELLED_S,
                name=name,
                service=f"{asked.action}/_action/cancel_goal",
                type=CANCEL_TYPE,
                topic=asked.topic,
                topic_type=asked.topic_type,
                hears=[asked.topic_type],
                condition=asked.condition,
                goal_id=asked.goal_id if asked.is_of_feedback else "",
            )
        except (BridgeLost, Unreachable):
            if core.graph.is_closed:
                raise
            await asyncio.sleep(_AGAIN_S)
        else:
            response = await core.values.in_full(f"{CANCEL_TYPE}_Response", reply.body)
            return WhenMet(reply.ok["report"], bool(response["goals_canceling"]))


def ended(core: Core, action: str, goal_id: str, how: str = "") -> None:
    """Notes that a goal of an action has ended, and how, or was not accepted, if it is one of ours."""
    goal = core.jobs.get(Goal, goal_id)
    if goal and goal.action != action:
        return  # another client's goal, with the id of one of ours
    if goal:
        goal.has_been_seen_to_end(how)
    core.failsafes.withdraw(goal_id)
