"""Goals: jobs that the robot itself carries out, and the command that sends a goal."""

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
"""Return codes of action_msgs/srv/CancelGoal (`CANCEL_CODES`)."""
_AGAIN_S = 0.1
"""The pause between requests to cancel a goal that its server has not accepted yet, in s."""
_FOLLOWED_AFTER_S = 1.0
"""The time after which a goal's status is subscribed to, in s: a shorter goal needs no subscription."""
_MOST_FOLLOWED = 32
"""The most actions whose status is subscribed to, with one subscription each: more than a robot runs at a time."""
_FOLLOW_AGAIN_S = 5.0
"""The period at which a goal checks whether to subscribe to its status, in s; also the pause after a lost bridge."""
_CLOSE_S = 0.5
"""The time limit for unsubscribing, in s: a bridge that lives answers within milliseconds, and the end of the server
does not wait longer for another."""
_MOST_STATES, _MOST_STATE_BYTES = 100, 1_000_000
"""Bounds on the waiting messages of one status topic. Each has all goals of the action, so the newest would do."""
_STATUS_QOS = QoS(durability="transient_local", depth=1)
"""The QoS with which every action server publishes its status: a late subscriber gets the newest message."""
CANCELLED_S = 3.0
"""The time limit for an action server's response to a cancel request, in s: a server that lives responds within
milliseconds, and a disconnecting client does not wait longer for another."""
_logger = logging.getLogger(__name__)


class Goal(Job):
    """A goal that this server sent; the job's id is the goal id.

    The job runs until the goal was observed to end, because it may move the robot until then. If no caller awaits the
    result, `follow` observes it: it subscribes to the status of the action while `is_followed`. `is_accepted` is false
    until the action server has accepted the goal: before that, the server may not know it. `was_sent` is false once the
    goal is known not to be sent; `is_unanswered` is true if the server did not answer the last stop. `at_end` is called
    once at the end, and `ended_as` describes the end in words.
    """

    kind = "goal"
    most_running = 1000
    """The most running goals that are kept: goals whose end is never observed must not accumulate."""
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
        """Wait until the goal was observed to end."""
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
        """Ask the action server to cancel the goal. The job runs until the goal was observed to end, because it may
        move the robot until then.
        """
        if self.is_stopping:  # the job was abandoned: the bridge's fail-safe cancels the goal
            await self.wait()
        elif self.is_running:
            await self.request_cancel(CANCELLED_S)

    async def request_cancel(self, within_s: float) -> Mapping[str, Any]:
        """Ask the action server to cancel the goal, and return the fields of the response
        (`action_msgs/srv/CancelGoal`).

        A cancellation does not pass the policy. A server that has not accepted the goal yet does not know it, and is
        asked again for up to `within_s` seconds. Raises as a `ServiceBorne`.
        """
        deadline = monotonic() + within_s
        while True:
            is_on_its_way = self.is_running and not self.is_accepted
            response = await self._ask_to_cancel()
            if response["return_code"] != UNKNOWN_GOAL or not is_on_its_way or monotonic() > deadline:
                return response
            await asyncio.sleep(_AGAIN_S)

    def has_been_seen_to_end(self, how: str = "") -> None:
        """Record that the goal has ended or was not accepted, and how, if known."""
        if not self._has_ended.is_set():
            self.ended_as = how or "it was not seen how"
            self._has_ended.set()
            self.at_end(self)

    @property
    def is_running(self) -> bool:
        """Whether the goal was not observed to end yet. Changes at once, before the job's task ends."""
        return super().is_running and not self._has_ended.is_set()


@dataclass(frozen=True, kw_only=True, slots=True)
class CancelWhen:
    """A goal to be cancelled as soon as a condition on a topic holds.

    The topic is the goal's own feedback (`is_of_feedback`: the condition's fields are those of the feedback itself), or
    any other topic.
    """

    action: str
    goal_id: str
    topic: str
    topic_type: str
    condition: str
    is_of_feedback: bool = True


async def send(core: Core, prepared: Prepared[SendGoal]) -> Answer:
    """Send a goal. It becomes a job before it is sent, so that `ros2_stop` cancels it, and the bridge does if this
    process dies. The job ends at once if the action server rejects the goal.

    Raises:
        BadValue: if a goal of another action has this id: a stop or a fail-safe would find only one of the two.
        RobotError: as a `ServiceBorne`.
    """
    command = prepared.command
    await core.values.learn(command.type, CANCEL_TYPE)
    await prepared.body()  # a goal with an invalid value becomes no job
    core.check_stop(prepared.session)
    former = core.jobs.get(Goal, command.goal_id)
    if former and former.action != command.name:
        problem = f"{command.goal_id} is the id of a goal of {named(former.action)} already; nothing was sent."
        raise BadValue("goal_id.uuid", problem, "Give 16 random bytes.")
    if former and former.is_running:  # the server rejects a second goal with this id, and continues the first
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
    if len(core.jobs.running(Goal)) >= Goal.most_running:  # the oldest goal is forgotten, and may still run
        core.stops.unknown.note("service", f"{command.service} ({command.service_type})")
    await core.jobs.start(goal)
    core.failsafes.leave_cancel(command.goal_id, command.name)
    try:
        answer = await call(core, prepared)
    except RobotError as error:
        if was_refused(error):  # after any other error the goal may have been sent, and may run
            goal.was_sent = False
            ended(core, command.name, command.goal_id)
        raise
    response: Any = core.values.codec.decode(answer.type, answer.body)
    goal.is_accepted = response.accepted
    if not goal.is_accepted:
        ended(core, command.name, command.goal_id)
    return answer


async def _follow(core: Core, goal: Goal) -> None:
    """Subscribe to the status of the goal's action, unless another goal's job has done so."""
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
    """Record the goals of an action that have ended, as its server reports them, until cancelled."""
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
        with anyio.move_on_after(_CLOSE_S, shield=True):  # a cancelled scope cancels every await again
            await subscription.close()


@dataclass(frozen=True, slots=True)
class WhenMet:
    """The report of a met condition, and the response to the cancel request.

    `report` is that of `ros2_mcp_bridge.motion.asking.Asking`; `was_taken` is whether the action server cancels the
    goal, `is_unknown` whether it does not know the goal: it may not have accepted it yet.
    """

    report: Mapping[str, Any]
    was_taken: bool
    is_unknown: bool = False


async def cancel_when(core: Core, asked: CancelWhen, name: str) -> WhenMet:
    """Have the bridge evaluate a condition until it holds, and then cancel the goal. `name` identifies this request in
    the bridge.

    If the bridge is lost, the next one continues. A cancellation does not pass the policy. Raises as `Graph.ask`.
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
            is_unknown = response["return_code"] == UNKNOWN_GOAL
            return WhenMet(reply.ok["report"], bool(response["goals_canceling"]), is_unknown)


def ended(core: Core, action: str, goal_id: str, how: str = "") -> None:
    """Record that a goal of this action has ended or was not accepted, and how, if this server sent it."""
    goal = core.jobs.get(Goal, goal_id)
    if goal and goal.action != action:
        return  # another client's goal, with the id of one of ours
    if goal:
        goal.has_been_seen_to_end(how)
    core.failsafes.withdraw(goal_id)
