"""`ros2_nav_preview`: the path that Nav2's planner would take, as a picture and in numbers; nothing moves."""

from __future__ import annotations

import asyncio
import math
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from time import monotonic
from typing import TYPE_CHECKING, Any, cast

from ros2_mcp.model import parameters
from ros2_mcp.model.aside import aside
from ros2_mcp.model.costs import Narrowest, cost_in_words
from ros2_mcp.model.errors import BadInput, NotFound, RobotError
from ros2_mcp.model.names import did_you_mean
from ros2_mcp.model.nav2 import CODES, COMPUTE_PATH
from ros2_mcp.model.text import counted, listed, named, quoted
from ros2_mcp.ops.navigation.action_names import action_of
from ros2_mcp.ops.navigation.below import idle_server
from ros2_mcp.ops.navigation.explain import Explanation, Failure, error_in_words, explain
from ros2_mcp.ops.navigation.home import targets_in
from ros2_mcp.ops.navigation.planned_path import entered_by
from ros2_mcp.ops.navigation.planner import PLAN_S, Rejected, planned
from ros2_mcp.ops.navigation.situation import costmap_of
from ros2_mcp.ops.navigation.targets import MAP_FRAME, Target
from ros2_mcp.ops.nodes.own_services import ask_node
from ros2_mcp.ops.results.results import Report, WithPictures, reporting, silent
from ros2_mcp.ops.sources.live import Live
from ros2_mcp.ops.space.plans import hear_plans
from ros2_mcp.ops.space.scene import scene
from ros2_mcp.ops.space.scene_picture import ScenePicture, SceneRequest, Way
from ros2_mcp.robot import Robot
from ros2_mcp.robot.session import Session

if TYPE_CHECKING:
    from ros2_mcp.world.costmap import CostGrid

_MOST_POINTS = 24
"""Number of points of the path in an answer: enough to follow it in a picture."""
_PLUGINS = "planner_plugins"
"""The planner server's parameter with the names of its planners."""
_SAY_NOTHING = frozenset(
    code for code, error in CODES.items() if error.name in ("UNKNOWN", "INVALID_PLANNER", "TF_ERROR", "TIMEOUT")
)
"""Errors of a planner that say nothing about whether there is a path."""
_ANSWER_S = 1.0
_TURN_RAD = math.radians(30)


@dataclass(frozen=True, slots=True, kw_only=True)
class Preview(WithPictures):
    """A path: its length, some of its points (m in `frame`), the highest cost of the costmap along it, and its turns.

    `narrowest` is a sentence on how close the path comes to anything occupied on the costmap: `clearance_m` is the
    distance from its centre line, `gap_m` the width of the narrowest gap, each with its position; null if nothing is
    within 3 m, or without a costmap. `grid_topic` is the costmap that was used.

    `is_feasible` is false if there is no path; `explanation` then says why. It is null if no planner was
    asked, or if it could not look.
    """

    is_feasible: bool | None
    action_name: str
    frame: str
    length_m: float
    straight_m: float
    points: Sequence[Sequence[float]]
    poses: int
    turns: int
    dearest_cost: int | None
    dearest: str
    narrowest: str = ""
    clearance_m: float | None = None
    clearance_at: Sequence[float] | None = None
    gap_m: float | None = None
    gap_at: Sequence[float] | None = None
    grid_topic: str = ""
    planning_s: float
    explanation: Explanation | None = None
    note: str = ""

    def summary(self) -> list[str]:
        """Return one line; without a path, also the cause."""
        if self.is_feasible:
            dearest = f"; the costliest cell along it is {self.dearest}" if self.dearest else ""
            narrowest = f" {self.narrowest[0].upper()}{self.narrowest[1:]}." if self.narrowest else ""
            return [
                f"A path of {self.length_m:.2f} m ({self.straight_m:.2f} m straight), "
                f"{counted(self.turns, 'turn')}{dearest}."
                f"{narrowest} Nothing moved. {self.note}".rstrip()
            ]
        why = self.explanation
        told = f" Cause: {why.cause} What would help: {' '.join(why.helps)}" if why else ""
        if self.is_feasible is None:
            return [f"NOT KNOWN whether there is a path: {self.note}{told}"]
        return [f"There is no path. {self.note}{told}".rstrip()]


