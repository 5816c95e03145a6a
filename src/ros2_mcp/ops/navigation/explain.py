"""Finds out why a goal failed: one cause in a sentence, the evidence for it, and remedies."""

from __future__ import annotations

import asyncio
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

from ros2_mcp.model.aside import aside
from ros2_mcp.model.costs import OCCUPIED, TOUCHING, Reach, cost_in_words
from ros2_mcp.model.errors import RobotError
from ros2_mcp.model.nav2 import CODES, in_words, server_of
from ros2_mcp.model.text import listed, named, quoted
from ros2_mcp.ops.log.read import LogLine
from ros2_mcp.ops.navigation.checks import NEEDS, nav_findings_in
from ros2_mcp.ops.navigation.checks.check import CHAIN, GOAL, LOCALISER, SERVERS, TUNING
from ros2_mcp.ops.navigation.evidence import RANKS, NavFinding
from ros2_mcp.ops.navigation.readers import read_evidence
from ros2_mcp.ops.navigation.situation import Situation, is_of_navigation, line_in_words, look_around
from ros2_mcp.ops.navigation.targets import Target
from ros2_mcp.ops.navigation.whereabouts import in_frame, why_not_in_frame
from ros2_mcp.ops.results.results import IF_ANY
from ros2_mcp.robot import Robot

if TYPE_CHECKING:
    from ros2_mcp.world.costmap import CostGrid

_MOST_LINES = 6
"""Number of log lines in an answer: the last lines of the nodes that failed."""
_TF_CODES = {102, 202, 302, 401, 702, 712, 722, 732, 9002, 9102}
_PLANNING = {203, 204, 205, 206, 208, 303, 304, 305, 306, 308}
"""Codes of planning: the planner judged the start, the goal or the path, so causes on the costmap precede causes at the
base."""
_UNSAID = {0, 1, 2, 9000, 9003}
"""Codes of a navigator that gave up without a reason from a server."""
_NO_PROGRESS = {104, 105, 106, 108}
_NO_VALID_CONTROL = 106
_COSTMAP_LATE = {107}
_WOULD_TOUCH = {703, 714, 723}
"""Codes of recoveries that ended before a collision."""


@dataclass(frozen=True, slots=True)
class Failure:
    """The end of a goal: whether it was rejected, the code and text of its result, and what was seen while it drove."""

    is_rejected: bool
    code: int = 0
    text: str = ""
    seen: str = ""


@dataclass(frozen=True, slots=True, kw_only=True)
class Explanation:
    """Why a goal failed. `cause` and `helps` are sentences; the other fields are the evidence for them.

    `goal_cost` and `start_cost` say what the costmap has there; `is_feasible` whether there is a way on it from the
    robot to the goal (null: not known); `local_costmap` what stands nearest to the robot on the local one;
    `health` are findings on localisation, transforms, sensors, servers and
    components; `log` the last lines of the nodes concerned.
    """

    cause: str
    server: str
    error_code: int
    error: str = field(metadata=IF_ANY)
    goal_cost: str
    start_cost: str
    is_feasible: bool | None
    feasibility: str
    local_costmap: str
    health: Sequence[str]
    log: Sequence[str]
    helps: Sequence[str]
    notes: Sequence[str] = ()


@dataclass(slots=True)
class _Findings:
    """The causes found so far, of which the first is reported as the cause; `beside` are other problems."""

    causes: list[str] = field(default_factory=list[str])
    beside: list[str] = field(default_factory=list[str])
    helps: list[str] = field(default_factory=list[str])

    def add(self, cause: str, helps: str = "") -> None:
        if any(cause in known for known in self.causes):  # a check has already reported it, with its proof
            return
        self.causes.append(cause)
        if helps and helps not in self.helps:
            self.helps.append(helps)


async def explain(robot: Robot, action: str, target: Target, failure: Failure, since_s: float) -> Explanation:
    """Find the cause of a failure that has just happened; takes up to some seconds. Raises no `RobotError`."""
    frame = "map" if target.frame != "odom" else target.frame
    situation, findings = await asyncio.gather(
        look_around(robot, frame, since_s, action), _findings(robot, target, action)
    )
    situation = replace(situation, findings=findings)
    grid, where = situation.grid, situation.where
    goal: tuple[float, float] | None = None
    reach: Reach | None = None
    why_not = ""
    if grid:
        goal = await in_frame(robot, target.frame, target.x_m, target.y_m, grid.frame_id)
        here = (where.x_m, where.y_m) if where.x_m is not None and where.y_m is not None else None
        if goal and here and grid.frame_id == where.frame:
            reach = await aside(grid.cells.size, grid.reach, here, goal)
        why_not = "" if goal else await why_not_in_frame(robot, target.frame, grid.frame_id)
    return judged(situation, target, failure, goal, reach, why_not)


async def _findings(robot: Robot, target: Target, action: str) -> Sequence[NavFinding]:
    try:
        evidence, _ = await read_evidence(robot, NEEDS, target, action)
    except RobotError:
        return ()
    return nav_findings_in(evidence)


