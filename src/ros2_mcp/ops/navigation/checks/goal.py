"""The goal: outside the costmap, occupied, in unknown space that the planner may not enter, or unreachable."""

from __future__ import annotations

from collections.abc import Iterator

from ros2_mcp.model.costs import OCCUPIED, TOUCHING, UNKNOWN, Reach
from ros2_mcp.model.text import named
from ros2_mcp.ops.navigation.checks.check import GOAL, NavCheck
from ros2_mcp.ops.navigation.evidence import NavEvidence, NavFinding

_BAND_M = 0.2


def _find(evidence: NavEvidence) -> Iterator[NavFinding]:
    goal, grids, frames = evidence.goal, evidence.grids, evidence.frames
    if goal is None or grids is None:
        return
    at = f"({goal.x_m:.2f}, {goal.y_m:.2f})"
    if goal.why_not:
        yield _of_goal(f"The goal {at} has no transform to the map.", goal.why_not, "Give the pose in map.")
        return
    grid = grids.costs
    if grid is None:
        return
    on = named(grids.costs_topic)
    cost = grid.value(goal.x_m, goal.y_m)
    near = grid.nearest_free(goal.x_m, goal.y_m)
    nearest = f"The nearest free place is ({near[0]:.2f}, {near[1]:.2f})." if near else "There is no free place."
    if cost is None:
        yield _of_goal(f"The goal {at} is outside of {on}.", f"It covers {grid.extent()} m.", nearest)
    elif cost == UNKNOWN:
        refused = [
            f"{name} of {node} is false"
            for node in evidence.of_role("planner_server")
            for name, value in (evidence.parameters or {}).get(node, {}).items()
            if name.endswith("allow_unknown") and value is False
        ]
        if refused:
            yield _of_goal(
                f"The goal {at} lies in unknown space, and the planner may not enter it.",
                f"Its cell on {on} is unknown, as are {_unknown_around(evidence)} of those around; {refused[0]}.",
                f"Choose a goal on known ground, explore there first, or set allow_unknown to true. {nearest}",
            )
    elif cost >= OCCUPIED:
        yield _of_goal(f"The goal {at} is occupied on {on}.", f"Its cost is {cost}.", f"Choose another goal. {nearest}")
    elif cost >= TOUCHING:
        yield _of_goal(
            f"The goal {at} is so near to an obstacle that the robot would touch it.",
            f"Its cost on {on} is {cost}.",
            f"Choose another goal. {nearest}",
        )
    elif frames is not None and frames.tree.base:
        located = frames.tree.newest(grid.frame_id, frames.tree.base)
        if located is None:
            return
        x, y, _ = located.pose.translation
        reach: Reach | None = grid.reach((x, y), (goal.x_m, goal.y_m))
        if reach is not None and not reach.is_reached:
            yield _of_goal(
                f"There is no free path from the robot to the goal {at} on {on}.",
                f"The nearest reachable place is ({reach.x_m:.2f}, {reach.y_m:.2f}), {reach.short_m:.2f} m short.",
                "Open the path, or choose a goal on this side; if the obstacle is gone, clear the costmap.",
            )


def _of_goal(cause: str, proof: str, remedy: str) -> NavFinding:
    return NavFinding(rank="stops some goals", subject="goal", cause=cause, proof=proof, remedy=remedy)


def _unknown_around(evidence: NavEvidence) -> str:
    goal, grid = evidence.goal, evidence.grids.costs if evidence.grids else None
    if goal is None or grid is None:
        return "some"
    steps = [step * _BAND_M / 2 for step in range(-2, 3)]
    values = [grid.value(goal.x_m + dx, goal.y_m + dy) for dx in steps for dy in steps]
    return f"{sum(value in (None, UNKNOWN) for value in values) / len(values):.0%}"


CHECK = NavCheck(("goal", "grids", "parameters", "frames"), _find, GOAL)