async def preview(
    robot: Robot,
    session: Session,
    to: object,
    start: object = None,
    *,
    planner_id: str = "",
    action: str = "",
    report: Report = silent,
) -> Preview:
    """Ask the planner for a path to a place, from the robot or from `start`.

    Raises:
        BadInput: for a malformed place, or several places.
        NotFound: for an unknown place, without a planner, or if the server has no planner of that name.
        TimedOut: if it does not answer.
        RobotError: what sending a goal raises.
    """
    target, begin = _one(to, robot), _one(start, robot) if start is not None else None
    action = await action_of(robot, COMPUTE_PATH, action)
    goal: dict[str, Any] = {"goal": target.pose(), "planner_id": planner_id, "use_start": begin is not None}
    if begin:
        goal["start"] = begin.pose()
    robot.log.start()
    idle, unverified = await asyncio.gather(idle_server(robot, action), check_planner(robot, action, planner_id))
    if idle:
        return _not_asked(action, f"no planner was asked. {idle}")
    await hear_plans(robot)
    began_at = monotonic()
    async with reporting(report, PLAN_S, f"{action}: planning"):
        try:
            result = await planned(robot, session, action, goal)
        except Rejected as error:
            return _not_asked(action, str(error))
    path: Mapping[str, Any] = result.get("path") or {}
    points, unknown = _points(path)
    code, text = int(result.get("error_code", 0)), str(result.get("error_msg", ""))
    frame = str(path.get("header", {}).get("frame_id") or MAP_FRAME)
    grid, grid_topic = await _grid(robot, action, frame) if points else (None, "")
    dearest = _dearest(grid, points)
    refused = entered_by(robot.policy, path) if points else ""
    spot = await aside(grid.cells.size, grid.narrowest, points) if grid else None
    shown = await _picture(robot, frame, points, spot) if points else None
    is_feasible = None if code in _SAY_NOTHING else bool(points) and not code
    explanation = None
    if not is_feasible:
        explanation = await explain(robot, action, target, Failure(False, code, text), monotonic() - began_at)
    return Preview(
        is_feasible=is_feasible,
        action_name=action,
        frame=frame,
        length_m=round(_length(points), 3),
        straight_m=round(math.dist(points[0], points[-1]), 3) if points else 0.0,
        points=[[round(x, 2), round(y, 2)] for x, y in _some(points)],
        poses=len(points),
        turns=_turns(points),
        dearest_cost=dearest,
        dearest=cost_in_words(dearest) if dearest is not None else "",
        narrowest=str(spot) if spot else "",
        clearance_m=round(spot.clearance_m, 2) if spot else None,
        clearance_at=_rounded(spot.clearance_at) if spot else None,
        gap_m=round(spot.gap_m, 2) if spot and spot.gap_m is not None else None,
        gap_at=_rounded(spot.gap_at) if spot and spot.gap_at else None,
        grid_topic=grid_topic,
        planning_s=_seconds(result.get("planning_time")),
        explanation=explanation,
        note=" ".join(filter(None, (refused, error_in_words(code, text), unknown, unverified))),
        pictures=shown.pictures if shown else (),
        images=shown.images if shown else (),
    )


async def check_planner(robot: Robot, action: str, planner_id: str) -> str:
    """Check that the planner server has a planner of this name; return a sentence if its planners cannot be read, else
    "".

    Raises:
        NotFound: if the server has other planners only; it names them.
    """
    if not planner_id:
        return ""
    kind, unread = "rcl_interfaces/srv/GetParameters", f"Whether {quoted(planner_id)} exists could not be read."
    try:
        (node,) = set(await robot.graph.servers(f"{action}/_action/send_goal"))
        answer = await ask_node(robot, node, kind, {"names": [_PLUGINS]}, timeout_s=_ANSWER_S, wait_s=_ANSWER_S)
        (value,) = (await robot.fields_of(answer))["values"]
    except (RobotError, ValueError):  # no server, several, or an answer without the parameter
        return unread
    known = parameters.value_of(value)
    if not isinstance(known, list) or not known:
        return unread
    planners = [str(one) for one in cast("list[object]", known)]
    if planner_id in planners:
        return ""
    hint = did_you_mean(planner_id, planners, "Leave planner_id out for Nav2's own choice.")
    raise NotFound(f"{named(node)} has no planner {quoted(planner_id)}. Its planners: {listed(planners, 8)}.", hint)


