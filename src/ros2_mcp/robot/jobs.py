"""One registry of everything that outlives a call: recordings, playbacks, relays, repeats, goals and others.

A new kind of job is one subclass of `Job` and nothing else: `Jobs` starts it, finds it, limits the number, and stops it
with all others. All jobs run in one task group, so that no task is left over.
"""

from __future__ import annotations

import asyncio
import logging
import math
import secrets
from abc import ABC, abstractmethod
from collections.abc import Awaitable, Callable, Mapping, Sequence
from time import monotonic
from typing import ClassVar, Literal, TypeVar

import anyio
from anyio.abc import TaskGroup

from ros2_mcp.model.commands import Principal
from ros2_mcp.model.errors import BadInput, NotFound, Refused, RobotError, Stopped
from ros2_mcp.model.names import did_you_mean

Report = Callable[[], Awaitable[None]]
"""Reports the progress of a job."""
State = Literal["starting", "running", "ended", "stopped", "failed"]
_logger = logging.getLogger(__name__)


class Job(ABC):
    """Work that continues after the call that began it has returned.

    `state` is `starting`, `running`, `ended` (on its own), `stopped` (by a request) or `failed` (`failure` has the
    error). `is_stopping` is set once the job was asked to end. `stop_reason` is the cause of a stop, unless it was the
    job's own tool. `doubt` is a sentence about what may go on although the job has ended; with one, no stop is
    confirmed. `started_at` is the time of creation (monotonic, in s). `owner` is the principal that began the job.
    `moves` are the topics and actions by which the job may move something: `ros2_stop` and the disconnection of the
    owner stop all jobs with `moves`, and no others. `at_most_s` is the time after which the job ends on its own, in s.

    Start and await it with `Jobs`. Neither state nor id survive this process.
    """

    kind: ClassVar[str]
    """The name of the kind in one word; ids begin with it, and messages use it."""
    most_running: ClassVar[int] = 4
    """The most that may run at the same time, so that a client that never stops its jobs cannot exhaust the robot."""
    most_kept: ClassVar[int] = 20
    """The most ended jobs that are kept, so that their last state can be queried."""
    is_displaced: ClassVar[bool] = False
    """Whether, beyond `most_running`, the oldest job is forgotten instead of refusing the new job."""
    has_its_topics_alone: ClassVar[bool] = False
    """Whether nothing else in this server may publish on the job's topics while it runs."""
    ends_elsewhere: ClassVar[bool] = False
    """Whether the robot itself carries out the work, so that cancelling the job here only forgets it."""
    listed_by: ClassVar[str] = ""
    """The tool that lists these jobs, for the hints of errors."""
    stopped_by: ClassVar[str] = "ros2_stop"
    """The tool that stops such a job, for the hints of errors."""
    needs_no_id: ClassVar[bool] = True
    """Whether a tool may be called without an id when this job is the only job of its kind."""
    patience_s: ClassVar[float] = 5.0
    """The time limit for `wind_down` and the end that it causes, in s; after it the work is cancelled."""

    def __init__(self, *, owner: Principal, moves: Sequence[str] = (), job_id: str = "") -> None:
        # Random: the id of another client's job cannot be guessed, and after a restart of the server no id refers to
        # another job than before.
        self.id = job_id or f"{self.kind}_{secrets.token_hex(4)}"
        self.owner = owner
        self.moves = tuple(moves)
        self.at_most_s = math.inf
        self.state: State = "starting"
        self.failure: Exception | None = None
        self.outcome: State | None = None
        self.has_begun = False
        self.stop_reason = ""
        self.doubt = ""
        self.started_at = monotonic()
        self._ended_at = 0.0
        self._scope: anyio.CancelScope | None = None
        self._settled = asyncio.Event()
        self._over = asyncio.Event()
        self.is_stopping = False

    @abstractmethod
    async def run(self) -> None:
        """Do the whole work. Call `begun()` once it runs, and clean up on cancellation at any await.

        Awaits during the clean-up need `anyio.CancelScope(shield=True)`. A job sets `outcome` if the call of `stop`
        alone does not tell how it ended.
        """

    def doing(self) -> str:
        """Return a short description of the work besides its kind, for a person; "" if the kind says everything."""
        return ""

    def check_beside(self, running: Sequence[Job]) -> None:  # noqa: B027 - most kinds may run beside any other
        """Raise a `RobotError` if the job must not run alongside the running jobs; no job can start in between."""

    async def wind_down(self) -> None:
        """Ask running work to end in good order. By default the work is cancelled at once."""
        self.cancel()

    @property
    def about(self) -> str:
        """Another name for the job besides its id, such as the bag that is recorded; "" for none."""
        return ""

    def begun(self) -> None:
        """Mark the work as running, so that the call that began it returns."""
        self.has_begun, self.state = True, "running"
        self._settled.set()

    @property
    def is_running(self) -> bool:
        """Whether the job has not ended; true from the beginning, also while it starts."""
        return self.state in ("starting", "running")

    @property
    def elapsed_s(self) -> float:
        """The duration of the job so far, in s; after its end, the total."""
        return (self._ended_at or monotonic()) - self.started_at

    async def stop(self) -> None:
        """End the job, also while it starts, and return when it has ended. No effect on a job that has ended.

        Raises:
            RobotError: the reason why it did not end in good order; the job was then cancelled, and has ended.
        """
        if not self.is_running:
            return
        is_first, self.is_stopping = not self.is_stopping, True  # a second caller waits for the first
        try:
            with anyio.move_on_after(self.patience_s):
                if is_first and self.state == "running":
                    await self.wind_down()
                elif self.state == "starting":
                    self.cancel()
                await self._over.wait()
        finally:
            self.cancel()
            with anyio.CancelScope(shield=True):
                await self._over.wait()

    def cancel(self) -> None:
        """Cancel the work, without waiting for its end."""
        self.is_stopping = True
        if self._scope:
            self._scope.cancel()

    async def wait(self, timeout_s: float = math.inf) -> bool:
        """Wait for the end for at most `timeout_s`; return whether the job has ended. Cancelling the wait leaves it
        running.
        """
        with anyio.move_on_after(timeout_s):
            await self._over.wait()
        return not self.is_running

    async def _supervise(self) -> None:
        """Run the job, and catch all its errors, so that the other jobs in the task group go on."""
        assert self._scope
        try:
            with self._scope:
                await self.run()
        except asyncio.CancelledError:  # not by its scope: the event loop ends, and this process with it
            self.is_stopping = True
            raise
        except Exception as error:  # any error ends this job only
            self.failure = _single(error)
            if isinstance(self.failure, Stopped):
                self.outcome, self.stop_reason = "stopped", self.stop_reason or self.failure.reason
            elif self._settled.is_set() and not isinstance(self.failure, RobotError):
                _logger.exception("%s %s failed", self.kind, self.id)
        finally:
            ended: State = "stopped" if self.is_stopping else "ended"
            has_failed = self.failure and not isinstance(self.failure, Stopped)
            self.state = "failed" if has_failed else self.outcome or ended
            self._ended_at = monotonic()
            self._over.set()
            self._settled.set()


