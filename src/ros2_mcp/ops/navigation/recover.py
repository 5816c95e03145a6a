"""`ros2_nav_recover`: run Nav2's own recoveries and measure their effect: clear costmaps, move a little, command the
servers."""

from __future__ import annotations

import asyncio
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Literal, get_args

from ros2_mcp.model.aside import load
from ros2_mcp.model.errors import BadInput, NotFound, RobotError
from ros2_mcp.model.nav2 import MANAGE
from ros2_mcp.model.pictures import OCCUPANCY_GRID
from ros2_mcp.model.text import counted, listed, named
from ros2_mcp.ops.actions.send_goal import send_goal
from ros2_mcp.ops.navigation.action_names import action_of
from ros2_mcp.ops.navigation.whereabouts import Whereabouts, whereabouts
from ros2_mcp.ops.nodes.lifecycle import states
from ros2_mcp.ops.nodes.stacks import COMMANDS, Stack, stacks_of
from ros2_mcp.ops.results.results import SAID, Report, silent
from ros2_mcp.ops.services.call import call
from ros2_mcp.robot import Robot
from ros2_mcp.robot.session import Session

CLEAR = "nav2_msgs/srv/ClearEntireCostmap"
SPIN, BACK_UP, DRIVE = (f"nav2_msgs/action/{name}" for name in ("Spin", "BackUp", "DriveOnHeading"))
Move = Literal["spin", "back_up", "drive_ahead"]
What = Literal["clear", "clear_local", "clear_global", "spin", "back_up", "drive_ahead"]
StackCommand = Literal["up", "pause", "resume", "reset", "down"]
MOVES: Mapping[str, str] = {"spin": SPIN, "back_up": BACK_UP, "drive_ahead": DRIVE}
SPEED_MPS = 0.1
"""Nav2's own recoveries back up at 0.05 to 0.15 m/s."""
_DISTANCE_M, _ANGLE_DEG = 0.3, 90.0
"""The distance and angle of the recoveries in Nav2's default behaviour tree."""
MOST_M, MOST_DEG = 3.0, 360.0
_LOWEST_RADPS = 0.4
"""Nav2's spin turns at 0.4 to 1 rad/s."""
_SPARE_S = 10.0
_STACK_S = 40.0
"""Nav2 brings its servers up within some seconds; with a large map it takes longer."""
_GRID_S = 2.5
"""Nav2 publishes a costmap once a second."""
_SETTLES_S = 1.2
"""Wait after clearing for the next costmap, which contains what the sensors see now."""
_TRANSFORMS_S = 0.3
"""Wait for the transforms at the end of a move: they are published ten times a second or more."""
_OCCUPIED = 99
"""Cost from which a cell of an OccupancyGrid is inscribed or lethal."""


@dataclass(frozen=True, slots=True, kw_only=True)
class NavRecovered:
    """What was done through which action or service, whether it succeeded, and what was measured before and after."""

    done: str = field(metadata=SAID)
    through: str
    successful: bool = field(metadata=SAID)
    measured: str = field(metadata=SAID)
    note: str = ""

    @property
    def has_failed(self) -> bool:
        """Whether the recovery failed."""
        return not self.successful

    def summary(self) -> str:
        """Return one line."""
        return f"{self.done}: {'done' if self.successful else 'FAILED'}. {self.measured} {self.note}".rstrip()


async def recover(
    robot: Robot,
    session: Session,
    what: str = "",
    *,
    stack: str = "",
    amount: float | None = None,
    node: str = "",
    report: Report = silent,
) -> NavRecovered:
    """Clear a costmap, make a short move with Nav2's collision checks, or command all of Nav2's servers.

    Raises:
        BadInput: for neither or both of `what` and `stack`, or an amount that does not fit.
        NotFound: if nothing of Nav2 offers it.
        RobotError: what the call or the goal raises.
    """
    if bool(what) == bool(stack):
        raise BadInput(
            "Give either what or stack.", f"what: {', '.join(get_args(What))}; stack: {', '.join(COMMANDS)}."
        )
    if stack:
        return await _command_stack(robot, session, stack, node, report)
    if what in MOVES:
        return await _move(robot, session, what, amount, report)
    if amount is not None:
        raise BadInput(f"{what} takes no amount.", "Leave it out.")
    return await _clear(robot, session, what, report)