def _not_asked(action: str, note: str) -> Preview:
    """Return the result for a request that no planner computed."""
    return Preview(
        is_feasible=None,
        action_name=action,
        frame=MAP_FRAME,
        length_m=0.0,
        straight_m=0.0,
        points=(),
        poses=0,
        turns=0,
        dearest_cost=None,
        dearest="",
        planning_s=0.0,
        note=note,
    )


async def _picture(
    robot: Robot, frame: str, points: Sequence[tuple[float, float]], spot: Narrowest | None
) -> ScenePicture | None:
    """Return the scene with the path and its narrowest gap; None if nothing can be drawn."""
    marks = [(f"gap {spot.gap_m:.2f} m", *spot.gap_at)] if spot and spot.gap_m is not None and spot.gap_at else []
    with suppress(RobotError):
        return await scene(robot, Live(robot), SceneRequest(way=Way("planned way", frame, points, marks)))
    return None


def _one(to: object, robot: Robot) -> Target:
    found = targets_in(robot, to)
    if len(found) != 1:
        raise BadInput("A preview takes one place.", "Give one place; preview each leg by itself, with `start`.")
    return found[0]


async def _grid(robot: Robot, action: str, frame: str) -> tuple[CostGrid | None, str]:
    """Return the costmap and its topic if it has the frame of the path."""
    with suppress(RobotError):
        grid, topic, _ = await costmap_of(robot, list(await robot.graph.topics()), action)
        return (grid, topic) if grid and grid.frame_id == frame else (None, "")
    return None, ""


def _points(path: Mapping[str, Any]) -> tuple[list[tuple[float, float]], str]:
    """Return the finite points of a path in m, and a sentence on how many are not finite ("" if all are)."""
    told = [(pose["pose"]["position"]["x"], pose["pose"]["position"]["y"]) for pose in path.get("poses", ())]
    points = [point for point in told if all(isinstance(one, (int, float)) and math.isfinite(one) for one in point)]
    if len(points) == len(told):
        return points, ""
    return points, f"{len(told) - len(points)} of the path's {counted(len(told), 'pose')} are not finite: left out."


def _dearest(grid: CostGrid | None, points: Sequence[tuple[float, float]]) -> int | None:
    if grid is None:
        return None
    costs = [cost for x, y in points if (cost := grid.value(x, y)) is not None]
    return max(costs, default=None)


def _length(points: Sequence[tuple[float, float]]) -> float:
    return sum(math.dist(points[i], points[i + 1]) for i in range(len(points) - 1))


def _some(points: Sequence[tuple[float, float]]) -> Sequence[tuple[float, float]]:
    """Return at most `_MOST_POINTS` points, evenly spread and including both ends."""
    if len(points) <= _MOST_POINTS:
        return points
    return [points[round(i * (len(points) - 1) / (_MOST_POINTS - 1))] for i in range(_MOST_POINTS)]


def _turns(points: Sequence[tuple[float, float]]) -> int:
    """Count the turns of more than 30° within half a metre of the path."""
    headings: list[tuple[float, float]] = []
    way = 0.0
    for i in range(len(points) - 1):
        (x, y), (to_x, to_y) = points[i], points[i + 1]
        step = math.hypot(to_x - x, to_y - y)
        way += step
        if step > 1e-6:
            headings.append((way, math.atan2(to_y - y, to_x - x)))
    turns, since = 0, 0
    for i, (at, heading) in enumerate(headings):
        while headings[since][0] < at - 0.5:
            since += 1
        if abs(math.remainder(heading - headings[since][1], 2 * math.pi)) > _TURN_RAD:
            turns, since = turns + 1, i
    return turns


def _rounded(at: Sequence[float]) -> list[float]:
    return [round(one, 2) for one in at]


def _seconds(duration: Mapping[str, Any] | None) -> float:
    return round(float(duration["sec"]) + float(duration["nanosec"]) / 1e9, 4) if duration else 0.0
