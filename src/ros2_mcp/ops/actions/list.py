"""Actions: which there are, and what their goals do, whoever sent them: states, feedback, all at a glance."""

from __future__ import annotations

import asyncio
import time
from collections.abc import AsyncIterator, Mapping, Sequence
from dataclasses import dataclass
from time import monotonic
from typing import Any

from ros2_mcp.guard.policy import bounded
from ros2_mcp.model import names
from ros2_mcp.model.errors import BadInput, NotFound, UnknownInterface
from ros2_mcp.model.goals import STATUS, TERMINAL, goal_id_bytes, goal_id_hex, stamp_seconds
from ros2_mcp.model.samples import Sample
from ros2_mcp.ops.results import Report, iso_time, reporting, silent
from ros2_mcp.robot import Listening, Robot
from ros2_mcp.robot.sent_goals import Goal
from ros2_mcp_bridge.limits import MAX_DURATION_S

STATUS_TYPE = "action_msgs/msg/GoalStatusArray"
"""Of the latched topic `<action>/_action/status`, where a server tells the states of its goals."""
SERVER_S = 3.0
"""For an action server that is coming up: its services are seen one after the other, within 3 s of each other."""
_LATCHED_S = 0.5
"""The latched message comes with the matching, within milliseconds; a server that has had no goal has none."""
_OTHER_CLOCK_S = 1e8
"""Three years: a stamp so far from now is of a clock that began at zero, as in a simulation."""


@dataclass(frozen=True, slots=True)
class ActionEntry:
    """One action; `request_fields` is name → type of its goal."""

    name: str
    types: Sequence[str]
    request_fields: dict[str, Any]


@dataclass(frozen=True, slots=True)
class ActionList:
    """The actions that have a server."""

    actions: Sequence[ActionEntry]

    def summary(self) -> str:
        """One line."""
        return f"{len(self.actions)} action(s)."


async def list_actions(robot: Robot, pattern: str = "") -> ActionList:
    """The actions with their types and the fields of their goals."""
    known = await robot.types.actions()
    chosen = names.matching(sorted(known), pattern)
    return ActionList([ActionEntry(name, known[name], await _goal_fields(robot, known[name][0])) for name in chosen])


async def _goal_fields(robot: Robot, action_type: str) -> dict[str, Any]:
    try:
        await robot.values.learn(action_type)
    except UnknownInterface:
        return {}
    return robot.values.field_types(f"{action_type}_Goal")


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


@dataclass(frozen=True, slots=True)
class FeedbackMessage:
    """One feedback message of one goal; `recv_stamp` is ISO 8601."""

    goal_id: str
    feedback: dict[str, Any]
    recv_stamp: str


@dataclass(frozen=True, slots=True)
class FeedbackMessages:
    """The feedback of an action over a while, of one goal or of all."""

    topic: str
    action_type: str
    goal_id_filter: str | None
    duration_sec: float
    messages: Sequence[FeedbackMessage]
    omitted: int
    note: str

    def summary(self) -> str:
        """One line."""
        return f"{len(self.messages)} feedback message(s) in {self.duration_sec:.2f} s. {self.note}".rstrip()


@dataclass(frozen=True, slots=True)
class StatusFrame:
    """All goals of one action at one moment; `stamp` is the time of receipt, ISO 8601."""

    stamp: str
    statuses: Sequence[GoalState]


@dataclass(frozen=True, slots=True)
class StatusFrames:
    """How the goals of an action changed over a while."""

    topic: str
    duration_sec: float
    frames: Sequence[StatusFrame]
    note: str

    def summary(self) -> str:
        """One line."""
        return f"{len(self.frames)} status message(s) in {self.duration_sec:.2f} s. {self.note}".rstrip()


@dataclass(frozen=True, slots=True)
class KnownGoal:
    """A goal of any action; `ours` if this server sent it. `age_sec` since it was accepted is null where the action
    server keeps another time than this machine, as in a simulation.
    """

    action_name: str
    goal_id: str
    status_code: int
    status: str
    age_sec: float | None
    ours: bool


@dataclass(frozen=True, slots=True)
class KnownGoals:
    """Every goal that the action servers tell of, the newest first."""

    goals: Sequence[KnownGoal]
    actions: Sequence[str]
    note: str

    def summary(self) -> str:
        """One line."""
        return f"{len(self.goals)} goal(s) of {len(self.actions)} action(s). {self.note}".rstrip()