def judged(
    situation: Situation,
    target: Target,
    failure: Failure,
    goal: tuple[float, float] | None,
    reach: Reach | None,
    why_not: str = "",
) -> Explanation:
    """Build the explanation from the findings. `goal` is the target in the frame of the costmap, or None, and then
    `why_not` gives the reason."""
    grid, where = situation.grid, situation.where
    start_cost = goal_cost = None
    if grid and goal:
        goal_cost = grid.value(*goal)
    if grid and where.x_m is not None and where.y_m is not None and grid.frame_id == where.frame:
        start_cost = grid.value(where.x_m, where.y_m)
    found = _Findings()
    is_of_planning = failure.code in _PLANNING
    _checked(found, situation, before=CHAIN if is_of_planning else GOAL)
    _servers(found, situation)
    is_goal_known = goal is not None or grid is None
    _localisation(found, situation, target, failure, is_goal_known=is_goal_known, why_not=why_not)
    if grid and goal and failure.code not in _NO_PROGRESS | _COSTMAP_LATE | _TF_CODES:
        _places(found, situation, grid, goal, (start_cost, goal_cost), reach)
    _sensors(found, situation, failure)
    if is_of_planning:
        _checked(found, situation, before=GOAL)
    if failure.code in _NO_PROGRESS | _UNSAID and not found.causes:
        for finding in situation.findings:
            if finding.place == TUNING:
                found.add(str(finding), finding.remedy)
    _motion(found, situation, failure)
    known = CODES.get(failure.code)
    if known and known.name != "UNKNOWN" and not found.causes:
        said = f": {quoted(failure.text)}" if failure.text else ""
        found.add(f"{known.meaning}{said}.", known.helps)
    told = _told(situation.lines, failure)
    if told and not found.causes:
        found.add(told, "Read more of the log with ros2_log_read.")
    if known and not found.helps:
        found.helps.append(known.helps)
    if not found.causes:
        found.add("No cause was found.", "Read the log with ros2_log_read, or try a small move: ros2_nav_probe.")
    first = found.causes[0]
    return Explanation(
        cause=f"{first[0].upper()}{first[1:]}",
        server="bt_navigator" if failure.is_rejected else server_of(failure.code),
        error_code=failure.code,
        error=error_in_words(failure.code, failure.text),
        goal_cost=cost_in_words(goal_cost) if grid and goal else "unknown: no costmap, or no transform to it",
        start_cost=cost_in_words(start_cost) if grid and where.is_known else "unknown: no costmap, or no pose",
        is_feasible=reach.is_reached if reach else None,
        feasibility=_feasibility(situation, reach),
        local_costmap=str(situation.local) if situation.local else "unknown: no local costmap, or no pose on it",
        health=_health(situation, [*found.causes[1:], *found.beside]),
        log=[line_in_words(line) for line in situation.lines[-_MOST_LINES:]],
        helps=found.helps,
        notes=situation.absent,
    )


def error_in_words(code: int, text: str) -> str:
    """Return Nav2's error code in words, followed by the text of its result."""
    return ": ".join(filter(None, (in_words(code), quoted(text) if text else "")))


def _checked(found: _Findings, situation: Situation, *, before: int) -> None:
    """Add the findings of the checks: findings that stop everything are causes if their place is before `before`;
    findings of a lower rank, except findings on the goal, are added to `beside`.
    """
    for finding in situation.findings:
        if finding.rank != RANKS[0]:
            if finding.place != GOAL and str(finding) not in found.beside:
                found.beside.append(str(finding))
        elif finding.place < before and str(finding) not in found.causes:
            found.add(str(finding), finding.remedy)


def _servers(found: _Findings, situation: Situation) -> None:
    if situation.inactive and not any(one.place in (LOCALISER, SERVERS) for one in situation.findings):
        found.add(
            f"not every server of Nav2 is active: {'; '.join(situation.inactive)}.",
            "Activate them: ros2_lifecycle_change, or Nav2's lifecycle manager.",
        )


def _localisation(
    found: _Findings, situation: Situation, target: Target, failure: Failure, *, is_goal_known: bool, why_not: str
) -> None:
    where = situation.where
    if where.trouble and not any(one.place <= SERVERS for one in situation.findings):
        found.add(
            f"the robot's place is unknown: {where.trouble.rstrip('.')}.",
            "Start localisation, or give it an initial pose; ros2_tf_lookup shows when the transform exists.",
        )
    elif not is_goal_known:
        found.add(
            f"there is no transform from the goal's frame {named(target.frame)} to the map. {why_not}".rstrip(),
            "Give the pose in map; ros2_tf_tree shows the frames.",
        )
    if failure.code in _TF_CODES and not found.causes:
        found.add("a transform was missing or late for the server that failed; now it exists.", "Try again.")


