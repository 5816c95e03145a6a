"""One closed-loop motion as a job: started, reported and awaited here, carried out in the bridge."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import Any

from ros2_mcp.model.commands import Move, Moved
from ros2_mcp.model.errors import LinkError, Refused, Stopped
from ros2_mcp.model.text import named
from ros2_mcp.ops.acting.endings import ended_by, reason_of
from ros2_mcp.ops.results.results import Report
from ros2_mcp.ops.topics.publish import Repetition
from ros2_mcp.robot import Robot
from ros2_mcp.robot.jobs import Job
from ros2_mcp.robot.session import Session

Line = Callable[[Mapping[str, Any]], tuple[float, float, str]]
"""Returns the progress of a motion from its controller's report: the part done, the whole, and a readable line."""


class Motion(Repetition):
    """A motion whose call waits for its end; `moved` is the result. Meanwhile this server may publish nothing else on
    its command input, neither another motion nor a single command.
    """

    kind = "motion"
    most_running = 16
    """A robot has few command inputs; each takes one motion at a time."""
    has_its_topics_alone = True

    def __init__(self, robot: Robot, session: Session, command: Move) -> None:
        super().__init__(robot, session, command)
        self._move = replace(command, motion_id=self.id)
        self.moved: Moved | None = None

    def check_beside(self, running: Sequence[Job]) -> None:
        """Raise `Refused` if another job of this server drives by the same command input."""
        for job in running:
            if set(job.moves) & set(self.moves):
                raise Refused(
                    f"{job.id} already drives the robot by {named(self.moves[0])}: two motions would conflict.",
                    "Wait until it ends, or end it with ros2_stop.",
                )

    async def run(self) -> None:
        """Run the motion in the bridge until its controller ends it, or the bridge does (`ros2_stop`)."""
        await self._robot.values.learn(self._move.type)  # as long as it is starting, a stop ends it at once
        self.begun()
        self.moved = await self._robot.do(self._move, self._session)


async def run_motion(robot: Robot, session: Session, command: Move, report: Report, line: Line) -> tuple[Moved, str]:
    """Run a motion until it ends, and report its progress. Return its outcome, and in words what ended it early; "" if
    its controller ended it.

    Raises:
        Refused: if the policy forbids it, or another job of this server drives by the same command input.
        Stopped: if a stop came before anything was sent.
        RobotError: as `Robot.do`.
    """
    motion, said = Motion(robot, session, command), ""

    async def progress() -> None:
        nonlocal said
        told = robot.graph.motion_report(motion.id)
        if told and motion.is_running:
            done, whole, words = line(told)
            if words != said:
                said = words
                await report(done, whole, words)

    await robot.jobs.run(motion, every_second=progress)
    if motion.moved is None:
        if not motion.has_begun:
            raise Stopped(f"{ended_by(motion.stop_reason or 'a stop')} Nothing was sent on {named(command.name)}.")
        raise LinkError(f"The motion by {named(command.name)} was stopped; the bridge has not reported how it ended.")
    how = motion.moved.ended_by
    if not how:
        return motion.moved, ""
    return motion.moved, motion.stop_reason or reason_of(robot, how) or "a request to cancel it"