async def follow_feedback(
    robot: Robot,
    action: str,
    action_type: str = "",
    *,
    goal_id: str | None = None,
    duration_s: float = 5.0,
    max_messages: int = 100,
    report: Report = silent,
) -> FeedbackMessages:
    """The feedback of an action's goals for a while.

    Raises:
        NotFound: if no such action is there.
        BadValue: if the goal id is not one.
    """
    wanted = goal_id_hex(goal_id_bytes(goal_id)) if goal_id else None
    _check_limits(duration_s, max_messages)
    action = names.absolute(action, "action")
    action_type = await robot.types.action(action, action_type)
    topic, started = f"{action}/_action/feedback", monotonic()
    messages: list[FeedbackMessage] = []
    omitted, size = 0, 0
    async with (
        reporting(report, duration_s, f"{topic}: listening"),
        robot.listen(topic, f"{action_type}_FeedbackMessage", wait_s=SERVER_S) as heard,
    ):
        async for sample in _samples(heard, duration_s):
            rendered = robot.values.render(heard.type, sample.data)
            sender = goal_id_hex(rendered.value["goal_id"]["uuid"])
            if wanted not in (None, sender):
                continue
            size += rendered.bytes
            if size > robot.result_bytes and messages:
                omitted += 1
                continue
            messages.append(FeedbackMessage(sender, rendered.value["feedback"], iso_time(sample.received_ns)))
            if len(messages) >= max_messages:
                break
    note = "" if messages else "No feedback came: no goal is running, or its server sends none."
    if omitted:
        note = f"The {omitted} last message(s) are left out: the answer would be too long."
    return FeedbackMessages(topic, action_type, wanted, monotonic() - started, messages, omitted, note)


async def follow_status(
    robot: Robot, action: str, *, duration_s: float = 5.0, max_messages: int = 100, report: Report = silent
) -> StatusFrames:
    """The states of an action's goals for a while; the last known states come first.

    Raises:
        NotFound: if no such action is there.
    """
    _check_limits(duration_s, max_messages)
    action = names.absolute(action, "action")
    await robot.types.action(action)
    topic, started = f"{action}/_action/status", monotonic()
    frames: list[StatusFrame] = []
    async with (
        reporting(report, duration_s, f"{topic}: listening"),
        robot.listen(topic, STATUS_TYPE, wait_s=SERVER_S) as heard,
    ):
        async for sample in _samples(heard, duration_s):
            frames.append(StatusFrame(iso_time(sample.received_ns), states_in(robot, sample)))
            if len(frames) >= max_messages:
                break
    note = "" if frames else "Its server has not told of any goal yet."
    return StatusFrames(topic, monotonic() - started, frames, note)


async def all_goals(robot: Robot) -> KnownGoals:
    """Every goal that the action servers tell of, with state and age."""
    actions = sorted(await robot.types.actions())
    found = await asyncio.gather(*(_goals_of(robot, action) for action in actions))
    goals = sorted((goal for goals in found for goal in goals), key=lambda goal: goal.age_sec or 0.0)
    note = "" if goals else "No goal has been sent yet, or the servers have forgotten them."
    return KnownGoals(goals, actions, note)


async def _goals_of(robot: Robot, action: str) -> list[KnownGoal]:
    states = await states_now(robot, action)
    for state in states:
        if state.status_code in TERMINAL:
            robot.goal_ended(state.goal_id)
    return [
        KnownGoal(
            action,
            state.goal_id,
            state.status_code,
            state.status,
            _age(state.accept_stamp),
            robot.jobs.get(Goal, state.goal_id) is not None,
        )
        for state in states
    ]


def _age(stamp: Mapping[str, Any]) -> float | None:
    age_s = time.time() - stamp_seconds(stamp)
    return round(age_s, 3) if abs(age_s) < _OTHER_CLOCK_S else None


async def _samples(heard: Listening, duration_s: float) -> AsyncIterator[Sample]:
    started = monotonic()
    while (left := started + duration_s - monotonic()) > 0:
        for sample in await heard.take(min(left, 1.0)):
            yield sample


def _check_limits(duration_s: float, max_messages: int) -> None:
    bounded("duration_sec", duration_s, 0.0, MAX_DURATION_S, "s")
    if not 1 <= max_messages <= 1000:
        raise BadInput(f"max_messages: {max_messages} is out of range.", "Give 1 to 1000.")
