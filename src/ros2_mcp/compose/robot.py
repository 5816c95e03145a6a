"""A robot without MCP: for `assembly`, and for programs that use the operations of `ros2_mcp.ops` as a library."""

from __future__ import annotations

import json
import math
import threading
from collections.abc import AsyncGenerator, Callable
from contextlib import asynccontextmanager
from functools import partial
from typing import Any

import anyio

from ros2_mcp.compose.entries import only_one
from ros2_mcp.guard.consent import Auditing, Consent, with_consent
from ros2_mcp.guard.guard import Guard
from ros2_mcp.guard.operating import Operated, StopAnswer, operating
from ros2_mcp.guard.policy_file import policy_for
from ros2_mcp.guard.spent import Spent, told
from ros2_mcp.guard.state import ServerLock, StateFolder, state_of
from ros2_mcp.guard.strength import strength_of
from ros2_mcp.guard.watch import watch_of
from ros2_mcp.link.carriers import start_carrier
from ros2_mcp.link.client import Bridge
from ros2_mcp.ops.memory.bag_store import BagStore
from ros2_mcp.ops.navigation.known_places import Places
from ros2_mcp.ops.results.results import AnswerBytes, lines_of
from ros2_mcp.ops.sources.recorded_robot import recorded_robot
from ros2_mcp.ops.stop import stop as stopping
from ros2_mcp.programs.kept import KeptPrograms
from ros2_mcp.robot import Robot
from ros2_mcp.robot.jobs import Job
from ros2_mcp.settings import Settings


@asynccontextmanager
async def connect(settings: Settings | None = None) -> AsyncGenerator[Robot, None]:
    """The robot that the settings name, or the environment without them; a recording where they name a bag.

    Returns at once: operations wait for the bridge themselves, and raise `RobotError` if there is none. When it is
    left, everything that was set in motion is stopped.
    """
    settings = only_one(settings or Settings.from_environment(), "connect")
    store = store_for(settings)
    robot = robot_for(settings, store)
    async with running(robot, store):
        yield robot


def store_for(settings: Settings) -> BagStore:
    """The bags that the settings name."""
    return BagStore(settings.record_dir, settings.bag_dir, settings.bag)


def robot_for(settings: Settings, store: BagStore, bridge: Bridge | None = None) -> Robot:
    """The robot that the settings name; nothing is started. Without a `bridge` that is coming up, one is made."""
    keeps = [AnswerBytes(settings.result_bytes), KeptPrograms(settings.programs)]
    if store.subject:
        return recorded_robot(store, keeps)
    guard = guard_for(settings)
    rules, folder = guard.policy.rules, state_of(settings, guard.policy)
    if bridge is None:
        bridge = Bridge(lambda: start_carrier(settings, state=folder.path, under_policy=rules is not None))
    with_consent(guard, folder, partial(_epoch, bridge, guard))
    if rules:
        spent = Spent(folder)
        bridge.rules = partial(told, {**rules.as_json(), "watch": watch_of(guard.policy)}, spent)
        bridge.on_spent = spent.add
        guard.server_lock.on_taken = partial(_tell_spent, bridge, spent)
    bridge.on_latched = note = _noting_latched(guard)
    if settings.robot.is_remote:
        bridge.on_latched = partial(_latch_here, guard, note)
        bridge.latch = partial(_told_latch, guard)
    return Robot(bridge, guard, [*keeps, Places(folder)])


def _epoch(bridge: Bridge, guard: Guard) -> str:
    """In which stop epoch the robot is, and at which latch: what was approved in another one has lapsed."""
    return f"{bridge.stop_epoch}.{guard.latch.look().count}"


def _tell_spent(bridge: Bridge, spent: Spent) -> None:
    """Until this server got the lock another one may have acted, after this one's bridge was told what was used."""
    spent.read()
    bridge.tell("spent", json.dumps(spent.ages()).encode())


