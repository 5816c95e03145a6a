"""One registry of everything that outlives a call: recordings, playbacks, relays, repeats, goals.

A new kind of job is one subclass of `Job` and nothing else: `Jobs` starts it, finds it, bounds how many there are, and
stops it with all others. Every job runs in one task group, so that none is ever loose.
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
"""Reports how a job proceeds."""
State = Literal["starting", "running", "ended", "stopped", "failed"]
_logger = logging.getLogger(__name__)


class Job(ABC):
    """Work that goes on after the call that began it has returned.

    `state` is `starting`, `running`, `ended` (by itself), `stopped` (somebody stopped it) or `failed` (`failure` says
    why); `is_stopping` from the time on at which somebody asks it to end. `stop_reason` is what stopped it, where that
    was not its own tool; `doubt` a sentence on what of it may go on although it has ended, which no stop is confirmed
    beside; `started_at` when it was made (monotonic, in s). `owner` is who began it. `moves` are the
    topics and actions that it may move something on: `ros2_stop` and the end of its owner stop all jobs that have some,
    and leave the others. `at_most_s` is the time after which it ends by itself, in s.

    Started and awaited with `Jobs`; neither the state nor the id survives this process.
    """

    kind: ClassVar[str]
    """What it is in a word; the id begins with it, and messages name it."""
    most_running: ClassVar[int] = 4
    """How many may run at the same time, so that a client that never stops its jobs cannot exhaust the robot."""
    most_kept: ClassVar[int] = 20
    """How many that have ended are kept, so that their last state can be asked for."""
    is_displaced: ClassVar[bool] = False
    """Whether a new one makes the oldest one forgotten when too many run, instead of being refused itself."""
    has_its_topics_alone: ClassVar[bool] = False
    """Whether nothing else of this server may publish on what it moves, as long as it runs."""
    ends_elsewhere: ClassVar[bool] = False
    """Whether the robot itself carries it out, so that cancelling it here only forgets it."""
    listed_by: ClassVar[str] = ""
    """The tool that lists them, for the hints of errors."""
    stopped_by: ClassVar[str] = "ros2_stop"
    """The tool that stops one, for the hints of errors."""
    needs_no_id: ClassVar[bool] = True
    """Whether a tool may mean it where it is the only one of its kind and no id is given."""
    patience_s: ClassVar[float] = 5.0
    """How long `wind_down` and the end that it asks for may take before the work is cancelled."""

    def __init__(self, *, owner: Principal, moves: Sequence[str] = (), job_id: str = "") -> None:
        # Random: nobody can guess the id of another client's job, and after a restart of the server no id means
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
        """The whole work. Calls `begun()` as soon as it runs, and cleans up when it is cancelled, wherever it is.

        What must be awaited while it cleans up stands under `anyio.CancelScope(shield=True)`. A job that knows better
        than whether `stop` was called how it ended sets `outcome`.
        """

    def doing(self) -> str:
        """What it does, in some words beside its kind, for a person; "" where the kind says all."""
        return ""

    def check_beside(self, running: Sequence[Job]) -> None:  # noqa: B027 - most kinds may run beside any other
        """Raises a `RobotError` if it must not run beside those that do; nothing can start in between."""

    async def wind_down(self) -> None:
        """Asks work that has begun to end in good order; without it, `stop` cancels the work at once."""
        self.cancel()

    @property
    def about(self) -> str:
        """What it can be called beside its id, such as the bag that is recorded; empty for nothing."""
        return ""

    def begun(self) -> None:
        """Notes that the work runs, so that the call that began it returns."""
        self.has_begun, self.state = True, "running"
        self._settled.set()

    @property
    def is_running(self) -> bool:
        """Whether it has not ended; true from the beginning, also while it is starting."""
        return self.state in ("starting", "running")

    @property
    def elapsed_s(self) -> float:
        """How long it has run, or ran."""
        return (self._ended_at or monotonic()) - self.started_at

    async def stop(self) -> None:
        """Ends it, also while it is still beginning, and returns when it has ended; without effect on one that has.

        Raises:
            RobotError: what kept it from ending in good order; it was cancelled then, and has ended all the same.
        """
        if not self.is_running:
            return
        is_first, self.is_stopping = not self.is_stopping, True  # who comes second waits for the first
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
        """Ends the work at once, without waiting for it."""
        self.is_stopping = True
        if self._scope:
            self._scope.cancel()

    async def wait(self, timeout_s: float = math.inf) -> bool:
        """Waits until it has ended, at most that long; whether it has. Leaves it running when cancelled."""
        with anyio.move_on_after(timeout_s):
            await self._over.wait()
        return not self.is_running

    async def _supervise(self) -> None:
        """Runs it, and lets no failure out: the other jobs in the task group go on."""
        assert self._scope
        try:
            with self._scope:
                await self.run()
        except asyncio.CancelledError:  # not by its scope: the event loop ends, and this process with it
            self.is_stopping = True
            raise
        except Exception as error:  # whatever it is, it ends this job and no other
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
    """All jobs of a server: those that run, and of each kind the last ones that ended."""

    def __init__(self) -> None:
        self._by_id: dict[str, Job] = {}
        self._group: TaskGroup | None = None
        self._group_is_open = asyncio.Event()
        self._host_may_end = asyncio.Event()
        self._host: asyncio.Task[None] | None = None
        self._is_closed = False

    async def start(self, job: Job, *, within_s: float = math.inf) -> None:
        """Starts a job, and returns when it runs, has ended, or `within_s` is over; ends it if that is cancelled.

        Raises:
            Refused: if too many of its kind run, or the server is ending.
            Exception: whatever kept it from beginning.
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
        except BaseException:  # cancelled: who began it will never learn its id
            await abandon(job)
            raise
        if job.failure:
            raise job.failure

    async def wait(self, job: Job, timeout_s: float = math.inf, *, every_second: Report | None = None) -> None:
        """Waits for the end of a job, at most that long, reporting every second; ends the job if it is cancelled."""
        deadline = monotonic() + timeout_s
        try:
            while job.is_running and (left_s := deadline - monotonic()) > 0:
                await job.wait(min(1.0, left_s) if every_second else left_s)
                if every_second:
                    await every_second()
        except BaseException:  # cancelled, or the client that is reported to has gone
            await abandon(job)
            raise

    async def run(self, job: Job, *, every_second: Report | None = None) -> None:
        """Starts a job that the call awaits, and waits for its end; ends the job if the call is cancelled.

        Raises:
            Exception: as `start`, and whatever it failed with.
        """
        await self.start(job)
        await self.wait(job, every_second=every_second)
        if job.failure:
            raise job.failure

    # ── finding ────────────────────────────────────────────────────────────────────────────────────────────────

    def all(self, kind: type[_Job]) -> list[_Job]:
        """The jobs of a kind, in the order of their start. Safe to call from threads."""
        return [job for job in list(self._by_id.values()) if isinstance(job, kind)]

    def running(self, kind: type[_Job]) -> list[_Job]:
        """The jobs of a kind that have not ended."""
        return [job for job in self.all(kind) if job.is_running]

    def get(self, kind: type[_Job], job_id: str) -> _Job | None:
        """One by its id; None where there is none."""
        job = self._by_id.get(job_id)
        return job if isinstance(job, kind) else None

    def find(self, kind: type[_Job], job_id: str) -> _Job:
        """One by its id, or the last one that is about this.

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
        """The one of that id, or all of the kind where the id is empty; raises as `find`."""
        return [self.find(kind, job_id)] if job_id else self.all(kind)

    def one(self, kind: type[_Job], job_id: str = "") -> _Job:
        """The one of that id; without an id the only one that runs, else the one that ended last.

        Raises:
            NotFound: as `find`, or because there was none.
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
        """Raises `Refused` if no other of that kind may start now."""
        if len(self.running(kind)) >= kind.most_running and not kind.is_displaced:
            raise Refused(f"{kind.most_running} {kind.kind}s run already.", f"Stop one with {kind.stopped_by}.")

    # ── ending ─────────────────────────────────────────────────────────────────────────────────────────────────

    async def stop(self, kind: type[_Job], job_id: str) -> _Job:
        """Stops one, and returns it with its last state; raises as `one`, and as `Job.stop`."""
        job = self.one(kind, job_id)
        await job.stop()
        return job

    async def stop_moving(self, reason: str = "") -> Mapping[Job, str]:
        """Stops all jobs that move something, at the same time, and notes the reason; returns those that ran, each with
        what kept it from ending in good order, if something did.

        Goals, which the robot itself carries out, are left: their caller waits to see them end. A job that is still
        starting moves nothing from the time of the call on.
        """
        moving = [job for job in self.running(Job) if job.moves and not job.ends_elsewhere]
        for job in moving:
            job.stop_reason = reason
            if job.state == "starting":
                job.cancel()
        return await _stop_all(moving)

    async def stop_owned(self, owner: Principal, reason: str = "") -> list[Job]:
        """Stops all that one owner, who is gone, has left in motion, goals too; returns the jobs that ran.

        What moves nothing, such as a recording, goes on: another client can still stop it.
        """
        owned = [job for job in self.running(Job) if job.owner == owner and job.moves]
        for job in owned:
            job.stop_reason = reason
        return list(await self._end(owned))

    async def close(self) -> None:
        """Stops all, and starts no other: the end of the server. Safe to call twice."""
        self._is_closed = True
        for job in self.running(Job):
            if job.ends_elsewhere:
                job.cancel()
        await self._end(self.running(Job))
        self._host_may_end.set()
        if self._host:
            await asyncio.wait({self._host})

    async def _end(self, jobs: Sequence[Job]) -> Mapping[Job, str]:
        """Stops jobs whose owner has gone. What moves something does not wind down: nobody awaits its result."""
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
        """The group in which all jobs run; it belongs to no call, so that no call's end is theirs."""
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
    """Ends a job whose caller has gone at once, without winding down: it may be moving the robot."""
    job.cancel()
    with anyio.CancelScope(shield=True):
        await job.wait()


def _single(error: Exception) -> Exception:
    """The one error of which a task group of the job has made a group."""
    while isinstance(inner := getattr(error, "exceptions", (None,))[0], Exception):
        error = inner
    return error
