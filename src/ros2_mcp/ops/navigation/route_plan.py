"""The plan of a navigation to several places: loops, waits, missed places, and the headings of arrival."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from ros2_mcp.model.commands import Principal, Route
from ros2_mcp.ops.navigation.targets import Target
from ros2_mcp.robot import Robot
from ros2_mcp.robot.kept import Kept

MOST_LOOPS = 1000
"""A patrol of five places for a whole day has fewer."""
MOST_ROUTE_S = 12 * 3600.0
"""No place is begun later than this: a shift and its overtime."""
_MOST_PENDING = 16
"""Routes that wait for an approval; a client may have eight requests waiting."""


@dataclass(frozen=True, slots=True)
class RoutePlan:
    """How often the list is driven, how long the robot waits at each place (s), and whether a missed place does not end
    it."""

    loops: int = 1
    waits_s: Sequence[float] = ()
    goes_on: bool = False

    def wait_s(self, number: int) -> float:
        """Return the wait at a place."""
        return self.waits_s[number] if self.waits_s else 0.0

    def route(self, job_id: str, targets: Sequence[Target] = ()) -> Route:
        """Return the list for a goal's command: of the first goal with all `targets`."""
        goals: list[Mapping[str, Any]] = [{"pose": target.pose()} for target in targets]
        return Route(id=job_id, goals=goals, loops=self.loops, waits_s=self.waits_s, goes_on=self.goes_on)


ONCE = RoutePlan()


@dataclass(slots=True)
class Visits:
    """How often a place was reached and missed; cause and remedy of the last miss."""

    reached: int = 0
    missed: int = 0
    cause: str = ""
    helps: str = ""


def headed(targets: Sequence[Target], start: tuple[float, float] | None, frame: str, loops: int) -> list[Target]:
    """Return the targets; those that allow any heading get the direction in which they are reached from the target
    before.

    The first is seen from `start` (m in `frame`), or in several loops from the last, so that all loops are alike.
    """
    before = start
    if loops > 1:
        before = (targets[-1].x_m, targets[-1].y_m) if targets[-1].frame == frame else None
    found: list[Target] = []
    for target in targets:
        found.append(target.facing_from(*before) if before and target.frame == frame else target)
        before = (target.x_m, target.y_m) if target.frame == frame else None
    return found


@dataclass
class PendingRoutes(Kept):
    """Routes that wait for a person's approval, with the headings that were asked for: the headings of a repeated call
    must be the same, though the robot's estimated pose varies.
    """

    _pending: dict[tuple[Any, ...], list[Target]] = field(default_factory=dict[tuple[Any, ...], list[Target]])

    def take(self, key: tuple[Any, ...]) -> list[Target] | None:
        """Return the targets that were stored for a call, and forget them; None if there are none."""
        return self._pending.pop(key, None)

    def note(self, key: tuple[Any, ...], targets: list[Target]) -> None:
        """Remember targets."""
        self._pending[key] = targets
        if len(self._pending) > _MOST_PENDING:
            del self._pending[next(iter(self._pending))]


def pending_routes(robot: Robot) -> PendingRoutes:
    """Return the routes of a robot that wait for an approval."""
    return robot.kept.get(PendingRoutes, PendingRoutes)


def key_of(principal: Principal, action: str, targets: Sequence[Target], plan: RoutePlan) -> tuple[Any, ...]:
    """Return a key that is equal for repetitions of the same call."""
    return (principal, action, tuple(targets), plan.loops, tuple(plan.waits_s), plan.goes_on)
