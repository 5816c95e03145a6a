"""Cancel goals as soon as a condition holds. The bridge evaluates it on the robot's side."""

from __future__ import annotations

import asyncio
import re
from contextlib import suppress
from dataclasses import replace

import anyio

from ros2_mcp.model.aside import load
from ros2_mcp.model.commands import Principal
from ros2_mcp.model.errors import BadInput, RobotError, TimedOut
from ros2_mcp.model.text import quoted
from ros2_mcp.ops.results.results import told_values
from ros2_mcp.ops.sources.from_before import FromBefore
from ros2_mcp.robot import Robot
from ros2_mcp.robot.goals import CANCELLED_S, CancelWhen, Goal, WhenMet
from ros2_mcp.robot.jobs import Job

_TOPIC = re.compile(r"\s*(?P<topic>/[\w/]+)\s*:(?P<condition>.*)", re.DOTALL | re.ASCII)
_BEGUN_POLL_S = 0.01
"""Seconds between two checks of whether the bridge evaluates the condition. It does within
milliseconds; the goal is not sent before."""
_BEGUN_S = 10.0
"""Time for the bridge to load the type of a topic: mostly milliseconds, a second if its package is large."""
_ACCEPTED_S = 10.0
"""Time for a server to accept the goal, if the condition was met before: as long as the call waits for that."""


class ConditionalCancel(Job):
    """A condition that is evaluated while a goal runs; its id is that of the goal with a prefix. `met` is
    set once the condition was met.

    The job itself moves nothing: the motion of the goal is stopped with the goal.
    """

    kind = "cancel_when"
    most_running = 100
    """Several times as many goals as one client may follow at once."""

    def __init__(self, robot: Robot, owner: Principal, asked: CancelWhen) -> None:
        super().__init__(owner=owner, job_id=job_id(asked.goal_id))
        self._robot = robot
        self.asked = asked
        self.met: WhenMet | None = None
        self.problem = ""

    def doing(self) -> str:
        """Name the goal."""
        return f"of goal {self.asked.goal_id}"

    async def run(self) -> None:
        """Make the bridge evaluate the condition until it is met or the goal has ended."""
        async with anyio.create_task_group() as group:
            group.start_soon(self._ask)
            while self._robot.graph.repeat_begun_at(self.id) is None and not self.met:
                await asyncio.sleep(_BEGUN_POLL_S)
            self.begun()
            while not (goal := self._robot.jobs.get(Goal, self.asked.goal_id)):
                await asyncio.sleep(_BEGUN_POLL_S)
            await goal.wait()
            group.cancel_scope.cancel()

    async def _ask(self) -> None:
        try:
            met = self.met = await self._robot.cancel_when(self.asked, self.id)
        except RobotError as error:
            if not self.has_begun:
                raise
            self.problem = str(error)
            if goal := self._robot.jobs.get(Goal, self.asked.goal_id):
                await goal.request_cancel(CANCELLED_S)  # the condition is no longer evaluated
            return
        if met.is_unknown:  # met before the server accepted the goal, which would go on
            await self._ask_again(met)

    async def _ask_again(self, met: WhenMet) -> None:
        """Request the cancellation until the server has accepted the goal."""
        while not (goal := self._robot.jobs.get(Goal, self.asked.goal_id)):
            await asyncio.sleep(_BEGUN_POLL_S)
        with suppress(RobotError):  # then the note says that it was not cancelled
            response = await goal.request_cancel(_ACCEPTED_S)
            self.met = replace(met, was_taken=bool(response["goals_canceling"]))

    def note(self) -> str:
        """Return whether the condition cancelled the goal, as a sentence; empty if it was not met."""
        if self.problem:
            return f"It was cancelled because its condition could no longer be checked: {quoted(self.problem)}."
        if not self.met:
            return ""
        report = self.met.report
        shown = told_values(report["values"])
        age = FromBefore.one(report["from_before_s"])
        old = f" by {age}; no newer message came" if age.count else ""
        was = "It was cancelled" if self.met.was_taken else "Its server refused to cancel it"
        return f"{was} when {self.asked.condition} was met on {self.asked.topic}{old} ({shown})."


def job_id(goal_id: str) -> str:
    """Return the id of the job that evaluates a condition for this goal."""
    return f"{ConditionalCancel.kind}_{goal_id}"


async def asked_for(robot: Robot, action: str, action_type: str, goal_id: str, text: str) -> CancelWhen:
    """Parse the argument `cancel_when`: a condition on the goal's feedback, or `/topic: condition` on any other topic.

    Raises:
        BadInput: if the text is not a condition.
        BadValue: if a field does not exist, with the nearest that does.
        NotFound: if that topic has no publisher.
    """
    found = _TOPIC.fullmatch(text)
    if found is None:
        topic, message_type = f"{action}/_action/feedback", f"{action_type}_FeedbackMessage"
        condition, of = text, f"{action_type}_Feedback"
        await robot.values.learn(action_type)
    else:
        topic, condition = found["topic"], found["condition"]
        present = await robot.graph.endpoints(topic)
        message_type = of = await robot.types.topic(present, "")
        await robot.values.learn(of)
    await load("ros2_mcp.ops.measure.expression")
    from ros2_mcp.ops.measure.expression import condition as checked

    try:
        read = checked(robot.values.definitions, of, condition)
    except BadInput as error:
        error.hint = (
            f"{error.hint} The condition reads {topic} ({of}); to read another topic, write /topic: condition.".lstrip()
        )
        raise
    return CancelWhen(
        action=action,
        goal_id=goal_id,
        topic=topic,
        topic_type=message_type,
        condition=read.text,
        is_of_feedback=found is None,
    )


async def begin(robot: Robot, owner: Principal, asked: CancelWhen) -> ConditionalCancel:
    """Start to evaluate the condition, and return once the bridge does: the goal is to be sent only then.

    Raises:
        TimedOut: if the bridge has not begun in time.
        RobotError: if it cannot evaluate the condition, for example because a type is not installed there.
    """
    job = ConditionalCancel(robot, owner, asked)
    await robot.jobs.start(job, within_s=_BEGUN_S)
    if not job.has_begun:
        await job.stop()
        raise TimedOut(
            f"The bridge did not begin to check the condition on {asked.topic} within {_BEGUN_S:g} s.",
            "Nothing was sent.",
        )
    return job


def note_on(robot: Robot, goal_id: str) -> str:
    """Return whether a condition cancelled this goal, as a sentence; empty if none did."""
    job = robot.jobs.get(ConditionalCancel, job_id(goal_id))
    return job.note() if job else ""