def _places(
    found: _Findings,
    situation: Situation,
    grid: CostGrid,
    goal: tuple[float, float],
    costs: tuple[int | None, int | None],
    reach: Reach | None,
) -> None:
    start_cost, goal_cost = costs
    at, on = f"({goal[0]:.2f}, {goal[1]:.2f})", named(situation.grid_topic)
    near = (reach.x_m, reach.y_m) if reach else grid.nearest_free(*goal)
    nearest = f"the nearest free place is ({near[0]:.2f}, {near[1]:.2f})" if near else "there is no free place"
    if goal_cost is None:
        found.add(
            f"the goal {at} is outside of {on}, which covers {grid.extent()} m.",
            f"Give a goal on it: {nearest}.",
        )
    elif goal_cost >= TOUCHING:
        what = "occupied" if goal_cost >= OCCUPIED else "so near to an obstacle that the robot would touch it"
        found.add(
            f"the goal {at} is {what} on {on} (cost {goal_cost}).",
            f"Choose another goal: {nearest}. If nothing stands there, clear the costmap.",
        )
    if situation.where.is_known and start_cost is None:
        found.add(
            f"the robot is outside of {on}: it is localised wrongly, or off the map.", "Localise the robot again."
        )
    elif start_cost is not None and start_cost >= OCCUPIED:
        found.add(
            f"the robot stands in an occupied cell of {on} (cost {start_cost}).",
            "Drive the robot away from the obstacle; if there is none, clear the costmap or localise the robot again.",
        )
    if reach and not reach.is_reached and goal_cost is not None and goal_cost < TOUCHING:
        found.add(
            f"there is no free path from the robot to the goal on {on}: the nearest reachable place is "
            f"({reach.x_m:.2f}, {reach.y_m:.2f}), "
            f"{reach.short_m:.2f} m short of it.",
            "Open the path, or choose a goal on this side; if the obstacle is gone, clear the costmap.",
        )


def _sensors(found: _Findings, situation: Situation, failure: Failure) -> None:
    silent = [topic for topic in situation.silent if not any(topic in str(one) for one in situation.findings)]
    if silent:
        found.add(
            f"{listed(silent, 3)} {'is' if len(silent) == 1 else 'are'} silent.",
            "Restart the driver of that sensor; ros2_health_check shows its state.",
        )
    elif failure.code in _COSTMAP_LATE:
        found.add("the costmap was not updated in time; its sensors publish now.", "Try again.")


def _motion(found: _Findings, situation: Situation, failure: Failure) -> None:
    """Add reports of components: as causes if the robot made no progress, else as other problems."""
    said = [f"{quoted(row.name)} reports {row.level}: {quoted(row.message)}." for row in situation.diagnostics]
    base, local = situation.base, situation.local
    if failure.code in _WOULD_TOUCH and local:
        found.add(f"{str(local)[0].lower()}{str(local)[1:]}: a recovery would touch it.", "Make room around the robot.")
    if failure.code not in _NO_PROGRESS:
        found.beside += [*said, *base.sends, *base.others, *base.limits]
        return
    for one in said:
        found.add(one, "Check that component with ros2_health_check.")
    for one in base.limits:
        found.add(one, "Set it to more than 0: ros2_parameter_set.")
    others = [line for line in situation.lines if not is_of_navigation(line)]
    for line in others[-2:]:
        found.add(f"{line_in_words(line)}.")
    for one in base.sends:
        found.add(one, "Stop other nodes from commanding the base while Nav2 drives it.")
    found.beside += base.others
    is_near = local is not None and local.cost is not None and local.cost >= TOUCHING
    if is_near:
        found.add(f"{str(local)[0].lower()}{str(local)[1:]}.", "Remove the obstacle, or clear the costmap.")
    says_why = failure.code == _NO_VALID_CONTROL and failure.text
    if not (found.causes or said or others or situation.silent or says_why or base.limits or base.sends or is_near):
        near = [f"{local}."] if local and local.away_m is not None else []
        why = failure.seen or "the robot was commanded to drive but made no progress; no component reports why."
        found.add(" ".join([why, *near, *base.others]))


def _told(lines: Sequence[LogLine], failure: Failure) -> str:
    """Return the last log line of the server that failed, else of any Nav2 node; "" if there is none."""
    server = "bt_navigator" if failure.is_rejected else server_of(failure.code)
    of_server = [line for line in lines if server and server in line.node.split("/")]
    last = (of_server or [line for line in lines if is_of_navigation(line)])[-1:]
    return f"{line_in_words(last[0])}." if last else ""


def _feasibility(situation: Situation, reach: Reach | None) -> str:
    if reach is None:
        return "unknown"
    on = named(situation.grid_topic)
    if reach.is_reached:
        return f"there is a free path from the robot to the goal on {on}"
    nearest = f"({reach.x_m:.2f}, {reach.y_m:.2f}), {reach.short_m:.2f} m short"
    return f"no free path on {on}: the nearest reachable place is {nearest}"


def _health(situation: Situation, more: Sequence[str]) -> list[str]:
    where = situation.where
    if where.is_known and not where.trouble:
        age = "" if where.age_s is None else f", {where.age_s:.2f} s old"
        fine = f"Localised: {named(where.base)} is at ({where.x_m:.2f}, {where.y_m:.2f}) in {named(where.frame)}{age}."
        return [fine, *(f"{one[0].upper()}{one[1:]}" for one in more)]
    return [f"{one[0].upper()}{one[1:]}" for one in more]