# ── clearing ───────────────────────────────────────────────────────────────────────────────────────────────────────


async def _clear(robot: Robot, session: Session, what: str, report: Report) -> NavRecovered:
    wanted = ("local", "global") if what == "clear" else (what.removeprefix("clear_"),)
    services = {row.name for row in await robot.graph.services() if CLEAR in row.types}
    chosen = {which: sorted((name for name in services if which in name), key=len)[:1] for which in wanted}
    if missing := [which for which, found in chosen.items() if not found]:
        raise await robot.graph.missing(
            f"No service of type {CLEAR} for the {' and the '.join(missing)} costmap was found.",
            "Nav2 is not running, or its costmaps have another name: ros2_service_list pattern=clear.",
        )
    told: list[str] = []
    notes: list[str] = []
    for which, (service,) in chosen.items():
        before = await _occupied(robot, which, 0.0)
        answer = await call(robot, session, service, CLEAR, {"request": {}}, force_call=True, report=report)
        after = await _occupied(robot, which, _SETTLES_S)
        told.append(f"{which.capitalize()} costmap: {_cells(before)} before, {_cells(after)} after.")
        notes.append(answer.note)
    names = [service for (service,) in chosen.values()]
    kept = "What is still occupied is on the map, or the sensors see it now."
    return NavRecovered(
        done=what, through=", ".join(names), successful=True, measured=" ".join([*told, kept]), note=_joined(notes)
    )


def _cells(count: int | None) -> str:
    return "not known how many occupied cells" if count is None else counted(count, "occupied cell")


async def _occupied(robot: Robot, which: str, after_s: float) -> int | None:
    """Count the cells of a costmap in which the robot would touch something; None if it is not published."""
    await load("ros2_mcp.world.occupancy")  # with numpy: not before it is needed
    from ros2_mcp.world.occupancy import OccupancyGrid

    try:
        rows = [row for row in await robot.graph.topics() if row.publishers and OCCUPANCY_GRID in row.types]
        names = sorted((row.name for row in rows if f"{which}_costmap" in row.name), key=len)
        if not names:
            return None
        await asyncio.sleep(after_s)
        async with robot.listen(names[0], OCCUPANCY_GRID, keep="latest", is_volatile=after_s > 0) as listening:
            samples = await listening.take(_GRID_S)
            if not samples:
                return None
            grid = OccupancyGrid((await robot.values.decode_all(listening.type, samples[-1:]))[0])
    except RobotError:
        return None
    return int((grid.cells >= _OCCUPIED).sum())


# ── short moves ────────────────────────────────────────────────────────────────────────────────────────────────────


async def _move(robot: Robot, session: Session, what: str, amount: float | None, report: Report) -> NavRecovered:
    is_turn = what == "spin"
    amount = amount if amount is not None else _ANGLE_DEG if is_turn else _DISTANCE_M
    most, unit = (MOST_DEG, "degrees") if is_turn else (MOST_M, "m")
    if not (0 < abs(amount) <= most) or (amount < 0 and not is_turn):
        raise BadInput(f"{amount:g} is not a valid amount of {what}.", f"Give more than 0 and at most {most:g} {unit}.")
    action = await action_of(robot, MOVES[what])
    takes_s = math.radians(abs(amount)) / _LOWEST_RADPS if is_turn else amount / SPEED_MPS
    allowed_s = math.ceil(takes_s + _SPARE_S)
    allowance = {"time_allowance": {"sec": allowed_s}}
    goal: dict[str, Any] = (
        {"target_yaw": math.radians(amount), **allowance}
        if is_turn
        else {"target": {"x": amount}, "speed": SPEED_MPS, **allowance}
    )
    before = await whereabouts(robot, "odom")
    ended = await send_goal(
        robot, session, action, MOVES[what], goal, wait_for_result=True, timeout_s=allowed_s + _SPARE_S, report=report
    )
    await asyncio.sleep(_TRANSFORMS_S)
    after = await whereabouts(robot, "odom")
    return NavRecovered(
        done=f"{what} {amount:g} {unit}",
        through=action,
        successful=ended.status == "SUCCEEDED",
        measured=_moved(before, after),
        note=ended.note if ended.status == "SUCCEEDED" else f"{named(action)}: {ended.status}. {ended.note}",
    )


