"""`ros2_action_status` and `ros2_action_subscribe_status`: the states of goals, as the action servers publish them."""

from __future__ import annotations

import asyncio
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from time import monotonic
from typing import Any

from ros2_mcp.guard.policy import bounded
from ros2_mcp.model import names
from ros2_mcp.model.errors import NotFound
from ros2_mcp.model.goals import STATUS, STATUS_TYPE, TERMINAL, goal_id_hex, stamp_seconds
from ros2_mcp.model.samples import Sample
from ros2_mcp.model.text import counted
from ros2_mcp.ops.results.results import IF_ANY, SAID, Report, iso_time, reporting, silent
from ros2_mcp.robot import Robot
from ros2_mcp.robot.goals import Goal
from ros2_mcp_common.wire.limits import MAX_DURATION_S

SERVER_S = 3.0
"""Time for an action server that is starting: its services are discovered one after the
other, within 3 s of each other."""
MAX_MESSAGES = 1000
"""The most messages of one call that follows states or feedback: more than a model reads,
and a bound on what is collected."""
LATCHED_S = 0.5
"""Time for the latched message: it comes with the matching, within milliseconds. A server that has had no goal has
none.
"""
_OTHER_CLOCK_S = 1e8
"""Three years: a stamp further than this from now is from a clock that began at zero, as in a simulation."""


@dataclass(frozen=True, slots=True)
class GoalState:
    """A goal and its state as its server publishes it; `accept_stamp` is {sec, nanosec}."""

    goal_id: str
    accept_stamp: dict[str, Any]
    status_code: int
    status: str


@dataclass(frozen=True, slots=True)
class StatusFrame:
    """All goals of one action at one time; `stamp` is the time of receipt, ISO 8601."""

    stamp: str
    statuses: Sequence[GoalState]


@dataclass(frozen=True, slots=True)
class StatusFrames:
    """The changes of the states of an action's goals during the call."""

    topic: str
    duration_sec: float = field(metadata=SAID)
    frames: Sequence[StatusFrame]
    note: str = field(metadata=IF_ANY)

    def summary(self) -> str:
        """Return the result in one line."""
        return f"{counted(len(self.frames), 'status message')} in {self.duration_sec:.2f} s. {self.note}".rstrip()


@dataclass(frozen=True, slots=True)
class KnownGoal:
    """A goal of any action. `from_this_server`: this server sent it. `age_sec` is the time since the goal was accepted;
    null if the action server's clock differs from this machine's, as in a simulation.
    """

    action_name: str
    goal_id: str
    status_code: int
    status: str
    age_sec: float | None
    from_this_server: bool


@dataclass(frozen=True, slots=True)
class KnownGoals:
    """All goals whose state an action server publishes, the newest first."""

    goals: Sequence[KnownGoal]
    actions: Sequence[str]
    note: str = field(metadata=IF_ANY)

    def summary(self) -> str:
        """Return the counts in one line."""
        return f"{counted(len(self.goals), 'goal')}; {counted(len(self.actions), 'action')} known. {self.note}".rstrip()


async def states_now(robot: Robot, action: str, within_s: float = LATCHED_S) -> list[GoalState]:
    """Return the newest states of an action's goals; none if the server has not published any."""
    try:
        async with robot.listen(f"{action}/_action/status", STATUS_TYPE, keep="latest") as listening:
            samples = await listening.take(within_s)
    except NotFound:
        return []
    return await states_in(robot, samples[-1]) if samples else []


async def states_in(robot: Robot, sample: Sample) -> list[GoalState]:
    """Return the states in one status message."""
    message: Mapping[str, Any] = await robot.values.in_full(STATUS_TYPE, sample.data)
    return [
        GoalState(
            goal_id_hex(entry["goal_info"]["goal_id"]["uuid"]),
            entry["goal_info"]["stamp"],
            int(entry["status"]),
            STATUS.get(int(entry["status"]), str(entry["status"])),
        )
        for entry in message["status_list"]
    ]


async def follow_status(
    robot: Robot, action: str, *, duration_s: float = 5.0, max_messages: int = 100, report: Report = silent
) -> StatusFrames:
    """Return the states of an action's goals over some seconds; the last known states come first.

    Raises:
        NotFound: if there is no such action.
    """
    bounded("duration_sec", duration_s, 0.0, MAX_DURATION_S, "s")
    bounded("max_messages", max_messages, 1, MAX_MESSAGES, "messages")
    action = names.absolute(action, "action")
    await robot.types.action(action)
    topic, started = f"{action}/_action/status", monotonic()
    frames: list[StatusFrame] = []
    async with (
        reporting(report, duration_s, f"{topic}: listening"),
        robot.listen(topic, STATUS_TYPE, wait_s=SERVER_S) as listening,
    ):
        async for sample in listening.samples(duration_s):
            frames.append(StatusFrame(iso_time(sample.received_ns), await states_in(robot, sample)))
            if len(frames) >= max_messages:
                break
    note = "" if frames else "The server has not published the status of any goal yet."
    return StatusFrames(topic, monotonic() - started, frames, note)


async def all_goals(robot: Robot) -> KnownGoals:
    """Return every goal whose state an action server publishes, with state and age."""
    actions = sorted(await robot.types.actions())
    goals: list[KnownGoal] = []
    states_by_action = await asyncio.gather(*(states_now(robot, action) for action in actions))
    for action, states in zip(actions, states_by_action, strict=True):
        for state in states:
            goal = robot.jobs.get(Goal, state.goal_id)
            is_ours = goal is not None and goal.action == action
            if state.status_code in TERMINAL:
                robot.goal_ended(action, state.goal_id, state.status)
            age_s = robot.now_ns() / 1e9 - stamp_seconds(state.accept_stamp)
            shown_age = round(age_s, 3) if abs(age_s) < _OTHER_CLOCK_S else None
            goals.append(KnownGoal(action, state.goal_id, state.status_code, state.status, shown_age, is_ours))
    note = "" if goals else "No goal has been sent yet, or the servers no longer keep them."
    if not actions and (absence := await robot.graph.absence()):
        note = absence
    return KnownGoals(sorted(goals, key=lambda goal: goal.age_sec or 0.0), actions, note)