def _told_latch(guard: Guard) -> dict[str, Any]:
    """What each ping tells a bridge of the latch, whose file it does not see."""
    state = guard.latch.look()
    cause = {"latch_by": state.by, "latch_reason": state.reason} if state.is_set else {}
    return {"latch_set": int(state.is_set), "latch_count": state.count, **cause}


def _latch_here(guard: Guard, note: Callable[[str, str, bool], None], by: str, reason: str, own: bool) -> None:
    """A bridge that does not see the file has set the latch, as its watchdog does: it holds here, too, and is kept."""
    note(by, reason, own)
    if own and not guard.latch.look().is_set:
        guard.latch.hold(by=by, reason=reason)
        threading.Thread(target=guard.latch.write_at_last, daemon=True).start()


def _noting_latched(guard: Guard) -> Callable[[str, str, bool], None]:
    """Writes a line in the audit: who has set the latch may be the bridge's watchdog, the stopper, or another server.

    Each bridge tells of a latch that it finds set at its start: one that was known then has no line again.
    """
    before = guard.latch.look()
    known = before.count if before.is_set else -1

    def note(by: str, reason: str, _own: bool) -> None:
        nonlocal known
        state = guard.latch.look()
        count = state.count if state.is_set else state.count + 1  # it is not written yet
        if guard.audit and count != known:
            guard.audit.note("latched", by=by, reason=reason)
        known = count

    return note


def guard_for(settings: Settings) -> Guard:
    """What decides about every command: the policies that the settings name, and what holds commands back."""
    policy = policy_for(settings)
    folder = state_of(settings, policy)
    return Guard(
        policy,
        latch=folder.latch(),
        server_lock=ServerLock(folder, is_strict=policy.in_force),
        strength=strength_of(settings),
    )


@asynccontextmanager
async def operated(robot: Robot, settings: Settings) -> AsyncGenerator[None, None]:
    """While it is entered, an operator can reach this server (`ros2-mcp operate`)."""
    consent, auditing = robot.guard.approvals, robot.guard.audit
    if not (isinstance(consent, Consent) and isinstance(auditing, Auditing)):
        yield  # a recording: nothing acts
        return
    folder = state_of(settings, robot.policy)

    async def stop(by: str) -> StopAnswer:
        stopped = await stopping.stop(robot, by)
        is_still = stopped.observed != "not observed"
        return StopAnswer(" ".join(lines_of(stopped.summary())), not stopped.confirmed, is_still)

    def status() -> dict[str, Any]:
        jobs = robot.jobs.running(Job)
        by_jobs = {name for job in jobs for name in job.moves if name != job.id}
        return {
            "moves": sorted(by_jobs.union(robot.failsafes.moving)),
            "jobs": [_told(job) for job in jobs if by_jobs.isdisjoint(job.moves)],
        }

    everything = Operated(
        robot=folder.path.name,
        policy=robot.policy,
        approvals=consent.approvals,
        modes=consent.modes,
        audit=auditing.log,
        latch=robot.guard.latch,
        stop=stop,
        status=status,
    )
    async with operating(
        folder, everything, StateFolder.of(elsewhere=settings.robot.identity, domain_id=settings.domain_id)
    ):
        yield


def _told(job: Job) -> dict[str, Any]:
    at_most_s = job.at_most_s if math.isfinite(job.at_most_s) else None
    return {"id": job.id, "kind": job.kind, "for_s": int(job.elapsed_s), "at_most_s": at_most_s, "doing": job.doing()}


@asynccontextmanager
async def running(robot: Robot, store: BagStore) -> AsyncGenerator[None, None]:
    """While it is entered the bridge is there, if there is a robot; at the end all work is ended.

    Jobs end first, as long as the bridge can still stop what they move; the bridge leaves the robot last.
    """
    if not store.subject:
        await robot.attach()
    try:
        yield
    finally:
        with anyio.CancelScope(shield=True):  # who is cancelled leaves the robot stopped all the same
            try:
                await robot.leave()
            finally:
                await store.close()
