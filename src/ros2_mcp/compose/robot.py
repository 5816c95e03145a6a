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
from ros2_mcp.ops.navigation.last_pose import LastPose
from ros2_mcp.ops.results.results import AnswerBytes, lines_of
from ros2_mcp.ops.sources.recorded_robot import recorded_robot
from ros2_mcp.ops.stop import stop as stopping
from ros2_mcp.programs.kept import KeptPrograms
from ros2_mcp.robot import Robot
from ros2_mcp.robot.jobs import Job
from ros2_mcp.settings import Settings


@asynccontextmanager
async def connect(settings: Settings | None = None) -> AsyncGenerator[Robot, None]:
    """Within this context, the robot that the settings name, or a recording if they name a bag. Default: the settings
    of the environment.

    Entering does not wait: operations wait for the bridge, and raise `RobotError` if there is none. On exit, all motion
    that was started is stopped.
    """
    settings = only_one(settings or Settings.from_environment(), "connect")
    store = store_for(settings)
    robot = robot_for(settings, store)
    async with running(robot, store):
        yield robot


def store_for(settings: Settings) -> BagStore:
    """Return the store of the bags that the settings name."""
    return BagStore(settings.record_dir, settings.bag_dir, settings.bag)


def robot_for(settings: Settings, store: BagStore, bridge: Bridge | None = None) -> Robot:
    """Return the robot that the settings name, without starting anything. Without a `bridge` that is already starting,
    one is made.
    """
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
    return Robot(bridge, guard, [*keeps, Places(folder), LastPose(folder)])


def _epoch(bridge: Bridge, guard: Guard) -> str:
    """Return the robot's stop epoch and the count of the latch: an approval given in another epoch has lapsed."""
    return f"{bridge.stop_epoch}.{guard.latch.look().count}"


def _tell_spent(bridge: Bridge, spent: Spent) -> None:
    """Tell the bridge what was spent: another server may have acted after the bridge was told, before this server got
    the lock.
    """
    spent.read()
    bridge.tell("spent", json.dumps(spent.ages()).encode())


def _told_latch(guard: Guard) -> dict[str, Any]:
    """Return the state of the latch, which each ping carries to a bridge that cannot read its file."""
    state = guard.latch.look()
    cause = {"latch_by": state.by, "latch_reason": state.reason} if state.is_set else {}
    return {"latch_set": int(state.is_set), "latch_count": state.count, **cause}


def _latch_here(guard: Guard, note: Callable[[str, str, bool], None], by: str, reason: str, own: bool) -> None:
    """Set the latch here after a bridge that cannot read its file has set it, for example its watchdog, and write the
    file.
    """
    note(by, reason, own)
    if own and not guard.latch.look().is_set:
        guard.latch.hold(by=by, reason=reason)
        threading.Thread(target=guard.latch.write_at_last, daemon=True).start()


def _noting_latched(guard: Guard) -> Callable[[str, str, bool], None]:
    """Return a function that notes in the audit that the latch was set, by the bridge's watchdog, a stopper or another
    server.

    Each bridge reports a latch that it finds set at its start; a latch that was already known is not noted again.
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
    """Return the guard of the settings, which decides about every command: policies, latch and the server's lock."""
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
    """Within this context, an operator can reach this server with `ros2-mcp operate`."""
    consent, auditing = robot.guard.approvals, robot.guard.audit
    if not (isinstance(consent, Consent) and isinstance(auditing, Auditing)):
        yield  # a recording: there is nothing to operate
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
    """Within this context the bridge runs, unless the robot is a recording. On exit, all work is ended.

    Jobs end first, while the bridge can still stop their motion; then the bridge is ended.
    """
    if not store.subject:
        await robot.attach()
    try:
        yield
    finally:
        with anyio.CancelScope(shield=True):  # even if cancelled, the robot has to be stopped
            try:
                await robot.leave()
            finally:
                await store.close()