def _moved(before: Whereabouts, after: Whereabouts) -> str:
    """Describe how far the robot moved and turned, by its odometry."""
    if None in (before.x_m, before.y_m, before.yaw_rad, after.x_m, after.y_m, after.yaw_rad):
        return "Not measured: there is no odometry transform."
    yaw = before.yaw_rad or 0.0
    dx, dy = (after.x_m or 0.0) - (before.x_m or 0.0), (after.y_m or 0.0) - (before.y_m or 0.0)
    ahead = dx * math.cos(yaw) + dy * math.sin(yaw)
    turned = math.degrees(math.remainder((after.yaw_rad or 0.0) - yaw, 2 * math.pi))
    return f"Measured by odometry: {math.hypot(dx, dy):.2f} m ({ahead:+.2f} m ahead), turned {turned:+.0f}°."


# ── all servers ────────────────────────────────────────────────────────────────────────────────────────────────────


async def _command_stack(robot: Robot, session: Session, command: str, node: str, report: Report) -> NavRecovered:
    stacks = await stacks_of(robot)
    if not stacks:
        raise await robot.graph.missing(
            "No lifecycle manager of Nav2 was found.", "ros2_lifecycle_state shows the nodes."
        )
    stack = _chosen(stacks, node)
    before = await _states(robot, stack)
    answer = await call(
        robot, session, stack.service, MANAGE, {"command": COMMANDS[command]}, timeout_s=_STACK_S, report=report
    )
    after = await _states(robot, stack)
    wanted = "active" if command in ("up", "resume") else ""
    succeeded = bool((answer.result or {}).get("success"))
    others = [name for name, state in after.items() if wanted and state != wanted]
    left = f" Not active: {listed(others, 5)}." if others else ""
    return NavRecovered(
        done=f"{command} of {stack.host}",
        through=stack.service,
        successful=succeeded and not others,
        measured=f"Before: {_in_words(before)}. Now: {_in_words(after)}.{left}",
        note=answer.note,
    )


def _chosen(stacks: Sequence[Stack], node: str) -> Stack:
    """Return the stack of the lifecycle manager `node`; without a name the stack with the controller, or the only
    stack.
    """
    hosts = ", ".join(stack.host for stack in stacks)
    if node:
        wanted = node if node.startswith("/") else f"/{node}"
        found = [stack for stack in stacks if stack.host == wanted]
        if not found:
            raise NotFound(f"{named(node)} is not a lifecycle manager.", f"There are: {hosts}.")
        return found[0]
    driving = [stack for stack in stacks if any(one.endswith("/controller_server") for one in stack.nodes)]
    if len(driving or stacks) > 1:
        raise BadInput(f"There are several lifecycle managers: {hosts}.", "Give node_name.")
    return (driving or stacks)[0]


async def _states(robot: Robot, stack: Stack) -> dict[str, str]:
    found = await states(robot, stack.nodes)
    return {one.node: "unknown" if one.error else one.state for one in found.nodes}


def _in_words(states: Mapping[str, str]) -> str:
    counts: dict[str, int] = {}
    for state in states.values():
        counts[state] = counts.get(state, 0) + 1
    return ", ".join(f"{count} of {len(states)} {state}" for state, count in sorted(counts.items()))


def _joined(notes: Sequence[str]) -> str:
    return " ".join(dict.fromkeys(filter(None, notes)))
