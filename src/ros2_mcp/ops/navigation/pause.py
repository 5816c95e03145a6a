"""`ros2_nav_pause`: a running navigation pauses, and goes on with the rest of its places."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from time import monotonic
from typing import Literal

from ros2_mcp.model.errors import BadInput, NotFound, Refused
from ros2_mcp.model.nav2 import NAVIGATE
from ros2_mcp.model.text import counted, quoted
from ros2_mcp.ops.actions.running import running_goals
from ros2_mcp.ops.navigation.hold import shift_since
from ros2_mcp.ops.navigation.navigate import Navigation
from ros2_mcp.ops.results.results import SAID, Report, silent
from ros2_mcp.robot import Robot

PauseState = Literal["paused", "under way", "ended"]
_PAUSES_S = 20.0
"""Cancelling a goal takes up to 4 s, and the robot gets 10 s to stand."""
_LOOK_S = 0.1
_MOST_NAMED = 8


@dataclass(frozen=True, slots=True, kw_only=True)
class NavPaused:
    """The state of the navigation. `stands`: whether the robot was measured to stand still; null if not known. `left`
    has the places that are left to drive to.

    After resuming, `moved_m` and `turned_deg` are the robot's distance and turn from where it was paused, in the map by
    TF; `odometry_m` is the distance by odometry. `is_moved`: whether these exceed what a robot that stands shows; it
    was moved, or its localisation jumped.
    """

    state: PauseState = field(metadata=SAID)
    job_id: str
    stands: bool | None
    x_m: float | None = None
    y_m: float | None = None
    paused_s: float | None = field(default=None, metadata=SAID)
    is_moved: bool | None = None
    moved_m: float | None = None
    turned_deg: float | None = None
    odometry_m: float | None = None
    left: Sequence[str] = field(default=(), metadata=SAID)
    note: str = field(default="", metadata=SAID)

    @property
    def has_failed(self) -> bool:
        """Whether the robot could not be seen to pause."""
        return self.state == "paused" and self.stands is False

    def summary(self) -> str:
        """Return one line."""
        since = f" for {self.paused_s:.0f} s" if self.paused_s and self.paused_s >= 1 else ""
        rest = f" Still to visit: {', '.join(self.left)}." if self.left else ""
        return f"{self.state}{since}. {self.note}{rest}"


async def pause(robot: Robot, job_id: str = "", *, resume: bool = False, report: Report = silent) -> NavPaused:
    """Pause a navigation of this server, or have a paused one go on; return once the robot stands, or its goal is under
    way again.

    Raises:
        NotFound: if there is no such navigation, or none runs.
        BadInput: if it is not paused and is to go on, or several run and no id is given.
        Refused: if another goal runs meanwhile.
    """
    job = robot.jobs.one(Navigation, job_id)
    if not job.is_running:
        how = job.so_far()
        raise NotFound(
            f"No navigation is running: {job.id} has ended ({how.outcome}).",
            "ros2_navigate and ros2_nav_route begin one.",
        )
    return await (_resume(robot, job, report) if resume else _pause(job, report))


async def _pause(job: Navigation, report: Report) -> NavPaused:
    job.pausing.begin()
    await _until(job, lambda: job.pausing.hold is not None, report)
    hold = job.pausing.hold
    if not job.is_running:
        return _ended(job)
    if hold is None:
        return NavPaused(
            state="under way",
            job_id=job.id,
            stands=None,
            left=_left(job),
            note="It does not pause yet: its goal has not ended. ros2_stop stops the robot.",
        )
    return NavPaused(
        state="paused",
        job_id=job.id,
        stands=hold.seen.stands if hold.seen.stands or hold.seen.is_moving else None,
        x_m=_rounded(hold.where.x_m),
        y_m=_rounded(hold.where.y_m),
        paused_s=round(monotonic() - hold.since, 1),
        left=_left(job),
        note=f"{hold.sentence} ros2_nav_pause(resume=true) resumes it; ros2_stop ends it.",
    )


async def _resume(robot: Robot, job: Navigation, report: Report) -> NavPaused:
    hold = job.pausing.hold
    if hold is None:
        raise BadInput(f"{job.id} is not paused: it is under way.", "Wait for it with its job_id.")
    others, shift = await asyncio.gather(
        running_goals(robot, {job.action: [NAVIGATE]}, beside=job.sent), shift_since(robot, hold)
    )
    if others:
        raise Refused(f"Nothing was sent, for another goal is under way. {others[0].sentence}", "End it first.")
    paused_s = round(monotonic() - hold.since, 1)
    if job.pausing.hold is not hold:  # another call resumed it, or a stop ended it
        return _ended(job) if not job.is_running else NavPaused(state="under way", job_id=job.id, stands=None)
    job.pausing.resume()
    await _until(job, lambda: job.pausing.hold is None and job.legs[job.now].outcome != "paused", report)
    if not job.is_running:
        return _ended(job)
    return NavPaused(
        state="under way",
        job_id=job.id,
        stands=None,
        paused_s=paused_s,
        is_moved=shift.is_moved if shift.map_m is not None else None,
        moved_m=shift.map_m,
        turned_deg=shift.turned_deg,
        odometry_m=shift.odometry_m,
        left=_left(job),
        note=f'{shift.sentence} Wait with {job.tool}(job_id="{job.id}").',
    )


async def _until(job: Navigation, is_so: Callable[[], bool], report: Report) -> None:
    """Wait until the navigation is in a state or has ended, at most `_PAUSES_S`."""
    began_at = monotonic()
    while job.is_running and not is_so() and (waited_s := monotonic() - began_at) < _PAUSES_S:
        await report(waited_s, _PAUSES_S, job.line())
        await job.wait(_LOOK_S)


def _ended(job: Navigation) -> NavPaused:
    now = job.so_far()
    return NavPaused(
        state="ended", job_id=job.id, stands=None, note=f"It has ended: {now.outcome}. {now.note}".rstrip()
    )


def _left(job: Navigation) -> list[str]:
    """Return the places that are left to drive to, in order."""
    is_here = job.legs[job.now].outcome in ("under way", "paused")
    left = [quoted(leg.place) if leg.place else f"({leg.x_m:.2f}, {leg.y_m:.2f})" for leg in job.legs]
    left = left[job.now if is_here else job.now + 1 :]
    more = len(left) - _MOST_NAMED
    loops = job.plan.loops - job.loop
    told = [*left[:_MOST_NAMED], *([f"{more} more"] if more > 0 else [])]
    return [*told, *([f"then {counted(loops, 'more loop')} of all"] if loops else [])]


def _rounded(at: float | None) -> float | None:
    return None if at is None else round(at, 3)
