"""Tools for all robots of a server together: list them, and stop them."""

from __future__ import annotations

import asyncio
import logging
from collections.abc import Sequence
from dataclasses import dataclass, field
from time import monotonic
from typing import Literal

import anyio

from ros2_mcp.mcp.fleet.member import Member
from ros2_mcp.model.errors import RobotError
from ros2_mcp.model.graph import Contact
from ros2_mcp.model.text import quoted
from ros2_mcp.ops.results.results import IF_ANY, microseconds
from ros2_mcp.ops.stop import stop as stopping

ROBOTS = "ros2_robots"
STOP = "ros2_stop"
_CONNECT_S = 2.5
"""How long `ros2_robots` waits: a bridge over ssh says hello within 2 s at a round trip of 0.1 s (measured)."""
_NEVER_REACHED = "This server has never reached it, and moves nothing there."
_SILENT_S = 1.0
"""Longer than the time between two pings: a robot that was silent for so long may stay silent."""
_LOOK_S = 0.05
"""Time between two checks for silent robots."""
_going_on: set[asyncio.Task[StoppedRobot]] = set()
"""Stops that continue after their answer. asyncio keeps only weak references to tasks, so they are kept here."""
_logger = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True, kw_only=True)
class RobotState:
    """One robot: `state` is connected, connecting or away; `note` says why it is not connected.

    `link_rtt_s` is the shortest round-trip time of the last minute, `clock_offset_s` how far the robot's clock is ahead
    of this machine's; null until measured. `policy` names the policies in force, empty if there are none. `latched`: no
    command is carried out until an operator resets the latch.
    """

    robot: str
    address: str
    state: Literal["connected", "connecting", "away"]
    distro: str
    rmw: str
    domain_id: int | None
    link_rtt_s: float | None
    clock_offset_s: float | None
    read_only: bool
    policy: str
    latched: bool
    note: str = field(metadata=IF_ANY)

    def line(self) -> str:
        """Return the state in one line."""
        ros = f", ROS 2 {self.distro} with {self.rmw}, domain {self.domain_id}" if self.distro else ""
        told = [*(["read-only"] if self.read_only else []), *(["latched"] if self.latched else [])]
        return " ".join(filter(None, (f"{', '.join((f'{self.robot}: {self.state}{ros}', *told))}.", self.note)))


@dataclass(frozen=True, slots=True)
class RobotStates:
    """The robots of this server."""

    robots: Sequence[RobotState]

    def summary(self) -> list[str]:
        """Return one line for each robot."""
        return [robot.line() for robot in self.robots]


@dataclass(frozen=True, slots=True)
class StoppedRobot:
    """The result of a stop on one robot."""

    robot: str
    stopped: stopping.Stopped


@dataclass(frozen=True, slots=True)
class StoppedRobots:
    """The result of a stop for each robot; `confirmed` if it is confirmed for all of them."""

    robots: Sequence[StoppedRobot]
    confirmed: bool
    note: str = field(metadata=IF_ANY)

    def summary(self) -> list[str]:
        """Return one line for each robot."""
        return [*([self.note] if self.note else []), *(f"{one.robot}: {one.stopped.summary()}" for one in self.robots)]


async def states(members: Sequence[Member]) -> RobotStates:
    """Return the state of all robots, after a short wait for robots that are not connected yet. No robot delays
    another.
    """
    return RobotStates(await asyncio.gather(*map(_state, members)))


async def _state(member: Member) -> RobotState:
    before = f" Last failure: {member.robot.graph.failure}" if member.robot.graph.failure else ""
    state: Literal["connected", "connecting", "away"] = "connecting"
    note = f"It has not answered within {_CONNECT_S:g} s: call ros2_robots again.{before}"
    found: Contact | None = None
    try:
        with anyio.move_on_after(_CONNECT_S):
            found = await member.robot.graph.contact()
            state, note = "connected", ""
    except RobotError as error:
        state, note = "away", f"{error}"
    return RobotState(
        robot=member.name,
        address=member.settings.robot.text,
        state=state,
        distro=found.distro if found else "",
        rmw=found.rmw if found else "",
        domain_id=found.domain_id if found else None,
        link_rtt_s=microseconds(found.link_rtt_s) if found else None,
        clock_offset_s=microseconds(found.clock_offset_s) if found else None,
        read_only=member.robot.policy.read_only,
        policy=" and ".join(document.name for document in member.robot.policy.documents),
        latched=member.robot.guard.latch.look().is_set,
        note=note,
    )


async def stop(members: Sequence[Member], client: str, note: str = "") -> StoppedRobots:
    """Stop these robots at the same time: none waits for another. Never raises a `RobotError`. `client` is the name of
    the principal.

    The answer does not wait for a silent robot if another one has answered, nor for robots that have stopped by
    themselves because their link lease has lapsed. Stops that were not awaited continue.
    """
    tasks = [asyncio.ensure_future(_stop(member, client)) for member in members]
    latched_at = monotonic() + stopping.LATCHED_S
    _going_on.update(tasks)
    for task in tasks:
        task.add_done_callback(_going_on.discard)
    while pending := [(member, task) for member, task in zip(members, tasks, strict=True) if not task.done()]:
        is_told = len(pending) < len(tasks)
        if is_told and all(member.robot.graph.silent_s > _SILENT_S for member, _ in pending):
            break
        if monotonic() > latched_at and all(stopping.is_out_of_reach(member.robot) for member, _ in pending):
            break
        await asyncio.wait([task for _, task in pending], timeout=_LOOK_S)
    stopped = [
        task.result()
        if task.done()
        else StoppedRobot(member.name, stopping.not_stopped(stopping.unreached(member.robot)))
        for member, task in zip(members, tasks, strict=True)
    ]
    return StoppedRobots(stopped, all(one.stopped.confirmed for one in stopped), note)


async def _stop(member: Member, client: str) -> StoppedRobot:
    robot = member.robot
    try:
        if not robot.graph.was_reached:  # requests that wait for it were accepted before, and are dropped
            return StoppedRobot(member.name, await stopping.stop_unreached(robot, _NEVER_REACHED))
        return StoppedRobot(member.name, await stopping.stop(robot, client=client))
    except Exception as error:  # a fault with one robot must not hide the results of the others
        _logger.exception("stopping %s failed", member.name)
        return StoppedRobot(member.name, stopping.not_stopped(f"A fault in this server: {quoted(repr(error))}"))