_Job = TypeVar("_Job", bound=Job)


class Jobs:
    """All jobs of a server: the running jobs, and the jobs of each kind that ended last."""

    def __init__(self) -> None:
        self._by_id: dict[str, Job] = {}
        self._group: TaskGroup | None = None
        self._group_is_open = asyncio.Event()
        self._host_may_end = asyncio.Event()
        self._host: asyncio.Task[None] | None = None
        self._is_closed = False

    async def start(self, job: Job, *, within_s: float = math.inf) -> None:
        """Start a job, and return when it runs, has ended, or `within_s` is over. End the job if this is cancelled.

        Raises:
            Refused: if too many of its kind run, or the server is ending.
            Exception: the error that kept the job from starting.
        """
        group = await self._task_group()
        self.require_room(type(job))
        job.check_beside(self.running(Job))
        self._forget_oldest(type(job))
        job._scope = anyio.CancelScope()  # pyright: ignore[reportPrivateUsage] - the two classes are one subject
        self._by_id[job.id] = job
        group.start_soon(job._supervise, name=job.id)  # pyright: ignore[reportPrivateUsage]
        try:
            with anyio.move_on_after(within_s):
                await job._settled.wait()  # pyright: ignore[reportPrivateUsage]
        except BaseException:  # cancelled: the caller will never learn the id
            await abandon(job)
            raise
        if job.failure:
            raise job.failure

    async def wait(
        self,
        job: Job,
        timeout_s: float = math.inf,
        *,
        every_second: Report | None = None,
        until: Callable[[], bool] = lambda: False,
    ) -> None:
        """Wait for the end of a job for at most `timeout_s`, with a report every second, which is also when `until` is
        asked whether to wait no longer; end the job if this is cancelled.
        """
        deadline = monotonic() + timeout_s
        try:
            while job.is_running and not until() and (left_s := deadline - monotonic()) > 0:
                await job.wait(min(1.0, left_s) if every_second else left_s)
                if every_second:
                    await every_second()
        except BaseException:  # cancelled, or the client that gets the reports has gone
            await abandon(job)
            raise

    async def run(self, job: Job, *, every_second: Report | None = None) -> None:
        """Start a job that the call awaits, and wait for its end; end the job if the call is cancelled.

        Raises:
            Exception: as `start`, or the error with which the job failed.
        """
        await self.start(job)
        await self.wait(job, every_second=every_second)
        if job.failure:
            raise job.failure

    # ── finding ────────────────────────────────────────────────────────────────────────────────────────────────

    def all(self, kind: type[_Job]) -> list[_Job]:
        """Return the jobs of a kind, in order of their start. Safe to call from other threads."""
        return [job for job in list(self._by_id.values()) if isinstance(job, kind)]

    def running(self, kind: type[_Job]) -> list[_Job]:
        """Return the jobs of a kind that have not ended."""
        return [job for job in self.all(kind) if job.is_running]

    def get(self, kind: type[_Job], job_id: str) -> _Job | None:
        """Return the job with this id, or None."""
        job = self._by_id.get(job_id)
        return job if isinstance(job, kind) else None

    def find(self, kind: type[_Job], job_id: str) -> _Job:
        """Return the job with this id, or the last job with this name in `about`.

        Raises:
            NotFound: with the nearest id.
        """
        if job := self.get(kind, job_id):
            return job
        if named := [job for job in self.all(kind) if job.about == job_id]:
            return named[-1]
        ids = [job.id for job in self.all(kind)]
        hint = f"{kind.listed_by} shows them." if kind.listed_by else f"Known: {', '.join(ids) or 'none'}."
        raise NotFound(f"There is no {kind.kind} {job_id!r}.", did_you_mean(job_id, ids, hint))

    def chosen(self, kind: type[_Job], job_id: str) -> list[_Job]:
        """Return the job with this id, or all of the kind for an empty id. Raises as `find`."""
        return [self.find(kind, job_id)] if job_id else self.all(kind)

    def one(self, kind: type[_Job], job_id: str = "") -> _Job:
        """Return the job with this id; without an id the only running job, or else the last job that was started.

        Raises:
            NotFound: as `find`, or if there was none.
            BadInput: if several run and no id is given.
        """
        if job_id:
            return self.find(kind, job_id)
        begun = [job for job in self.all(kind) if job.needs_no_id]
        running = [job for job in begun if job.is_running]
        if not begun:
            raise NotFound(f"No {kind.kind} has been started.")
        if len(running) > 1:
            ids = ", ".join(job.id for job in running)
            raise BadInput(f"{len(running)} {kind.kind}s are running: {ids}.", f"Give the {kind.kind}_id of one.")
        return running[0] if running else begun[-1]

    def require_room(self, kind: type[Job]) -> None:
        """Raise `Refused` if no further job of this kind may start now."""
        if len(self.running(kind)) >= kind.most_running and not kind.is_displaced:
            raise Refused(f"{kind.most_running} {kind.kind}s run already.", f"Stop one with {kind.stopped_by}.")

    # ── ending ─────────────────────────────────────────────────────────────────────────────────────────────────

    async def stop(self, kind: type[_Job], job_id: str) -> _Job:
        """Stop a job, and return it with its last state. Raises as `one` and as `Job.stop`."""
        job = self.one(kind, job_id)
        await job.stop()
        return job

    async def stop_moving(self, reason: str = "") -> Mapping[Job, str]:
        """Stop all jobs that move something, concurrently, and set their `stop_reason`. Return the jobs that ran, each
        with the problem if it did not end in good order.

        Goals and flights, which the robot itself carries out, are left running: the caller waits to observe their end.
        A job that is still starting moves nothing from this call on.
        """
        moving = [job for job in self.running(Job) if job.moves and not job.ends_elsewhere]
        for job in moving:
            job.stop_reason = reason
            if job.state == "starting":
                job.cancel()
        return await _stop_all(moving)

    async def stop_owned(self, owner: Principal, reason: str = "") -> list[Job]:
        """Stop the jobs that move something of an owner that has disconnected, including goals; return the jobs that
        ran.

        Jobs that move nothing, such as recordings, go on: another client can still stop them.
        """
        owned = [job for job in self.running(Job) if job.owner == owner and job.moves]
        for job in owned:
            job.stop_reason = reason
        return list(await self._end(owned))

    async def close(self) -> None:
        """Stop all jobs, and start no further jobs: the end of the server. Safe to call twice."""
        self._is_closed = True
        for job in self.running(Job):
            if job.ends_elsewhere:
                job.cancel()
        await self._end(self.running(Job))
        self._host_may_end.set()
        if self._host:
            await asyncio.wait({self._host})

    async def _end(self, jobs: Sequence[Job]) -> Mapping[Job, str]:
        """Stop jobs whose caller has gone. Jobs that move something do not wind down, because no caller awaits the
        result.
        """
        for job in jobs:
            if job.moves and not job.ends_elsewhere:
                job.cancel()
        return await _stop_all(jobs)

    def _forget_oldest(self, kind: type[Job]) -> None:
        running = self.running(kind)
        if len(running) >= kind.most_running:
            running[0].cancel()
        ended = [job for job in self.all(kind) if not job.is_running]
        for job in ended[: max(0, len(ended) - kind.most_kept)]:
            del self._by_id[job.id]

    async def _task_group(self) -> TaskGroup:
        """Return the task group of all jobs. It belongs to no call, so that the end of a call does not end the jobs."""
        if self._is_closed:
            raise Refused("This server is ending.", "Start it again.")
        if self._host is None or self._host.done():
            self._group_is_open, self._host_may_end = asyncio.Event(), asyncio.Event()
            self._host = asyncio.create_task(self._host_group())
        await self._group_is_open.wait()
        assert self._group
        return self._group

    async def _host_group(self) -> None:
        async with anyio.create_task_group() as self._group:
            self._group_is_open.set()
            await self._host_may_end.wait()


async def _stop_all(jobs: Sequence[Job]) -> Mapping[Job, str]:
    ended = dict.fromkeys(jobs, "")

    async def stop(job: Job) -> None:
        try:
            await job.stop()
        except Exception as error:  # noqa: BLE001 - it has ended; that it was not in good order keeps no other from ending
            ended[job] = str(error)
            _logger.warning("%s %s did not end in good order: %s", job.kind, job.id, error)

    async with anyio.create_task_group() as group:
        for job in jobs:
            group.start_soon(stop, job)
    return ended


async def abandon(job: Job) -> None:
    """End a job whose caller has gone at once, without winding down, because it may be moving the robot."""
    job.cancel()
    with anyio.CancelScope(shield=True):
        await job.wait()


def _single(error: Exception) -> Exception:
    """Return the single error in the exception groups that a job's own task groups have made."""
    while isinstance(inner := getattr(error, "exceptions", (None,))[0], Exception):
        error = inner
    return error
